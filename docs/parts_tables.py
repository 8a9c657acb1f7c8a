"""Tables of *what each part adds*, from docs/evidence/data/parts.csv (benchmarks/parts.py).

The same rows stand on the page of evidence, in README and in which-model.md.
"""

import csv
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path

Row = dict[str, str]
DATA = Path(__file__).parent / "evidence" / "data" / "parts.csv"
COLUMNS = {
    ("little-alchemy-2", "by-recipe"): "Little Alchemy 2, unseen recipes",
    ("little-alchemy-2", "by-goal"): "unseen goals",
    ("everyday", "by-recipe"): "`everyday`, unseen recipes",
    ("everyday", "by-goal"): "unseen goals of `everyday`",
}
"""Book and split of each column."""
ROWS = {
    "random pair": "two different items at random",
    "nearest words (glove)": "the two nearest words, GloVe",
    "nearest words (its vectors)": "the two nearest words, the scorer's vectors",
    "PPO": "plain PPO (`examples/ppo.py`)",
    "learner alone": "agent without a graph",
    "learner with ComplEx": "agent with ComplEx",
    "learner with the recipe scorer": "agent with the recipe scorer",
    "recipe scorer alone": "recipe scorer alone",
    "planner": "planner, the recipe scorer's plans without training",
    "learner with the recipe scorer and plans": "agent with the recipe scorer and plans",
}
"""Players of the table, in its order, with their names for people."""
SHORT = {
    "random pair": "random pair",
    "nearest words (glove)": "nearest words",
    "PPO": "plain PPO",
    "learner alone": "agent without a graph",
    "learner with ComplEx": "agent with ComplEx",
    "recipe scorer alone": "recipe scorer alone",
    "learner with the recipe scorer": "agent with recipe scorer",
    "planner": "planner, untrained",
    "learner with the recipe scorer and plans": "agent with plans",
}
"""Names in README, whose words are few."""


@cache
def _rows() -> list[Row]:
    with DATA.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def cells(depth: int, distractors: int) -> dict[tuple[str, str, str, str], Row]:
    """Return the figures of a setting by book, split, row and the row that it is compared with."""
    setting = str(depth), str(distractors)
    return {
        (row["book"], row["split"], row["row"], row["minus"]): row
        for row in _rows()
        if (row["depth"], row["distractors"]) == setting
    }


def measured(figures: dict[tuple[str, str, str, str], Row]) -> dict[tuple[str, str], str]:
    """Return the columns that have figures."""
    books = {key[:2] for key in figures}
    return {column: title for column, title in COLUMNS.items() if column in books}


def share(value: str, is_signed: bool = False) -> str:
    """Return a share with three digits, such as `.471` or `+.024`."""
    return f"{float(value):{'+' * is_signed}.3f}".replace("0.", ".", 1)


def interval(row: Row, is_signed: bool = False) -> str:
    """Return a figure with its interval."""
    value, low, high = (share(row[name], is_signed) for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def successes(depth: int, distractors: int) -> Iterator[str]:
    """Yield the table of all players at a setting."""
    figures = cells(depth, distractors)
    columns = measured(figures)
    yield f"| player | {' | '.join(columns.values())} |"
    yield "|---" * (len(columns) + 1) + "|"
    for name, title in ROWS.items():
        rows = [figures.get((*column, name, "")) for column in columns]
        if any(rows):
            texts = [interval(row) if row else "" for row in rows]
            yield f"| {title} | {' | '.join(texts)} |"


def differences(depth: int, distractors: int) -> Iterator[str]:
    """Yield the table of paired differences at a setting."""
    figures = cells(depth, distractors)
    pairs = dict.fromkeys((row, minus) for _, _, row, minus in figures if minus)
    columns = measured(figures)
    yield f"| difference | {' | '.join(columns.values())} |"
    yield "|---" * (len(columns) + 1) + "|"
    for row, minus in pairs:
        texts = [
            interval(figures[(*column, row, minus)], is_signed=True)
            if (*column, row, minus) in figures
            else ""
            for column in columns
        ]
        yield f"| {ROWS[row]} minus {ROWS[minus]} | {' | '.join(texts)} |"


def parts_in_short() -> Iterator[str]:
    """Yield README's table: Little Alchemy 2 without intervals, one and two attempts."""
    columns = {
        ("by-recipe", 1, 8): "unseen recipes",
        ("by-goal", 1, 8): "unseen goals",
        ("by-recipe", 2, 4): "two attempts",
        ("by-goal", 2, 4): "two, unseen goals",
    }
    figures = {}
    for split, depth, distractors in columns:
        for name in SHORT:
            row = cells(depth, distractors).get(("little-alchemy-2", split, name, ""))
            if row is not None:
                figures[split, depth, distractors, name] = share(row["value"])
    measured = [column for column in columns if any(key[:3] == column for key in figures)]
    yield f"| player | {' | '.join(columns[column] for column in measured)} |"
    yield "|---" * (len(measured) + 1) + "|"
    for name, title in SHORT.items():
        texts = [figures.get((*column, name), "") for column in measured]
        if any(texts):
            yield f"| {title} | {' | '.join(texts)} |"


def answer() -> Iterator[str]:
    """Yield the answer of the page: Little Alchemy 2, unseen recipes, 8 distractors."""
    figures = cells(1, 8)

    def success(row: str) -> str:
        return share(figures["little-alchemy-2", "by-recipe", row, ""]["value"])

    def gain(book: str, split: str) -> str:
        pair = "learner with the recipe scorer", "recipe scorer alone"
        return interval(figures[(book, split, *pair)], is_signed=True)

    yield (
        "**Answer.** At depth 1 nearly all comes from the scorer. Of goals with unseen recipes "
        "(Little Alchemy 2, 8 distractors), two different items at random make "
        f"{success('random pair')}, nearest words {success('nearest words (glove)')}, PPO "
        f"{success('PPO')}, an agent without a graph {success('learner alone')}, with ComplEx "
        f"{success('learner with ComplEx')}, the recipe scorer alone "
        f"{success('recipe scorer alone')}, and an agent with it "
        f"{success('learner with the recipe scorer')}: learning in play adds "
        f"{gain('little-alchemy-2', 'by-recipe')} to the scorer, and with unseen goals "
        f"{gain('little-alchemy-2', 'by-goal')} (`everyday`: {gain('everyday', 'by-goal')}). "
        "Where a goal takes two attempts, nearly all comes from [planning](planning.md)."
    )


PARTS_TABLES: dict[str, Callable[[], Iterator[str]]] = {
    f"parts {kind} {depth}, {distractors}": partial(make, depth, distractors)
    for kind, make in {"success": successes, "differences": differences}.items()
    for depth, distractors in ((1, 8), (1, 1), (2, 4))
} | {"parts answer": answer}
"""The tables by name."""
