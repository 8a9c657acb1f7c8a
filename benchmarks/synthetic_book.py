"""Make a large synthetic recipe book: every entity but the base is made by earlier ones, so that
all are reachable.

python benchmarks/synthetic_book.py --entities 100000 --recipes 1000000 --out big.csv
python benchmarks/synthetic_book.py --entities 800000 --recipes 6700000 --hubs --out huge.csv
"""

import argparse
from pathlib import Path

import numpy as np


def synthetic_rows(entities: int, recipes: int, base: int, seed: int, kinds: int = 0) -> np.ndarray:
    """Return distinct rows (a, b, result), a <= b, each result younger than both ingredients; shape
    (recipes, 3).

    With ``kinds``, an entity's kind is the id modulo ``kinds``, and kinds 7 k + 1 and 11 k + 3 make
    results with kind k, so models can learn more than entity frequencies.
    """
    rng = np.random.default_rng(seed)

    def rows_for(results: np.ndarray) -> np.ndarray:
        # Ingredients favour old entities, as real books do: the square of a uniform number.
        parts = (rng.random((len(results), 2)) ** 2 * results[:, None]).astype(np.int64)
        if kinds:
            older = parts - (parts - results[:, None] * [7, 11] - [1, 3]) % kinds
            parts = np.where(older >= 0, older, parts)
        return np.column_stack([np.sort(parts, axis=1), results])

    rows = np.unique(rows_for(np.arange(base, entities)), axis=0)
    while len(rows) < recipes:
        rows = np.unique(
            np.concatenate([rows, rows_for(rng.integers(base, entities, recipes))]), axis=0
        )
    # One recipe of each entity stays, so that all are reachable; the rest is a sample.
    first_of_each = np.unique(rows[:, 2], return_index=True)[1]
    others = np.setdiff1d(np.arange(len(rows)), first_of_each)
    sample = rng.permutation(others)[: recipes - len(first_of_each)]
    return rows[np.sort(np.concatenate([first_of_each, sample]))]


HUBS = 16
"""Entities with 12 % of all uses and 4 % of all recipes, as in Infinite Craft: water, fire, ..."""
USED = 0.45
"""Fraction of the entities that are ingredients; the others are results alone."""
MADE_OFTEN = 0.31
"""Fraction of the entities that more than one recipe makes."""


def hub_rows(entities: int, recipes: int, base: int, seed: int) -> np.ndarray:
    """Return distinct rows (a, b, result), a <= b, with the hubs and the long tail of Infinite
    Craft: few entities take part in most recipes, most are never used and made by one; shape
    (recipes, 3).

    As there, an entity may be made by younger ones, too, but not from itself.
    """
    rng = np.random.default_rng(seed)

    def drawn(older: np.ndarray, fraction: float, of_hubs: float) -> np.ndarray:
        # The cube of a uniform number: the first 3 % of the entities get two fifths of the draws.
        ranks = rng.random(len(older)) ** 3 * fraction * older
        hubs = rng.integers(base, HUBS + base, len(older))
        is_hub = (rng.random(len(older)) < of_hubs) & (hubs < older)
        return np.where(is_hub, hubs, ranks.astype(np.int64))

    def rows_for(results: np.ndarray, older: np.ndarray) -> np.ndarray:
        parts = np.column_stack([drawn(older, USED, 0.12) for _ in range(2)])
        rows = np.column_stack([np.sort(parts, axis=1), results])
        return rows[(parts != results[:, None]).all(axis=1)]

    # A recipe of older entities for each, so that all are reachable.
    results = np.arange(base, entities)
    seen = np.unique(rows_for(results, results), axis=0)
    while len(seen) < recipes:
        every = np.full(recipes - len(seen), entities)
        others = drawn(every - base, MADE_OFTEN, 0.04) + base
        seen = np.unique(np.concatenate([seen, rows_for(others, every)]), axis=0)
    return seen


def write_book(
    out: Path,
    entities: int,
    recipes: int,
    base: int = 10,
    seed: int = 0,
    kinds: int = 0,
    *,
    hubs: bool = False,
) -> None:
    """Write a synthetic book as CSV."""
    if hubs:
        rows = hub_rows(entities, recipes, base, seed)
    else:
        rows = synthetic_rows(entities, recipes, base, seed, kinds)
    names = [f"entity {i}" for i in range(entities)]
    with out.open("w", encoding="utf-8") as file:
        file.write(f"# base: {', '.join(names[:base])}\ningredient_a,ingredient_b,result\n")
        file.writelines(f"{names[a]},{names[b]},{names[c]}\n" for a, b, c in rows.tolist())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entities", type=int, default=100_000)
    parser.add_argument("--recipes", type=int, default=1_000_000)
    parser.add_argument("--base", type=int, default=10)
    parser.add_argument(
        "--kinds", type=int, default=0, help="kinds of entities, which decide what makes what"
    )
    parser.add_argument("--hubs", action="store_true", help="hubs and a tail, as Infinite Craft")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    write_book(
        arguments.out,
        arguments.entities,
        arguments.recipes,
        arguments.base,
        arguments.seed,
        arguments.kinds,
        hubs=arguments.hubs,
    )


if __name__ == "__main__":
    main()
