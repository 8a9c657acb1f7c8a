"""Half-products of chains in environments: on a table only if the player made them."""

import pytest

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeBook, RecipeGraph
from wordcraft_kg.graphs.chains import chain


@pytest.fixture(scope="module")
def graph():
    rows = [*chain(["coal", "plank", "rope"], "lamp"), *chain(["coal", "plank"], "fire")]
    return RecipeGraph.from_book(RecipeBook.of("lights", rows))


def test_half_products_are_no_room_for_distractors(graph):
    with pytest.raises(ConfigError, match=r"has 5 entities, of which .* at most 2"):
        World.open(graph, WordCraftConfig(num_distractors=3))


def test_a_table_may_hold_all_things_and_no_half_product(graph):
    env = WordCraftEnv(graph, num_distractors=2)
    env.reset(seed=0)
    table = [entity for entity in env.state.table if entity < graph.num_entities]
    assert len(table) == 4
    assert not graph.is_half_product[table].any()
