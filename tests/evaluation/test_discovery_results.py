"""Results of open-ended play."""

import numpy as np
from helpers import refuses

from wordcraft_kg.evaluation.discovery import open_guide, view_discovery
from wordcraft_kg.graphs import Recipe, RecipeGraph


def test_a_scorer_of_other_results_is_counted(recipes_folder, kitchen):
    # Each result is a made entity, and every second recipe takes the one of the next.
    rows = kitchen.recipe_labels()
    turned = [*rows[1:], rows[0]]
    changed = [
        row if place % 2 else Recipe(row.ingredients, following.result)
        for place, (row, following) in enumerate(zip(rows, turned, strict=True))
    ]
    wrong = RecipeGraph.from_recipes(changed, kitchen.base)
    guide = open_guide(recipes_folder, wrong)
    trained = {tuple(kitchen.labels(row)) for row in guide.recipes.scorer.recipes.tolist()}
    recipes = {tuple(wrong.labels(row)) for row in wrong.recipes.tolist()}
    assert guide.shared == len(trained & recipes)
    pairs = {recipe[:2] for recipe in trained} & {recipe[:2] for recipe in recipes}
    assert guide.contradicted == len(pairs - {recipe[:2] for recipe in trained & recipes}) > 0


def test_a_world_of_one_entity_or_of_thousands_of_results_of_a_pair():
    one = RecipeGraph(["water"], np.empty((0, 3), dtype=np.int64), [0], "one")
    with refuses("base"):
        view_discovery(one, ["greedy"])
    rows = [("a", "b", f"thing {number}") for number in range(5_000)]
    many = RecipeGraph.from_recipes(rows, ["a", "b"])
    view = view_discovery(many, ["random-no-repeat", "greedy"], attempts=4, runs=1)
    assert view.players["greedy"]["1"].mean == 5_002
