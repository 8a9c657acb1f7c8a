import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import LabelIndex, last_line, read_label, read_pair
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


def test_a_long_message_is_read_at_once_among_thousands_of_labels():
    labels = [f"entity {number}" for number in range(7_000)]
    began = time.process_time()
    with pytest.raises(ActionError, match="expected an item name"):
        read_label("look up " + "water " * 15_000, labels, by_number=False)
    with pytest.raises(ActionError, match="'a': expected 1 to 700"):
        read_pair("a + " * 200, labels[:700])
    assert (
        time.process_time() - began < 5
    )  # a second at most; once each form was made for each label, for a minute


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
