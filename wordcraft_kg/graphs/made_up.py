"""Recipe books with made-up words: the same recipes without the meaning of words.

A control for language models and word vectors, which may know the words from elsewhere.
"""

import re
from dataclasses import replace
from hashlib import sha256
from itertools import chain

import numpy as np

from wordcraft_kg.graphs.recipes import Recipe, RecipeBook

PREFIX = "made-up"
_STARTS = [
    "b",
    "d",
    "f",
    "g",
    "k",
    "l",
    "m",
    "n",
    "p",
    "r",
    "s",
    "t",
    "v",
    "z",
    "br",
    "dr",
    "gl",
    "kr",
    "pl",
    "tr",
]
_VOWELS = ["a", "e", "i", "o", "u"]
_ENDS = ["k", "l", "m", "n", "p", "r", "t", "x"]


def with_made_up_words(book: RecipeBook, seed: int = 0) -> RecipeBook:
    """Return a copy of a book in which each word of the labels is an invented, pronounceable word.

    A word gets the same replacement in all labels, so that the last words of "cake" and "birthday
    cake" stay equal. The invented words have the alphabetical order of the words, so that entity
    ids, splits and tasks stay the same. No invented word is a word of the book. Kinds of recipes
    and base entities stay.

    Args:
        book: the book.
        seed: random seed, from 0; another seed gives other words.

    Example:
        >>> print(with_made_up_words(open_book("kitchen")).recipes[0])
        betgegil + lenkrodim -> siksevan
    """
    words = set(chain.from_iterable(map(str.split, book.entities)))
    ordered_words = sorted(words)
    # The words are part of the seed, so that two books do not share invented words.
    digest = sha256("\n".join(ordered_words).encode()).digest()
    rng = np.random.default_rng([seed, *digest])
    invented: set[str] = set()
    while len(invented) < len(words):
        word = _word(rng)
        if word not in words:
            invented.add(word)
    # Both sorted: the n-th word in the alphabet becomes the n-th invented word.
    replacement = dict(zip(ordered_words, sorted(invented), strict=True))

    def renamed(label: str) -> str:
        return re.sub(r"\S+", lambda word: replacement[word[0]], label)

    recipe_of: dict[Recipe, Recipe] = {}
    for recipe in book.recipes:
        recipe_of[recipe] = Recipe.of(*map(renamed, recipe))
    base = None
    if book.base is not None:
        base = tuple(sorted(map(renamed, book.base)))
    hash_of_book = None
    if book.sha256 is not None:
        # Another book than the original, so another hash; the same for the same original and seed.
        origin = f"{PREFIX} {seed} {book.sha256}"
        hash_of_book = sha256(origin.encode()).hexdigest()
    prefix = f"{PREFIX}-{seed}" if seed else PREFIX
    return replace(
        book,
        name=f"{prefix}-{book.name}",
        recipes=tuple(sorted(recipe_of.values())),
        base=base,
        idle=tuple(sorted(map(renamed, book.idle))),
        sha256=hash_of_book,
        kinds={recipe_of[recipe]: kind for recipe, kind in book.kinds.items()},
        quantities={recipe_of[recipe]: numbers for recipe, numbers in book.quantities.items()},
    )


def _word(rng: np.random.Generator) -> str:
    """Draw one of 64 million words with three syllables."""
    letters = (_STARTS, _VOWELS, _ENDS, _STARTS, _VOWELS, _STARTS, _VOWELS, _ENDS)
    return "".join(str(rng.choice(choices)) for choices in letters)
