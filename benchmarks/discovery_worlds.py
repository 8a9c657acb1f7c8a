"""Open-ended play in separate worlds of a book: areas and known entities, with intervals.

    wordcraft-kg train-recipes everyday --kg full --without infinite-craft --out models/everyday
    python benchmarks/discovery_worlds.py infinite-craft --scorer models/everyday --book everyday \\
        --candidates 40 --json worlds.json

Cuts worlds out of a book (``cut_worlds.py``), chooses those of which no two share more than a fifth
of the recipes, prints what each pair shares, and lets all players play them. Settings of the
players were chosen on ``everyday`` (SETTINGS), so that its worlds are no measurement; of other
books, the script prints the share of each world's recipes that ``everyday`` has, too.

The player ``book-votes`` knows the ``--book`` without the recipes that the worlds' book has, as
``--without`` leaves them out of the scorer's training.

Each world is a cluster of its own: intervals are for other worlds and fits like these. ``--scorer
FOLDER,FOLDER`` are fits of one knowledge.
"""

import argparse
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cut_worlds import CANDIDATES, separate_worlds, shared_part
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import make_discoverers, play_runs
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.statistics import crossed_difference
from wordcraft_kg.evaluation.discovery import open_guide
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook

SETTINGS = "everyday"
"""The book on whose worlds the settings of the players were chosen."""
LEARNER = "recipe-learner"
ORACLE = "greedy"
"""The player that knows the world, and is the measure of all others."""
ATTEMPTS = 150
"""Attempts of a run: at the end, a player that knows the world has made nearly all of it."""
MARKS = (50, 100, 150)
Table = NDArray[np.float64]
Curves = dict[str, NDArray[np.int64]]
"""Known entities by player: number after each attempt, 0 first, shape (runs, attempts + 1)."""


def curve_area(known: NDArray[np.integer]) -> Table:
    """Return the mean number of discovered entities over all attempts: the area under a curve.

    ``area = mean_{t = 1..n} (known_t - known_0)``. Unlike the number at the end, it counts early
    discoveries more, and does not depend on the size of the base.

    Args:
        known: number of known entities after each attempt, 0 first, shape (..., n + 1).
    """
    gained = known[..., 1:] - known[..., :1]
    return np.asarray(gained.mean(axis=-1), dtype=np.float64)


def estimate(values: Table) -> dict[str, float | None]:
    """Return the mean over fits and worlds with its interval, None where nothing varies.

    Args:
        values: shape (fits, worlds).
    """
    # The interval is made for differences, and cut at -1 and 1: far from there, nothing is cut.
    scale = 100 * float(np.abs(values).max()) or 1.0
    mean = float(values.mean())
    if np.ptp(values) == 0:
        return {"mean": mean, "low": None, "high": None}
    (_, low, high), _ = crossed_difference(values / scale, None)
    return {"mean": mean, "low": low * scale, "high": high * scale}


def played(
    graph: RecipeGraph, options: argparse.Namespace, book: RecipeGraph | None
) -> list[Curves]:
    """Let all players play a world: each fit of the scorer once, with all others beside it."""
    names = ["random-no-repeat", "nearest-words", *(["book-votes"] if book else []), ORACLE]
    if not options.scorers:
        players = make_discoverers(names, graph, book=book)
        return [play_runs(graph, players, options.attempts, options.runs)]
    fits = []
    for folder in options.scorers:
        guide = open_guide(folder, graph)
        guided = (guide.learner(), book, guide.unit_vectors())
        players = make_discoverers([*names, LEARNER], graph, *guided)
        fits.append(play_runs(graph, players, options.attempts, options.runs))
    return fits


def across(recipe: Recipe) -> tuple[tuple[str, ...], str]:
    """Return a recipe as books share it: Infinite Craft writes Earth, others earth."""
    return tuple(sorted(label.casefold() for label in recipe.ingredients)), recipe.result.casefold()


def without(book: RecipeBook, source: RecipeBook) -> RecipeGraph:
    """Return a book without the recipes that the worlds' book has, too: the scorer lacks them."""
    shared = set(map(across, source.recipes))
    recipes = [recipe for recipe in book.recipes if across(recipe) not in shared]
    return RecipeGraph.from_recipes(recipes, book.base)


def overlaps(worlds: list[RecipeBook]) -> list[dict[str, Any]]:
    """Return which part of the entities and recipes each pair of worlds shares."""
    return [
        {
            "worlds": (left.name, right.name),
            "entities": round(shared_part(set(left.entities), set(right.entities)), 3),
            "recipes": round(shared_part(set(left.recipes), set(right.recipes)), 3),
        }
        for left, right in combinations(worlds, 2)
    ]


def summary(plays: list[list[Curves]]) -> dict[str, Any]:
    """Return the figures of each player, and the gain of the learner over each of them."""
    # Shape (fits, worlds, runs, attempts + 1), by player.
    known = {
        name: np.array([[fit[name] for fit in fits] for fits in plays]).swapaxes(0, 1)
        for name in plays[0][0]
    }
    oracle = curve_area(known[ORACLE]).mean(axis=2)
    areas = {name: curve_area(curves).mean(axis=2) / oracle for name, curves in known.items()}
    figures = {
        name: {
            "area": estimate(areas[name]),
            "known": {
                str(n): estimate(curves[..., n].mean(axis=2)) for n in MARKS if n < curves.shape[-1]
            },
            "areas": [round(float(area), 4) for area in areas[name].mean(axis=0)],
        }
        for name, curves in known.items()
    }
    gains = {}
    if LEARNER in areas:
        others = [name for name in areas if name not in (LEARNER, ORACLE)]
        gains = {name: estimate(areas[LEARNER] - areas[name]) for name in others}
    return {"players": figures, f"{LEARNER} minus": gains}


def shown(figures: dict[str, float | None]) -> str:
    """Return an estimate as text."""
    if figures["low"] is None:
        return f"{figures['mean']:.3f}"
    return "{mean:.3f} [{low:.3f}, {high:.3f}]".format(**figures)


def main() -> None:
    """Cut the worlds, play, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", help="the book to cut worlds out of")
    parser.add_argument("--candidates", type=int, default=CANDIDATES)
    parser.add_argument("--most", type=int, help="largest number of worlds")
    parser.add_argument("--scorer", default="", help="FOLDER[,FOLDER]: fits that guide the learner")
    parser.add_argument("--book", help="another book, for the player book-votes")
    parser.add_argument("--attempts", type=int, default=ATTEMPTS)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.scorers = [Path(folder) for folder in options.scorer.split(",") if folder]
    source = open_book(options.source)
    book = None if options.book is None else without(open_book(options.book), source)
    worlds = separate_worlds(source, candidates=options.candidates, most=options.most)
    pairs = overlaps(worlds)
    for pair in pairs:
        print("{worlds[0]}, {worlds[1]}: entities {entities}, recipes {recipes}".format(**pair))
    settings = set(map(across, open_book(SETTINGS).recipes))
    results = []
    plays = []
    for world in worlds:
        began = time.process_time()
        graph = RecipeGraph.from_book(world)
        plays.append(played(graph, options, book))
        seen = len(settings & set(map(across, world.recipes))) / len(world.recipes)
        sizes = {"entities": len(world.entities), "recipes": len(world.recipes)}
        about = {"base": world.base, **sizes, f"recipes in {SETTINGS}": round(seen, 3)}
        results.append({"name": world.name, "hash": graph.hash, **about})
        print(results[-1], f"{time.process_time() - began:.0f} s", flush=True)
    for part in ("entities", "recipes"):
        shares = [pair[part] for pair in pairs] or [0.0]
        print(f"pairs of worlds share {np.mean(shares):.3f} of the {part}, at most {max(shares)}")
    view = summary(plays)
    for name, figures in view["players"].items():
        known = "  ".join(f"{mark}: {each['mean']:.1f}" for mark, each in figures["known"].items())
        print(f"{name:20} {known}  area {shown(figures['area'])}")
    for name, gain in view[f"{LEARNER} minus"].items():
        print(f"{LEARNER} - {name}: {shown(gain)}")
    if options.json:
        setting = {"book": options.source, "candidates": options.candidates, "runs": options.runs}
        setting |= {"attempts": options.attempts, "fits": len(options.scorers)}
        written = {**setting, "worlds": results, "overlaps": pairs, **view}
        write_atomically(options.json, dump_json(written))


if __name__ == "__main__":
    main()
