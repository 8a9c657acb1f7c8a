"""Make a large synthetic recipe book: every entity but the base is made by earlier ones, so that
all are reachable.

python benchmarks/synthetic_book.py --entities 100000 --recipes 1000000 --out big.csv
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


def write_book(
    out: Path, entities: int, recipes: int, base: int = 10, seed: int = 0, kinds: int = 0
) -> None:
    """Write a synthetic book as CSV."""
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
    )


if __name__ == "__main__":
    main()
