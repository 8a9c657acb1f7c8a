"""Labels that are spellings of one name, and labels that name different things."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.settings import nearest
from wordcraft_kg.base.wording import case_key, means_another, signs_of, spelling_key

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
