"""Recipe books with made-up words: the same recipes without the meaning of words, a control for memorised words."""

from dataclasses import replace
from hashlib import sha256

import numpy as np

from wordcraft_kg.graphs.recipes import Recipe, RecipeBook

PREFIX = "made-up"
_STARTS = ["b", "d", "f", "g", "k", "l", "m", "n", "p", "r", "s", "t", "v", "z", "br", "dr", "gl", "kr", "pl", "tr"]
_VOWELS = ["a", "e", "i", "o", "u"]
_ENDS = ["k", "l", "m", "n", "p", "r", "t", "x"]


def with_made_up_words(book: RecipeBook, seed: int = 0) -> RecipeBook:
    """Return a copy of a book in which each word of the labels is replaced by an invented, pronounceable word.

    A word gets the same replacement in all labels, so that the last words of "cake" and "birthday cake" stay equal. No
    invented word is a word of the book. Kinds of recipes and base entities stay.

    Example:
        >>> print(with_made_up_words(open_book("kitchen")).recipes[0])
        banglidrel + brekgekret -> zumdraran
    """
    words = sorted({word for label in book.entities for word in label.split()})
    rng, taken, invented = np.random.default_rng(seed), set(words), {}
    for word in words:
        while (new := _word(rng)) in taken:
            pass
        taken.add(new)
        invented[word] = new

    def renamed(label: str) -> str:
        return " ".join(invented[word] for word in label.split())

    recipe_of = {recipe: Recipe.of(*map(renamed, recipe)) for recipe in book.recipes}
    return replace(
        book,
        name=f"{PREFIX}-{book.name}",
        recipes=tuple(sorted(recipe_of.values())),
        base=None if book.base is None else tuple(sorted(map(renamed, book.base))),
        idle=tuple(sorted(map(renamed, book.idle))),
        sha256=None if book.sha256 is None else sha256(f"{PREFIX} {seed} {book.sha256}".encode()).hexdigest(),
        kinds={recipe_of[recipe]: kind for recipe, kind in book.kinds.items()},
    )


def _word(rng: np.random.Generator) -> str:
    letters = (_STARTS, _VOWELS, _ENDS, _STARTS, _VOWELS, _STARTS, _VOWELS, _ENDS)
    return "".join(str(rng.choice(some)) for some in letters)
