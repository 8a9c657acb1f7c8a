"""Arrays of ids: distinct numbers and rows."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.graphs.arrays import are_among, distinct, recipe_keys, sorted_unique

SMALL = st.integers(-3, 3)
LARGE = st.integers(-(2**40), 2**40)


@given(st.lists(LARGE))
def test_distinct_numbers_are_those_of_numpy(numbers):
    array = np.array(numbers, dtype=np.int64)
    assert distinct(array).tolist() == np.unique(array).tolist()


@pytest.mark.parametrize("numbers", [SMALL, LARGE], ids=["one number a row", "too large for one"])
@given(data=st.data())
def test_distinct_rows_are_sorted_by_the_columns(numbers, data):
    rows = data.draw(st.lists(st.tuples(numbers, numbers, numbers)))
    array = np.array(rows, dtype=np.int64).reshape(-1, 3)
    expected = sorted(set(rows), key=lambda row: (row[1], row[0], row[2]))
    found = sorted_unique(array, (1, 0, 2))
    assert list(map(tuple, found.tolist())) == expected
    assert found.flags.c_contiguous


@given(st.lists(SMALL), st.lists(SMALL))
def test_numbers_among_known_ones_are_those_of_numpy(numbers, known):
    asked = np.array(numbers, dtype=np.int64)
    ordered = np.sort(np.array(known, dtype=np.int64))
    assert are_among(asked, ordered).tolist() == np.isin(asked, ordered).tolist()


def test_keys_of_recipes_sort_like_rows_and_ignore_the_order_of_ingredients():
    every = np.array(list(itertools.product(range(4), repeat=3)))
    keys = recipe_keys(*every.T, num_entities=4)
    mirrored = recipe_keys(*every[:, [1, 0, 2]].T, num_entities=4)
    assert np.array_equal(keys, mirrored)
    ordered = every[every[:, 0] <= every[:, 1]]
    of_ordered = recipe_keys(*ordered.T, num_entities=4)
    assert np.all(np.diff(of_ordered) > 0)
    assert len(np.unique(keys)) == len(ordered)
