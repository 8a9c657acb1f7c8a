import pytest
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs import RecipeGraph

RECIPES = [
    *(("fire", "water", "steam"), ("fire", "water", "fog")),  # an ambiguous pair
    *(
        ("fire", "fire", "blaze"),
        ("blaze", "steam", "train"),
        ("moon", "water", "tide"),
    ),  # the last is never reached
]
GRAPH = RecipeGraph.from_recipes(RECIPES, base=["fire", "water"], name="small")
NAMES = ("fire", "water", "steam", "fog", "blaze", "train", "moon")
FIRE, WATER, STEAM, FOG, BLAZE, TRAIN, MOON = map(GRAPH.id_of, NAMES)


@given(st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 2**16)), max_size=60))
def test_every_attempt_equals_a_slow_reading_of_the_book(kitchen, pairs):
    game = Discovery(kitchen)
    known = set(kitchen.base_ids.tolist())
    tried = set()
    for x, y in pairs:
        choices = sorted(known)
        one, other = choices[x % len(choices)], choices[y % len(choices)]
        rows = kitchen.recipes.tolist()
        made = {result for a, b, result in rows if (a, b) in ((one, other), (other, one))}
        new, repeated = game.combine(one, other)
        assert set(new) == made - known
        assert repeated is (frozenset((one, other)) in tried)
        known |= made
        tried.add(frozenset((one, other)))
        assert set(game.known) == known


def test_the_game_is_complete_when_everything_reachable_is_known():
    game = Discovery(GRAPH)
    for pair in ((FIRE, WATER), (FIRE, FIRE), (BLAZE, STEAM)):
        assert not game.is_complete
        game.combine(*pair)
    assert game.is_complete
    # The moon and its tide are out of reach.
    assert len(game.known) == game.reachable == GRAPH.num_entities - 2
    game.restart()
    assert list(game.known) == list(game.base) == sorted([FIRE, WATER])


@pytest.mark.parametrize("base", [["moon", "water"], [MOON, WATER], {"water", "moon"}])
def test_another_base_may_be_given_by_label_or_id(base):
    game = Discovery(GRAPH, base)
    assert set(game.known) == {MOON, WATER}
    assert len(game.combine(MOON, WATER)[0]) == 1
    assert game.is_complete


@pytest.mark.parametrize(
    ("base", "says"),
    [
        (["fire", "watre"], "`base`: no entity 'watre' in small. Did you mean 'water'"),
        ([99], "`base`: no entity id 99"),
        (["moon"], "`base` moon: nothing new can be made"),
        ([], r"`base` \(empty\): nothing new can be made"),
    ],
)
def test_a_bad_base_says_what_was_expected(base, says):
    with pytest.raises(ConfigError, match=says):
        Discovery(GRAPH, base)
