"""Tables of the evidence pages that follow from a JSON file of measurements.

A page marks the place: ``<!-- table: NAME -->`` ... ``<!-- end of table -->``, with a name of TABLES.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from wordcraft_kg.base.statistics import split_interval, student_interval

HERE = Path(__file__).parent
Row = dict[str, Any]
OUTSIDE = {
    "recipes alone": "recipes alone, no words",
    "and GloVe": "and GloVe",
    "and words": "and MiniLM",
    "language model": "and a language model",
    "WordNet": "and WordNet",
    "book": "and the other book",
    "GloVe and book": "the other book, with GloVe instead of MiniLM",
    "all": "**all of them**",
    "zero-shot": "zero-shot: the other book alone",
    "zero-shot unshared": "zero-shot, without shared recipes",
    "zero-shot all": "zero-shot, with language model and WordNet",
    "control random weights": "control: language model with random weights",
    "control made-up": "control: language model reads made-up names",
    "control shuffled labels": "control: its tables under shuffled labels",
    "control shuffled words": "control: shuffled vectors",
}
"""Rows of outside-knowledge.json, and their names on the page."""
BY_GOAL = {
    "made 8": "8, goals that the other book makes",
    "other 8": "8, other goals",
}
PLAYERS = {
    "chance": "chance",
    "w": "w: the best pair for the goal",
    "planner, train recipes": "planner, train recipes only",
    "planner": "**planner**",
}
IN_AGENTS = {
    "agent, no graph": "no graph",
    "agent, u,v": "u, v",
    "agent, u,v,w": "u, v, w",
    "w, all tasks": "w alone",
    "agent, u,v,w,p": "u, v, w, p",
    "planner, all tasks": "planner",
}
BOOKS = {"little-alchemy-2": "Little Alchemy 2", "everyday": "`everyday`"}
FEW_SPLITS = 3
"""Splits up to which an interval is at least as wide as the noise of the tasks in one."""


@cache
def _read(name: str) -> list[Row]:
    return list(json.loads((HERE / name).read_text(encoding="utf-8")))


def _shown(value: float) -> str:
    return f"{value:.3f}".removeprefix("0")


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def outside(book: str, split: str) -> Iterator[str]:
    """Yield the table of outside knowledge for a book and a split: means over splits."""
    rows: dict[str, list[Row]] = {}
    for row in _read("outside-knowledge.json"):
        if (row["book"], row["split"]) == (book, split):
            rows.setdefault(row["row"], []).append(row)
    columns = {"mrr": f"{split}, MRR", "8": "8 distractors", "1": "1", "few 8": "few"}
    if any("made 8" in row for of in rows.values() for row in of):
        columns |= BY_GOAL
    yield f"| | {' | '.join(columns.values())} |"
    yield f"|---|{'---|' * len(columns)}"
    for name, title in OUTSIDE.items():
        if name not in rows:
            continue
        cells = []
        for column in columns:
            values = [row[column] for row in rows[name] if column in row]
            is_whole = len(values) == len(rows[name])
            text = _shown(_mean(values)) if is_whole else ""
            if column == "8":
                text += _interval(values, [row.get("tasks", 0) for row in rows[name]])
            cells.append(text)
        yield f"| {title} | {' | '.join(cells)} |"


def _interval(rates: Sequence[float], tasks: Sequence[int]) -> str:
    if len(rates) > FEW_SPLITS:
        found = student_interval(rates)
        assert found is not None
        low, high = found
    else:
        errors = [math.sqrt(rate * (1 - rate) / n) for rate, n in zip(rates, tasks, strict=True)]
        low, high = split_interval(rates, errors)
    return f" [{_shown(low)}, {_shown(high)}]"


def depths(source: str, book: str, split: str, players: Sequence[str]) -> Iterator[str]:
    """Yield the table of planners by depth with 4 distractors; the planner has an interval."""
    rows: dict[tuple[str, int], list[Row]] = {}
    for row in _read(source):
        at = row["book"], row["split"], row["distractors"], row["policy"]
        if at == (book, split, 4, "any") and row["seed"] < FEW_SPLITS:
            rows.setdefault((row["player"], row["depth"]), []).append(row)
    yield f"| {split} | depth 1 | 2 | 3 | 4 |"
    yield "|---|---|---|---|---|"
    for player in players:
        cells = []
        for depth in (1, 2, 3, 4):
            rates = [row["success"] for row in rows[player, depth]]
            text = _shown(_mean(rates))
            if player == "planner":
                ends = student_interval(rates)
                assert ends is not None
                text += f" [{_shown(ends[0])}, {_shown(ends[1])}]"
            cells.append(text)
        yield f"| {PLAYERS[player]} | {' | '.join(cells)} |"


def agents_by_depth() -> Iterator[str]:
    """Yield the table of agents with and without plans, on split 0."""
    rates = {
        tuple(row[key] for key in ("book", "depth", "split", "distractors", "player")): row[
            "success"
        ]
        for row in _read("planning-agents.json")
        if row["seed"] == 0
    }
    yield f"| book, depth, split | distractors | {' | '.join(IN_AGENTS.values())} |"
    yield f"|---|---|{'---|' * len(IN_AGENTS)}"
    for book, name in BOOKS.items():
        for depth in (1, 2):
            for split in ("by-recipe", "by-goal"):
                for amount in (0, 4, 8):
                    cells = [
                        _shown(rates[book, depth, split, amount, player]) for player in IN_AGENTS
                    ]
                    where = f"{name}, {depth}, {split}"
                    yield f"| {where} | {amount} | {' | '.join(cells)} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    **{
        f"outside {book} {split}": partial(outside, book, split)
        for book, splits in {
            "little-alchemy-2": ("by-recipe", "by-goal", "by-slot"),
            "everyday": ("by-recipe", "by-goal"),
            "my-book": ("by-recipe",),
        }.items()
        for split in splits
    },
    **{
        f"planning {split}": partial(
            depths, "planning.json", "little-alchemy-2", split, tuple(PLAYERS)
        )
        for split in ("by-recipe", "by-goal")
    },
    **{
        f"planning everyday {split}": partial(
            depths, "planning-agents.json", "everyday", split, tuple(PLAYERS)[1:]
        )
        for split in ("by-recipe", "by-goal")
    },
    "planning agents": agents_by_depth,
}
"""The tables by name."""
