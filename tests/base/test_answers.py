"""The answer grammar: forms in which language models write a pair, and traps that
must not be read."""

import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.answers import read_answer
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import last_line, read_pair
from wordcraft_kg.graphs.library import open_book

TABLE = (
    *("number", "orchard", "doctor", "rubber", "bride", "athlete", "sand", "child", "necklace"),
    "captain",
)
READ = {
    "number + necklace": (
        "number + necklace",
        "1 number + 9 necklace",
        "1. number and 9. necklace",
        "number (1) + necklace (9)",
        "1 9",
        "Final answer: number and necklace",
        "I weighed all ten. The final answer is: the number and a necklace.",
        "Not sand + child. Answer: number + necklace",
        "I choose **number** + **necklace** now.",
        "So I will combine `number` with `necklace`!",
        "The pair is “number” and “necklace”.",
        r"So the answer is \boxed{number + necklace}.",
        r"$$\boxed{\text{number} + \text{necklace}}$$",
        "\\[\n\\boxed{1 + 9}\n\\]",
        '{"first": "number", "second": "necklace"}',
        '{"reasoning": "doctor + child is wrong", "answer": "number + necklace"}',
        '```json\n{\n  "Item 1": "number",\n  "item_2": "necklace"\n}\n```',
        '{"answer": ["number", 9]}',
        'I am sure: ["1 number", "necklace"]',
        "I think number + necklace makes an abacus.",
        "number + necklace -> abacus, pearl",
        "number + necklace = abacus",
        "A doctor is a person, so I take number + necklace",
        "1. number + necklace",
        "1 number + 1 necklace",  # one of each, though necklace is the ninth item
        "I take 1 number + 1 necklace now.",
        "sand + child was wrong.\nnumber + necklace",
        "x " * 2_000 + "Final answer: number + necklace",
    )
}
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
    "I use items 1 and 9.",  # numbers in a sentence are no items
    "number",
    "number necklace",
    "number + necklace\nGood luck!",  # the last line counts
    "",
    "{" * 900,
    "[" * 20_000 + "]" * 20_000,
)


@pytest.mark.parametrize(
    ("message", "pair"), [(text, pair) for pair, texts in READ.items() for text in texts]
)
def test_a_pair_is_read_in_the_forms_of_language_models(message, pair):
    one, other = read_answer(message, TABLE)
    assert f"{TABLE[one]} + {TABLE[other]}" == pair


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


def test_grammar_1_reads_the_last_line_as_a_whole_with_numbers_first():
    for message in READ["number + necklace"][1:4]:
        with pytest.raises(ActionError):
            read_answer(message, TABLE, grammar=1)
    assert read_answer("x\n- **number + sand**", TABLE, grammar=1) == (0, 6)
    assert read_answer("1 + 3", NUMBERS, grammar=1) == (0, 2)
    # Grammar 1 ignores all that follows the first result.
    both = "number + necklace = abacus, sand + child = toy"
    assert read_answer(both, TABLE, grammar=1) == (0, 8)


LABELS = sorted({label for recipe in open_book("kitchen").recipes for label in recipe})
FORMS = (
    "{a} + {b}",
    "{a} and {b}",
    "the {a} with a {b}",
    "{i} {j}",
    "{i}, {j}",
    "combine {a} and {b}.",
    "{a} + {b} = something",
    "**{a} + {b}**",
)


@given(st.integers(0, len(LABELS) - 1), st.integers(0, len(LABELS) - 1), st.sampled_from(FORMS))
def test_what_grammar_1_reads_grammar_2_reads_alike(one, other, form):
    message = form.format(a=LABELS[one], b=LABELS[other], i=one + 1, j=other + 1)
    assert read_answer(message, LABELS) == read_answer(message, LABELS, grammar=1) == (one, other)


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
        ),
    ]
)


@given(st.lists(PIECES, max_size=14), st.booleans())
def test_any_message_is_read_or_refused(pieces, has_blanks):
    message = (" " if has_blanks else "").join(pieces)
    for grammar in (1, 2):
        try:
            found = read_answer(message, TABLE, grammar=grammar)
        except ActionError:
            continue
        assert all(0 <= place < len(TABLE) for place in found)
        if grammar == 1:
            assert found == read_pair(last_line(message), TABLE, grammar=1)


def test_a_long_message_is_read_at_once_among_thousands_of_labels():
    labels = tuple(f"entity {number}" for number in range(7_000))
    messages = ["entity 5 mentions " * 60, "a, " * 5_000, '{"a": ' * 300, "\\boxed{" * 300]
    read_answer("1 + 2", labels)  # makes the index
    began = time.perf_counter()
    for message in messages:
        with pytest.raises(ActionError):
            read_answer(message, labels)
    assert time.perf_counter() - began < 5  # half a second on an idle core


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


def test_the_published_grammar_reads_signs_as_before():
    assert read_answer("C- + water", ("C", "water"), grammar=1) == (0, 1)
