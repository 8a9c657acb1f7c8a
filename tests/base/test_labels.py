import re
import time
from itertools import pairwise

import pytest
from hypothesis import example, given, strategies as st

from wordcraft_kg.base import ActionError, nearest
from wordcraft_kg.base.answers import read_answer
from wordcraft_kg.base.labels import LabelIndex, last_line, read_label, read_pair
from wordcraft_kg.base.wording import case_key, means_another, signs_of, spelling_key
from wordcraft_kg.graphs.library import open_book

TABLE = ("water", "watch", "Fire", "fire", "fire brigade", "wood", "3")

PANTRY = (
    *("berry", "glass", "glasses", "knife", "salt and pepper", "pepper", "salt", "t-shirt"),
    *("the sun", "leaf", "box", "ashes"),
)

WAYS = {
    "water": ("1", "water", "the water", "waters"),
    "watch": ("WATCH", "watches"),
    "Fire": ("Fire",),
    "fire": ("fire",),
    "fire brigade": (
        "fire b",
        "  fire   brigade ",
        "fire-brigade",
        "fire_brigade",
        "A Fire brigade.",
    ),
    "wood": ("wo", "WO", "'wood'", "**wood**"),
    "3": ("7", "3", "'3'"),  # a label goes before a place
}

FORGIVEN = {
    **{
        "berry": ("berries",),
        "glass": ("glass",),
        "glasses": ("glasses",),
        "knife": ("knives",),
        "leaf": ("leaves",),
    },
    **{
        "box": ("boxes", "the boxes"),
        "t-shirt": ("T shirt", "t-shirts"),
        "the sun": ("sun", "the suns"),
    },
    **{"salt": ("salt",), "salt and pepper": ("salt and",), "ashes": ("ash",)},
}

PAIRS = {
    (0, 5): ("water + wood", "1 6", "1, 6", "I combine water and wood", "Answer: **water + wood**"),
    (5, 0): ("wood+water",),
    (5, 5): ("6 + 6",),
    (0, 1): ("combine the water with a watch.",),
    (2, 3): ("Fire + fire",),
    (4, 5): ("fire brigade plus wo",),
}

MADE = [("water + wood = boat", (0, 5)), ("water & wood -> boat", (0, 5))]


def each(ways):
    """Return each way of writing with its meaning."""
    return [(written, meant) for meant, texts in ways.items() for written in texts]


@pytest.mark.parametrize(("written", "label"), each(WAYS))
def test_a_label_is_meant_by_its_number_its_word_or_the_beginning_of_one(written, label):
    assert TABLE[read_label(written, TABLE)] == label


@pytest.mark.parametrize(("written", "label"), each(FORGIVEN))
def test_articles_plurals_and_hyphens_are_forgiven(written, label):
    assert PANTRY[read_label(written, PANTRY)] == label


@pytest.mark.parametrize(
    "written",
    ["0", "-1", "8", "01", "-3", "−3", "²", "9" * 5_000, "1.0", "x" * 100, "\ufffd", "watr"],
)
def test_what_is_not_there_is_answered_with_what_is_expected(written):
    with pytest.raises(
        ActionError, match="expected 1 to 7, an item name, or the start of a name"
    ) as error:
        read_label(written, TABLE)
    assert len(str(error.value)) < 160


def test_nothing_is_not_the_beginning_of_every_word():
    for written in ("", "  "):
        with pytest.raises(ActionError, match="no answer: expected"):
            read_label(written, TABLE)
    for written in ("the", "*", "..."):  # nor is what is left out
        with pytest.raises(ActionError, match="expected 1 to 4"):
            read_label(written, ("water", "fire", "wood", "stone"))


@pytest.mark.parametrize(
    ("written", "expected"),
    [("wat", "water (1), watch (2)"), ("FIRE", "Fire (3), fire (4)"), ("w", "water (1)")],
)
def test_an_ambiguous_word_is_answered_with_the_choices(written, expected):
    with pytest.raises(ActionError) as error:
        read_label(written, TABLE)
    assert expected in str(error.value)
    assert "or the number" in str(error.value)


def test_a_misspelt_word_is_answered_with_the_nearest():
    with pytest.raises(ActionError, match="Did you mean 'water'"):
        read_label("watr", TABLE)


def test_numbers_can_be_switched_off():
    assert read_label("3", TABLE, by_number=False) == 6
    with pytest.raises(
        ActionError, match="unknown item '1': expected an item name, or the start of a name"
    ):
        read_label("1", ["wood"], by_number=False)


@pytest.mark.parametrize(("written", "pair"), [*each(PAIRS), *MADE])
def test_a_pair_is_written_in_many_ways(written, pair):
    assert read_pair(written, TABLE) == pair


AND = {
    ("salt", "pepper"): ("salt and pepper",),
    ("salt and pepper", "salt"): ("salt and pepper + salt", "salt and pepper and salt"),
    ("salt", "salt and pepper"): ("salt and salt and pepper",),
    ("pepper", "salt and pepper"): ("pepper and salt and pepper",),
}


@pytest.mark.parametrize(("written", "pair"), each(AND))
def test_a_label_may_hold_what_stands_between_two(written, pair):
    one, other = read_pair(written, PANTRY)
    assert (PANTRY[one], PANTRY[other]) == pair


def test_what_could_be_several_pairs_is_refused_with_all():
    labels = ("a", "a and b", "b", "b and a")
    with pytest.raises(
        ActionError, match=r"is ambiguous: a \+ b and a or a and b \+ a\. Write the numbers"
    ):
        read_pair("a and b and a", labels)
    assert read_pair("1 + 4", labels) == (0, 3)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("", r"no answer: expected two items, such as 'water \+ 3'"),
        ("water", r"cannot parse 'water': expected two items, such as 'water \+ 3'"),
        ("water + unicorn", "'unicorn': expected 1 to 7"),
        ("water + ", "no answer: expected 1 to 7"),
        ("water + wood + fire", "expected 1 to 7"),
        ("wat + wood", "'wat' is ambiguous: water"),
        ("1 9", "'9': expected 1 to 7"),
        ("x" * 2_000, "2,000 characters: expected two items"),
    ],
)
def test_what_is_no_pair_is_answered_with_what_is_expected(written, said):
    with pytest.raises(ActionError, match=said) as error:
        read_pair(written, TABLE)
    assert len(str(error.value)) < 200


def test_an_empty_table_has_no_pair():
    with pytest.raises(ActionError, match="nothing to combine"):
        read_pair("a + b", ())


LINES = {
    "water + earth": (
        "I think of mud.\n\n  water + earth \n\n",
        "- **water + earth**\n```",
        "water + earth",
    ),
    "1 2": ("> `1 2`",),
    "": ("", "\n \n", "***\n---"),
}


@pytest.mark.parametrize(("message", "line"), each(LINES))
def test_the_last_line_of_a_message_counts(message, line):
    assert last_line(message) == line


@pytest.mark.parametrize("book", ["everyday", "kitchen"])
def test_every_label_means_itself_in_every_case(book):
    """Every label of a book means itself in every case and with an article."""
    labels = sorted({label for recipe in open_book(book).recipes for label in recipe})
    for place in range(0, len(labels), 7):
        label = labels[place]
        for written in (label, label.upper(), f"the {label}", f'"{label}"', str(place + 1)):
            assert read_label(written, labels) == place


LABEL = (
    st.text("abs +&, the", min_size=1, max_size=8)
    .map(lambda text: " ".join(text.split()))
    .filter(bool)
)

LABELS = st.lists(LABEL, min_size=1, max_size=6, unique=True)


@given(LABELS, st.data())
def test_a_label_means_itself_and_two_numbers_a_pair(labels, data):
    """A label always means itself and two numbers always mean their pair."""
    place = data.draw(st.integers(0, len(labels) - 1))
    other = data.draw(st.integers(0, len(labels) - 1))
    assert read_label(labels[place], labels) == place
    assert read_pair(f"{place + 1} {other + 1}", labels) == (place, other)


@given(st.text(max_size=50), LABELS)
def test_any_text_is_read_or_refused(written, labels):
    for read in (read_label, read_pair):
        try:
            found = read(written, labels)
        except ActionError:
            continue
        assert all(
            0 <= place < len(labels) for place in (found if isinstance(found, tuple) else (found,))
        )


def test_an_index_of_labels_reads_as_the_reader_does_one_by_one():
    labels = [
        *(
            "Moon",
            "moon",
            "berries",
            "berry",
            "box",
            "the box",
            "wolf",
            "knife",
            "ice-cream",
            "Ice Cream",
            "c++",
            "a",
        )
    ]
    index = LabelIndex(labels)
    texts = [
        *(
            "MOON",
            "Berry",
            "berrys",
            "boxes",
            "a box",
            "wolves",
            "knives",
            "knife.",
            "'ice cream'",
            "ICE_CREAM",
        ),
        *("icecream", "ox", "", "  ", "1", "mo", "an a", "as", "**berry**", "berry!", "the boxes"),
    ]
    for text in (*labels, *texts):
        try:
            expected = read_label(text, labels, by_number=False)
        except ActionError:
            expected = None
        assert index.find(text) == expected, text
    assert index.find("the") is None  # the beginning of a label


def test_an_index_keeps_signs_and_forgives_variation_selectors():
    index = LabelIndex(["C", "7", "H+", "water", "\u2764\ufe0f"])
    for text in ("C-", "C+", "-7", "H", "H-", ".7"):
        assert index.find(text) is None, text
    for place, text in enumerate(("the C", "7.", '"H+"', "-water", "\u2764")):
        assert index.find(text) == place


ANSWERS_TABLE = (
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
    "$\\boxed{\\boxed{number + necklace}}$",
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
    assert read_answer(message, ANSWERS_TABLE) == (0, 8)


ANSWERS_LABELS = sorted({label for recipe in open_book("kitchen").recipes for label in recipe})


@example(ANSWERS_LABELS.index("cocoa bean"), ANSWERS_LABELS.index("egg"), "<number> + <necklace>")
@given(
    st.integers(0, len(ANSWERS_LABELS) - 1),
    st.integers(0, len(ANSWERS_LABELS) - 1),
    st.sampled_from(FORMS),
)
def test_any_two_items_are_read_in_the_same_forms(one, other, form):
    if any(mark in form for mark in ("1", "9", "one", "num +")):
        return
    names = {"number": ANSWERS_LABELS[one], "necklace": ANSWERS_LABELS[other]}
    # Some forms begin a name with a capital.
    message = re.sub("number|necklace", lambda name: names[name[0].lower()], form, flags=re.I)
    assert read_answer(message, ANSWERS_LABELS) == (one, other)


NUMBERS = ("1", "7", "-7", "12", "3")
SIGNS = ("C", "O2-", "7", "5", "H+", "carbon", "water")
NOT_MEANT = {
    ANSWERS_TABLE: REFUSED,
    # A number is no spelling of another number.
    NUMBERS: ("-3 + 7", "2 7", "3 -7", "1 7 + 3 -7", "7.0 + 1", "07 + 1"),
    # A label in a sentence is no pair of its parts.
    ("salt", "pepper", "salt and pepper"): ("I think of salt and pepper today",),
    # An item is not named without its sign or with another.
    SIGNS: tuple(
        f"{written} + water"
        for written in ("C-", '"C-"', "the C-", "O2", "-7", "\u22127", ".5", "H")
    ),
}


@pytest.mark.parametrize(
    ("labels", "message"),
    [(labels, message) for labels, messages in NOT_MEANT.items() for message in messages],
)
def test_a_message_that_could_mean_something_else_is_refused(labels, message):
    with pytest.raises(ActionError) as error:
        read_answer(message, labels)
    assert len(str(error.value)) < 400


ODD = {
    NUMBERS: {
        "7 + -7": ("7", "-7"),
        "-7 + 7": ("-7", "7"),
        "−7 + 12": ("-7", "12"),
        "1 + 3": ("1", "3"),  # the names, not the places
        "4 + 5": ("12", "3"),  # no label is 4 or 5: the places
        "2 7 + 3 -7": ("7", "-7"),  # as printed
        '["7", -7]': ("7", "-7"),
        "I add 7 + -7 here": ("7", "-7"),
        "7 -7": ("7", "-7"),
        "I add 1 + 3 here": ("1", "3"),
    },
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
def test_labels_that_are_numbers_or_hold_signs_or_other_labels_are_read_in_full(
    labels, message, pair
):
    one, other = read_answer(message, labels)
    assert (labels[one], labels[other]) == pair


PIECES = st.sampled_from(
    [
        *ANSWERS_TABLE,
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
        pair = read_answer(message, ANSWERS_TABLE)
    except ActionError:
        return
    assert all(0 <= place < len(ANSWERS_TABLE) for place in pair)


def test_a_long_message_is_read_at_once_among_thousands_of_labels_of_answers():
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


DIFFERENT = [
    *[("C", "C-"), ("O2", "O2-"), ("OH", "OH-"), ("H+", "H"), ("C\u207b", "C"), ("c", "c++")],
    *[("7", "-7"), ("1.0", "10"), ("3.14", "314"), (".5", "5"), ("1 2", "12"), ("x\u00b2", "x2")],
    *[("level -1", "level 1"), ("x-1", "x1"), ("a-b", "ab"), ("x'", "x"), ("OH.", "OH")],
    *[("_", "__"), ("-", "--"), ("\u0915\u092e", "\u0915\u093e\u092e")],
]
"""Pairs of labels that no advice may merge."""

SAME = [
    *[("ice cream", "ice-cream"), ("icecream", "Ice_Cream"), ("T-shirt", "T shirt")],
    *[("cat's", "cats"), ("cat\u2019s", "cat's"), ("U.S.A", "USA"), ("T 800", "T800")],
    *[("caf\u00e9", "cafe\u0301"), ("Stra\u00dfe", "STRASSE"), ("\uff12", "2")],
    *[("\u2764", "\u2764\ufe0f"), ("\u22129", "-9"), ("a\u00a0b", "a b")],
]
"""Pairs of labels that are probably one name in two spellings."""


@pytest.mark.parametrize(("one", "other"), DIFFERENT)
def test_signs_and_digits_are_a_part_of_the_name(one, other):
    assert spelling_key(one) != spelling_key(other)


@pytest.mark.parametrize(("one", "other"), SAME)
def test_spellings_of_one_name_have_one_key(one, other):
    assert spelling_key(one) == spelling_key(other)
    assert not means_another(one, other)


@pytest.mark.parametrize(
    ("label", "known", "expected"),
    [
        ("7", ["-7", "17", "7.0"], ""),
        ("C", ["C-", "C+"], ""),
        ("O2-", ["O2", "O2+"], ""),
        ("watr", ["water-", "water"], " Did you mean 'water', 'water-'?"),
        ("one_hot", ["one-hot"], " Did you mean 'one-hot'?"),
        ("little-alchemy-3", ["little-alchemy-2"], " Did you mean 'little-alchemy-2'?"),
    ],
)
def test_a_hint_never_names_another_number_or_another_charge(label, known, expected):
    assert nearest(label, known) == expected


def test_labels_left_out_of_a_hint_take_no_place_in_it():
    known = [*(f"water{sign}" for sign in ("-", "+", "--", "++")), "waters"]
    assert nearest("water", known) == " Did you mean 'waters'?"


@pytest.mark.parametrize(
    ("one", "other", "are_variants"),
    [
        ("Lava", "LAVA", True),
        ("\uff2cava", "lava", True),
        ("\u2615\ufe0e", "\u2615\ufe0f", True),
        ("\u0130", "i\u0307", True),
        ("ice cream", "ice-cream", False),
        ("O\u00b2", "O2", False),
        ("C", "C-", False),
    ],
)
def test_variants_differ_in_case_width_or_variation_selectors_alone(one, other, are_variants):
    assert (case_key(one) == case_key(other)) == are_variants


@given(st.text())
def test_keys_of_keys_are_the_keys(text):
    assert case_key(case_key(text)) == case_key(text)


@given(st.text("abC1. -_'+\u2212\u2764\ufe0f", min_size=1), st.text("abC1. -_'+\u2212", min_size=1))
def test_case_variants_are_also_spellings_of_one_name(one, other):
    if case_key(one) == case_key(other):
        assert spelling_key(one) == spelling_key(other)


@pytest.mark.parametrize(
    ("text", "signs"),
    [
        ("-7", ("-", "")),
        ("\u22127", ("-", "")),
        (".5", (".", "")),
        ("O2-", ("", "-")),
        ("c++", ("", "++")),
        ("- water", ("", "")),
        ("-water", ("", "")),
        ("water -", ("", "")),
        ("a+b", ("", "")),
    ],
)
def test_signs_at_the_ends_belong_to_numbers_and_charges(text, signs):
    assert signs_of(text) == signs
