"""Random recipes, graphs and labels for hypothesis."""

from dataclasses import replace
from itertools import product

from hypothesis import strategies as st

from wordcraft_kg.graphs import Recipe, RecipeBook, RecipeGraph, SplitConfig

FEW = tuple("abcdefgh")
MANY = tuple("abcdefghijklmno")
IDLE = ("y", "z")


def rows(letters=FEW, **size):
    # One integer a row: hypothesis draws it several times faster than three labels.
    possible = list(product(letters, repeat=3))
    return st.lists(st.integers(0, len(possible) - 1).map(possible.__getitem__), **size)


@st.composite
def graphs(draw, letters=FEW, min_size=0, max_size=24):
    """Graphs with self results, duplicates, self pairs, ambiguous pairs, idle entities, kinds, any
    base or none."""
    recipes = draw(rows(letters, min_size=min_size, max_size=max_size))
    listed = draw(st.sets(st.sampled_from(IDLE)))
    entities = sorted({label for recipe in recipes for label in recipe} | listed)
    base = draw(st.none() | st.sets(st.sampled_from(entities))) if entities else None
    book = RecipeBook.of("random", recipes, base=base, listed=listed, keep_self_results=True)
    return RecipeGraph.from_book(
        replace(book, kinds={recipe: recipe[0] for recipe in book.recipes})
    )


@st.composite
def graphs_of_sets(draw, min_size=1):
    """Graphs with sets of one to eight ingredients, self results and repetitions."""
    row = st.tuples(st.lists(st.sampled_from(FEW), min_size=1, max_size=8))
    rows = draw(st.lists(st.tuples(row, st.sampled_from(FEW)), min_size=min_size, max_size=20))
    recipes = [Recipe(parts, result) for (parts,), result in rows]
    base = draw(st.none() | st.sets(st.sampled_from(sorted({x for row in recipes for x in row}))))
    book = RecipeBook.of("sets", recipes, base=base, keep_self_results=True)
    return RecipeGraph.from_book(replace(book, kinds={each: each[0] for each in book.recipes}))


ANY_GRAPHS = graphs() | graphs_of_sets()
"""Graphs of pairs alone, and graphs of sets of any sizes."""


def splittable_graphs():
    """Graphs large enough that no part of a split comes out empty by rounding."""
    return graphs(MANY, min_size=30, max_size=50)


def configs(kind):
    ratio = st.sampled_from([0.4, 0.5, 0.6, 0.7])
    return st.builds(
        SplitConfig, st.just(kind), ratio, st.sampled_from([0.0, 0.1, 0.2]), st.integers(0, 2**32)
    )


AWKWARD = st.sampled_from(" ,\"'#\\;:&<>|é火🍞\u00a0\ufeff\u200b0aB")
PRINTED = st.characters(
    exclude_categories=["Cc", "Cs", "Zl", "Zp"], exclude_characters="\ufffe\uffff"
)


def labels():
    """Any label that a book may hold: commas, quotes, outer blanks, '#', and anything of Unicode
    but controls."""
    return st.text(AWKWARD | PRINTED, min_size=1, max_size=6).filter(
        lambda label: not label.isspace()
    )


def _canonical(row):  # Hypothesis takes the text of a lambda for a regular expression
    return Recipe.of(*row)


@st.composite
def books(draw, name="book"):
    known = draw(st.lists(labels(), min_size=1, max_size=8, unique=True))
    label = st.sampled_from(known)
    recipes = draw(
        st.lists(st.tuples(label, label, label), min_size=1, max_size=10, unique_by=_canonical)
    )
    base = draw(st.none() | st.sets(label))
    listed = draw(st.sets(label))
    book = RecipeBook.of(name, recipes, base=base, listed=listed, keep_self_results=True)
    return replace(book, kinds=draw(st.dictionaries(st.sampled_from(book.recipes), labels())))
