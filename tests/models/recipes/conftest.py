"""Small books that tests of recipe scorers share, and a model of sets."""

import csv
import itertools

import pytest
from link_helpers import write_random_book

from wordcraft_kg import open_model
from wordcraft_kg.graphs import (
    RecipeGraph,
    SplitConfig,
    make_split,
    open_book,
    write_graph_folder,
)
from wordcraft_kg.models.recipes import set_fitting
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_training import train_recipes

LETTERS = "abcdefgh"


@pytest.fixture(scope="session")
def book(tmp_path_factory):
    """A book so small that a fit takes a moment."""
    return write_random_book(tmp_path_factory.mktemp("books") / "small.csv", seed=1)


def write_letters(folder):
    """Write a book of words of two and three letters, and the parts of all entities."""
    parts = {f"{letter}{carrier}": (letter, carrier) for letter in LETTERS for carrier in "xy"}
    rows = []
    for size in (2, 3):
        for word in itertools.combinations(LETTERS, size):
            goal = "G" + "".join(word)
            carrier = "x" if word[0] in "abd" else "y"
            cards = [letter + carrier for letter in word]
            rows.append([*cards, *[""] * (3 - size), goal])
            parts[goal] = word
    parts |= {"Gnew": ("a", "c"), "new card": ("b", "x"), "strange": ("q",)}
    folder.mkdir()
    with (folder / "letters.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["ingredient_a", "ingredient_b", "ingredient_c", "result"]])
        csv.writer(file).writerows(rows)
    with (folder / "parts.csv").open("w", newline="") as file:
        lines = [(label, part, 1) for label, names in parts.items() for part in names]
        csv.writer(file).writerows([("label", "part", "amount"), *lines])


@pytest.fixture(scope="session")
def letters(made_once):
    """A folder with the book of letters, its parts, its graph and a model of sets; read only."""

    def make(folder):
        write_letters(folder)
        book = open_book(folder / "letters.csv")
        split = make_split(RecipeGraph.from_book(book), SplitConfig("by-goal"))
        write_graph_folder(folder / "graph", book, split)
        settings = RecipeScorerConfig(folds=5, parts=str(folder / "parts.csv"))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(set_fitting, "_EPOCHS", 12)
            train_recipes(RecipesConfig(str(folder / "graph"), settings), folder / "model")

    return made_once("letters", make)


@pytest.fixture(scope="session")
def letters_model(letters):
    return open_model(letters / "model")
