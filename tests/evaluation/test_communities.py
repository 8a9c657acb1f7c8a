import numpy as np

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
