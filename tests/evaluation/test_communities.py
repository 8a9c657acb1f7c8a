import numpy as np

from wordcraft_kg.evaluation.bins import OPEN_END, binned
from wordcraft_kg.evaluation.communities import communities_of

TWO_CLIQUES = np.array([(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (3, 6), (4, 5), (4, 6), (5, 6), (2, 3)])


def test_entities_that_are_linked_among_each_other_are_a_group_named_after_typical_members():
    found = communities_of("abcdefg", TWO_CLIQUES, 0)
    assert found.group_of.tolist() == [1, 1, 1, 0, 0, 0, 0]
    # d and c have a link to the other group, too; of equally typical members, the first come first
    assert found.names == (("e", "f", "g"), ("a", "b", "c"))
    assert found.sizes == [4, 3]


def test_an_entity_without_links_is_a_group_of_its_own():
    found = communities_of("abc", np.array([(0, 1)]), 0)
    assert found.group_of.tolist() == [0, 0, 1]


def test_bins_hold_their_bounds_and_are_named_by_them():
    values = np.array([0, 1, 2, 3, 4, 9, 10, 1_000])
    found = {name: values[mask].tolist() for name, mask in binned(values, ((0, 0), (1, 3), (5, 9), (10, OPEN_END)))}
    assert found == {"0": [0], "1–3": [1, 2, 3], "5–9": [9], "10+": [10, 1_000]}


def test_the_name_of_the_last_bin_can_be_in_words():
    assert [name for name, _ in binned(np.arange(3), ((2, OPEN_END),), more=" or more")] == ["2 or more"]
