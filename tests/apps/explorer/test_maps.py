"""The map: places, groups, links and colours."""

import numpy as np
import pytest

from wordcraft_kg.apps.explorer.pages import map as maps
from wordcraft_kg.apps.explorer.pages.map import (
    HEIGHT,
    WIDTH,
    communities_of,
    map_of,
    view_map,
)
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RecipeGraph


@pytest.fixture(scope="module")
def kitchen_map(kitchen):
    return map_of(kitchen)


def test_each_entity_has_a_place_on_the_map_the_most_used_first(kitchen, kitchen_map):
    view = kitchen_map
    assert sorted(spot.entity for spot in view.spots) == list(kitchen.entities)
    uses = [kitchen.use_counts[kitchen.id_of(spot.entity)] for spot in view.spots]
    assert [spot.uses for spot in view.spots] == uses == sorted(uses, reverse=True)
    assert all(0 <= spot.x <= WIDTH and 0 <= spot.y <= HEIGHT for spot in view.spots)
    assert len({(spot.x, spot.y) for spot in view.spots}) > 0.9 * len(view.spots)
    checked_values(view)


def test_linked_entities_and_groups_lie_near(kitchen, kitchen_map):
    """Entities that are linked lie nearer than others and so do those of a group."""
    places, view = np.array([(spot.x, spot.y) for spot in kitchen_map.spots]), kitchen_map
    far = np.linalg.norm(places[:, None] - places[None], axis=2)
    linked = np.zeros_like(far, dtype=bool)
    for one, other in (*view.combines, *view.components):
        linked[one, other] = linked[other, one] = True
    group = np.array([spot.group for spot in view.spots])
    same = (group[:, None] == group[None]) & ~np.eye(len(group), dtype=bool)
    assert far[linked].mean() < 0.8 * far[~linked].mean()
    assert far[same].mean() < 0.6 * far[group[:, None] != group[None]].mean()


def test_the_map_holds_the_links_between_different_entities(kitchen, kitchen_map):
    names = [spot.entity for spot in kitchen_map.spots]
    triples = [
        (kitchen.entities[a], relation, kitchen.entities[b])
        for a, relation, b in kitchen.triples.tolist()
    ]
    combines = {frozenset((names[a], names[b])) for a, b in kitchen_map.combines}
    assert combines == {
        frozenset((a, b)) for a, relation, b in triples if relation == COMBINES_WITH and a != b
    }
    assert len(combines) == len(kitchen_map.combines)
    components = [(names[a], names[b]) for a, b in kitchen_map.components]
    assert sorted(components) == sorted(
        (a, b) for a, relation, b in triples if relation == COMPONENT_OF and a != b
    )


def test_the_links_of_a_chosen_entity_are_those_of_its_recipes(kitchen, kitchen_map):
    assert view_map(kitchen, kitchen_map).chosen is None
    for entity in kitchen.entities:
        view = view_map(kitchen, kitchen_map, entity)
        uses = [recipe for recipe in kitchen.recipe_labels() if entity in recipe[:2]]
        combines = {b if a == entity else a for a, b, _ in uses}
        makes = {result for _, _, result in uses}
        made_of = {
            label
            for a, b, result in kitchen.recipe_labels()
            if result == entity
            for label in (a, b)
        }
        assert view.spots[view.chosen.entity].entity == entity
        kinds = (view.chosen.combines, view.chosen.makes, view.chosen.made_of)
        for expected, kind in zip((combines, makes, made_of), kinds, strict=True):
            assert (
                {view.spots[number].entity for number in kind.placed}
                == set(kind.listed)
                == expected
            )
            assert kind.total == len(expected)
            uses = [kitchen.use_counts[kitchen.id_of(label)] for label in kind.listed]
            assert uses == sorted(uses, reverse=True)


def test_groups_have_their_spots_sizes_and_three_names(kitchen_map):
    """Groups have the sizes of their spots and are named after three members."""
    view = kitchen_map
    for number, group in enumerate(view.groups):
        members = [spot for spot in view.spots if spot.group == number]
        assert group.size == len(members)
        assert len(group.names) == min(3, group.size)
        assert set(group.names) <= {spot.entity for spot in members}
        assert min(spot.x for spot in members) <= group.x <= max(spot.x for spot in members)


def test_above_the_limit_the_most_used_are_placed(kitchen, monkeypatch):
    """Above the limit the most used are placed and a chosen one is a guest."""
    monkeypatch.setattr(maps, "PLACED", 20)
    monkeypatch.setattr(maps, "GUESTS", 4)
    found = map_of(kitchen)
    spots, has_guests = found.spots, 0
    assert (len(spots), found.entities) == (20, kitchen.num_entities)
    assert min(spot.uses for spot in spots) == sorted(kitchen.use_counts.tolist(), reverse=True)[19]
    for entity in kitchen.entities:
        view = view_map(kitchen, found, entity)
        guests = [spot for spot in view.spots[20:] if spot.group == -1]
        assert len(guests) == len(view.spots) - 20 <= 4
        assert entity in {spot.entity for spot in view.spots}
        assert view.spots[:20] == spots
        assert len({spot.entity for spot in view.spots}) == len(view.spots)
        for kind in (view.chosen.combines, view.chosen.makes, view.chosen.made_of):
            assert len(kind.listed) == kind.total
            assert all(place < len(view.spots) for place in kind.placed)
        checked_values(view)
        has_guests += len(guests) > 1
    assert has_guests > 40


@pytest.mark.parametrize(
    "rows",
    [[], [("a", "b", "c")], [("a", "a", "b")], [("a", "b", "c"), ("d", "d", "d"), ("e", "e", "f")]],
)
def test_small_and_disconnected_graphs_have_maps(rows):
    graph = RecipeGraph.from_recipes(rows)
    found = map_of(graph)
    assert sorted(spot.entity for spot in found.spots) == list(graph.entities)
    assert all(0 <= spot.x <= WIDTH and 0 <= spot.y <= HEIGHT for spot in found.spots)
    for entity in graph.entities:
        checked_values(view_map(graph, found, entity))


def test_of_very_many_links_a_map_holds_and_draws_some(kitchen, monkeypatch):
    monkeypatch.setattr(maps, "ALL_LINKS", 100)
    monkeypatch.setattr(maps, "DRAWN", 3)
    monkeypatch.setattr(maps, "LISTED", 2)
    found = map_of(kitchen)
    assert found.combines == found.components == ()
    most = kitchen.entities[int(kitchen.use_counts.argmax())]
    chosen = view_map(kitchen, found, most).chosen
    assert (len(chosen.combines.placed), len(chosen.combines.listed)) == (3, 2)
    assert chosen.combines.total > 3
    assert (
        tuple(found.spots[number].entity for number in chosen.combines.placed)[:2]
        == chosen.combines.listed
    )


TWO_CLIQUES = np.array(
    [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (3, 6), (4, 5), (4, 6), (5, 6), (2, 3)]
)


def test_linked_entities_form_a_group_typical_members_first():
    """Entities that are linked among each other are a group with typical members first."""
    group_of, typical = communities_of(7, TWO_CLIQUES)
    assert group_of.tolist() == [1, 1, 1, 0, 0, 0, 0]
    # 3 and 2 have a link to the other group, too; of equally typical members, the first come first
    assert [members.tolist() for members in typical] == [[4, 5, 6, 3], [0, 1, 2]]
