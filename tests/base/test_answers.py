"""The answer grammar: forms in which language models write a pair, and traps that
must not be read."""

import re
import time
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wordcraft_kg.base.answers import read_answer
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.graphs.library import open_book

TABLE = (
    *("number", "orchard", "doctor", "rubber", "bride", "athlete", "sand", "child", "necklace"),
    "captain",
)
FORMS = (  # all mean number + necklace
    "number + necklace",
    "number+necklace",
    "Number + Necklace",
    "NUMBER + NECKLACE",
    "1 + 9",
    "1 9",
    "1, 9",
    "1 and 9",
    "(1, 9)",
    "[1, 9]",
    "#1 + #9",
    "1. number + 9. necklace",
    "1) number + 9) necklace",
    "number (1) + necklace (9)",
    "1 number + 9 necklace",
    "1 number + 1 necklace",
    "1x number + 1x necklace",
    "1 × number + 1 × necklace",
    "one number + one necklace",
    "number and necklace",
    "number with necklace",
    "number & necklace",
    "number, necklace",
    "number plus necklace",
    "the number + a necklace",
    "**number + necklace**",
    "**number** + **necklace**",
    "*number* + *necklace*",
    "__number + necklace__",
    "`number + necklace`",
    "`number` + `necklace`",
    "```\nnumber + necklace\n```",
    "```text\nnumber + necklace\n```",
    '"number + necklace"',
    '"number" + "necklace"',
    "'number' + 'necklace'",
    "“number” + “necklace”",
    "«number» + «necklace»",
    "- number + necklace",
    "* number + necklace",
    "• number + necklace",
    "1. number + necklace",
    "> number + necklace",
    "### number + necklace",
    "## Answer\nnumber + necklace",
    "Answer: number + necklace",
    "Answer: number and necklace",
    "**Answer:** number + necklace",
    "**Final Answer**: number + necklace",
    "Final answer: number + necklace.",
    "The answer is number + necklace.",
    'My answer: "number + necklace"',
    "A: number + necklace",
    "Assistant: number + necklace",
    "Combine number and necklace.",
    "Combine: number + necklace",
    "I combine number with necklace.",
    "I'll combine the number and the necklace.",
    "I would try number + necklace.",
    "Let's combine number + necklace!",
    "number + necklace = abacus",
    "number + necklace -> abacus",
    "number + necklace → abacus",
    "number + necklace makes abacus",
    "number + necklace (abacus)",
    "\\boxed{number + necklace}",
    "$\\boxed{\\text{number + necklace}}$",
    "$\\boxed{\\text{number} + \\text{necklace}}$",
    "$$number + necklace$$",
    "\\text{number} + \\text{necklace}",
    "<answer>number + necklace</answer>",
    "<answer>\nnumber + necklace\n</answer>",
    "<answer>number and necklace",
    '<answer>{"first": "number", "second": "necklace"}</answer>',
    "<answer><b>number</b> + <b>necklace</b></answer>",
    "<answer>I take number + necklace.</answer>",
    "<think>maybe sand + child</think>\nnumber + necklace",
    "maybe sand + child\n</think>\n\nnumber + necklace",
    "<think>maybe sand + child</think><answer>number + necklace</answer>",
    "number + necklace<|im_end|>",
    "number + necklace</s>",
    "number + necklace<end_of_turn>",
    "number + necklace<|eot_id|>",
    "number + necklace <|endoftext|>",
    "number + necklace<｜end▁of▁sentence｜>",
    "<|channel|>analysis<|message|>sand + child?<|end|><|start|>assistant<|channel|>final<|message|>number + necklace<|return|>",
    "[/INST] number + necklace",
    "number ＋ necklace",
    "number ➕ necklace",
    "number ﹢ necklace",
    '{"first": "number", "second": "necklace"}',
    '{\n  "first": "number",\n  "second": "necklace"\n}',
    '```json\n{\n  "first": "number",\n  "second": "necklace"\n}\n```',
    '```json\n{"answer": "number + necklace"}\n```\nThis should make an abacus.',
    'Here is my answer:\n{\n  "first": "number",\n  "second": "necklace"\n}\nIt makes an abacus.',
    '["number", "necklace"]',
    '{"answer": "number + necklace"}',
    '{"answer": ["number", "necklace"]}',
    '{"items": ["number", "necklace"]}',
    '{"item1": "number", "item2": "necklace"}',
    '{"Item 1": 1, "Item 2": 9}',
    '{"combination": "number + necklace", "reason": "an abacus is a necklace of numbers"}',
    "{'first': 'number', 'second': 'necklace'}",
    '{"name": "combine", "arguments": {"first": "number", "second": "necklace"}}',
    '<tool_call>\n{"name": "combine", "arguments": {"first": "number", "second": "necklace"}}\n</tool_call>',
    '{"tool_calls": [{"function": {"name": "combine", "arguments": "{\\"first\\": \\"number\\", \\"second\\": \\"necklace\\"}"}}]}',
    '[{"name": "combine", "parameters": {"first": "number", "second": "necklace"}}]',
    '<|python_tag|>{"name": "combine", "parameters": {"first": "number", "second": "necklace"}}',
    '<function=combine>{"first": "number", "second": "necklace"}</function>',
    '{"type": "tool_use", "name": "combine", "input": {"first": "number", "second": "necklace"}}',
    '{"items": [{"name": "number"}, {"name": "necklace"}]}',
    '{"action": "combine", "items": ["number", "necklace"]}',
    '{"action": "number + necklace"}',
    'combine("number", "necklace")',
    "combine(number, necklace)",
    'combine(first="number", second="necklace")',
    '[combine(first="number", second="necklace")]',
    "<first>number</first><second>necklace</second>",
    "<first>number</first>\n<second>necklace</second>",
    "First: number\nSecond: necklace",
    "**First item:** number\n**Second item:** necklace",
    "first: number\nsecond: necklace",
    "number + necklace\n\nThis makes an abacus.",
    "number + necklace\nGood luck!",
    "Answer: number + necklace\nReason: a necklace of numbers is an abacus.",
    "**Answer:**\nnumber + necklace\n\nAn abacus counts.",
    "Goal: abacus\nAnswer: number + necklace",
    "number + necklace 🙂",
    "number and necklace, please.",
    "number\nnecklace",
    "- number\n- necklace",
    "1. **number**\n2. **necklace**",
    "\u200bnumber + necklace\u200b",
    "{number} + {necklace}",
    "[number] + [necklace]",
    "<number> + <necklace>",
    "I combine items 1 and 9.",
    "I'd go with 1 + 9.",
    "Thought: both count.\nAction: combine\nAction Input: number, necklace",
    "Items 1 + 9",
    "number  +  necklace",
    "Pair: number + necklace",
    "My choice: number and necklace",
    "Use number together with necklace.",
    "number + necklace ✓",
    "(number, necklace)",
    '("number", "necklace")',
    "num + neck",
    "<p>number + necklace</p>",
    "number +\nnecklace",
    "Attempt 1: number + necklace",
    "Step 1: number + necklace",
    "I weighed all ten. The final answer is: the number and a necklace.",
    "Not sand + child. Answer: number + necklace",
    "The pair is “number” and “necklace”.",
    "\\[\n\\boxed{1 + 9}\n\\]",
    '{"reasoning": "doctor + child is wrong", "answer": "number + necklace"}',
    '{"answer": ["number", 9]}',
    'I am sure: ["1 number", "necklace"]',
    "number + necklace -> abacus, pearl",
    "A doctor is a person, so I take number + necklace",
    "I take 1 number + 1 necklace now.",
    "sand + child was wrong.\nnumber + necklace",
    "x " * 2_000 + "Final answer: number + necklace",
)
"""Forms in which language models, programs and people write a pair."""
REFUSED = (
    "number + necklace or sand + child",  # several pairs
    "I tried sand + child, so number + necklace",
    "number + necklace = abacus, sand + child = toy",
    "number, doctor and necklace",
    "number + necklace + doctor",
    "Combine number with necklace or sand.",
    r"\boxed{number + sand} or \boxed{number + child}",
    '{"first": "number", "first": "sand", "second": "child"}',
    '{"answer": "sand + child", "pair": ["number", "necklace"]}',
    "I do not think number + necklace works.",  # no answer
    "It can't be number and necklace.",
    "Rather than number + necklace I would wait",
    "Should I try number + necklace today?",
    "3 orchard + 2 doctor",  # number and item disagree
    "So 3 orchard + 2 doctor it is",
    "number + unicorn, so sand and child",  # an unknown item
    "number + unicorn",
    '{"first": "number", "second": "unicorn"}',
    '{"first": true, "second": "number"}',
    "I use 1 and 9 now.",  # numbers in a sentence are no items
    "I use 1 + 9 or 3.",
    "I use 1 + 9 + 3.",
    "Items 1, 9 and 3",
    "<think>number + necklace",  # reasoning that was cut off
    "<answer>number + sand</answer> or <answer>number + child</answer>",
    '[{"name": "combine", "arguments": {"first": "number", "second": "sand"}},'
    ' {"name": "combine", "arguments": {"first": "number", "second": "child"}}]',
    "number + necklace\nnumber + sand\nThese are two ways.",
    "number + necklace\nAnswer: number + unicorn",  # the attempt in the last line counts
    "1 number, 9 necklace, 3 doctor\nAttempts left: 1",  # the prompt
    "number",
    "number necklace",
    "",
    "{" * 900,
    "[" * 20_000 + "]" * 20_000,
)


@pytest.mark.parametrize("message", FORMS)
def test_a_pair_is_read_in_the_forms_of_language_models(message):
    assert read_answer(message, TABLE) == (0, 8)


LABELS = sorted({label for recipe in open_book("kitchen").recipes for label in recipe})


@example(LABELS.index("cocoa bean"), LABELS.index("egg"), "<number> + <necklace>")
@given(st.integers(0, len(LABELS) - 1), st.integers(0, len(LABELS) - 1), st.sampled_from(FORMS))
def test_any_two_items_are_read_in_the_same_forms(one, other, form):
    if any(mark in form for mark in ("1", "9", "one", "num +")):
        return
    names = {"number": LABELS[one], "necklace": LABELS[other]}
    # Some forms begin a name with a capital.
    message = re.sub("number|necklace", lambda name: names[name[0].lower()], form, flags=re.I)
    assert read_answer(message, LABELS) == (one, other)


@pytest.mark.parametrize("message", REFUSED)
def test_a_message_that_could_mean_something_else_is_refused(message):
    with pytest.raises(ActionError) as error:
        read_answer(message, TABLE)
    assert len(str(error.value)) < 400


NUMBERS = ("1", "7", "-7", "12", "3")


@pytest.mark.parametrize(
    ("message", "pair"),
    [
        ("7 + -7", ("7", "-7")),
        ("-7 + 7", ("-7", "7")),
        ("−7 + 12", ("-7", "12")),
        ("1 + 3", ("1", "3")),  # the names, not the places
        ("4 + 5", ("12", "3")),  # no label is 4 or 5: the places
        ("2 7 + 3 -7", ("7", "-7")),  # as printed
        ('["7", -7]', ("7", "-7")),
        ("I add 7 + -7 here", ("7", "-7")),
        ("7 -7", ("7", "-7")),
        ("I add 1 + 3 here", ("1", "3")),
    ],
)
def test_a_label_that_is_a_number_goes_before_the_place(message, pair):
    one, other = read_answer(message, NUMBERS)
    assert (NUMBERS[one], NUMBERS[other]) == pair


@pytest.mark.parametrize("message", ["-3 + 7", "2 7", "3 -7", "1 7 + 3 -7", "7.0 + 1", "07 + 1"])
def test_a_number_is_no_spelling_of_another_number(message):
    with pytest.raises(ActionError):
        read_answer(message, NUMBERS)


ODD = {
    ("c++", "c", "a + b", "a", "b"): {
        "c++ + c": ("c++", "c"),
        "a + b": ("a", "b"),
        "I take c++ + c now": ("c++", "c"),
    },
    ("salt", "pepper", "salt and pepper", "fire", "fire brigade"): {
        "salt and pepper + salt": ("salt and pepper", "salt"),
        "I take salt and pepper + salt now": ("salt and pepper", "salt"),
        "fire brigade and fire": ("fire brigade", "fire"),
        "I take a fire brigade with fire": ("fire brigade", "fire"),
    },
}


@pytest.mark.parametrize(
    ("labels", "message", "pair"),
    [(labels, text, pair) for labels, texts in ODD.items() for text, pair in texts.items()],
)
def test_labels_that_hold_signs_or_other_labels_are_read_in_full(labels, message, pair):
    one, other = read_answer(message, labels)
    assert (labels[one], labels[other]) == pair


def test_a_label_in_a_sentence_is_no_pair_of_its_parts():
    with pytest.raises(ActionError):
        read_answer("I think of salt and pepper today", ("salt", "pepper", "salt and pepper"))


PIECES = st.sampled_from(
    [
        *TABLE,
        *("1", "9", "+", "and", "or", "not", ",", "=", "->", "**", "`", "\n", "{", "}", "[", "]"),
        *(
            '"',
            ":",
            "\\boxed{",
            "Answer:",
            "$",
            "first",
            "second",
            "unicorn",
            "-7",
            "\u2028",
            "\x00",
            "<answer>",
            "</answer>",
            "<think>",
            "<|im_end|>",
        ),
    ]
)


@given(st.lists(PIECES, max_size=14), st.booleans())
def test_any_message_is_read_or_refused(pieces, has_blanks):
    message = (" " if has_blanks else "").join(pieces)
    try:
        pair = read_answer(message, TABLE)
    except ActionError:
        return
    assert all(0 <= place < len(TABLE) for place in pair)


def test_a_long_message_is_read_at_once_among_thousands_of_labels():
    labels = tuple(f"entity {number}" for number in range(7_000))
    messages = ["entity 5 mentions " * 60, "a, " * 5_000, '{"a": ' * 300, "\\boxed{" * 300]
    messages += ["<answer>" * 9_000, "</think>" * 9_000, "combine(" * 9_000, "answer " * 9_000]
    read_answer("1 + 2", labels)  # makes the index
    began = time.process_time()
    for message in messages:
        with pytest.raises(ActionError):
            read_answer(message, labels)
    assert time.process_time() - began < 5  # half a second on an idle core


NASTY = [
    ("7", "-7", "1.0", "10", "1", "2", "3.14", "+1"),
    ("C", "C-", "C+", "O2", "O2-", "H+", "OH", "OH-", "e-", "e"),
    ("\u2764", "\u2764\ufe0f", "\U0001f525", "\u2615\ufe0e", "\u2615"),
    ("a+b", "a", "b", "salt/pepper", "salt", "x, y", "y", "d and e", "d"),
    ("oak_log", "oak log", "oak-log", "OakLog", "minecraft:stick", "stick"),
    ("1", "2", "item 1", "1 item", "2 x", "x"),
]


@pytest.mark.parametrize("labels", NASTY)
def test_exact_names_of_any_kind_are_read_back(labels):
    for one in labels:
        for other in labels:
            first, second = read_answer(f"{one} + {other}", labels)
            assert (labels[first], labels[second]) == (one, other)


@given(st.permutations([str(number) for number in range(-3, 12)]))
def test_a_number_is_a_name_before_it_is_a_place(labels):
    for one, other in pairwise(labels):
        first, second = read_answer(f"{one} + {other}", labels)
        assert (labels[first], labels[second]) == (one, other)


@pytest.mark.parametrize("written", ["C-", '"C-"', "the C-", "O2", "-7", "\u22127", ".5", "H"])
def test_an_item_is_not_named_without_its_sign_or_with_another(written):
    with pytest.raises(ActionError):
        read_answer(f"{written} + water", ("C", "O2-", "7", "5", "H+", "carbon", "water"))
