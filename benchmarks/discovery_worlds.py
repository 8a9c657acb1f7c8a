"""Open-ended play in many worlds of a book: curves, areas and passed bottlenecks, with intervals.

    wordcraft-kg train-recipes little-alchemy-2 --kg full --out models/la2
    python benchmarks/discovery_worlds.py everyday --scorer la2=models/la2 --book little-alchemy-2 \\
        --json worlds.json
    python benchmarks/discovery_worlds.py infinite-craft --secret secret.txt --scorer la2=models/la2

Plays the worlds 0 to 19 of a book, which ``cut_worlds.py`` cuts. Settings are chosen on the worlds of
``everyday``. The worlds of ``--secret`` are for measuring: their seeds follow from a secret that
is outside the repository, and whose hash is below, so that nobody can have chosen settings on them.
``--scorer NAME=FOLDER,FOLDER`` adds ``recipe-learner NAME`` with one or more fits of a knowledge;
repeat it for other knowledge. ``--worlds whole`` plays the book itself. ``--wrong 30`` plays worlds in which 30 % of the book's recipes make
something else: a player that knows the book, or another with the same recipes, is wrong there.
"""

import argparse
import time
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch
from cut_worlds import cut_world, with_wrong_recipes
from world_results import PlayedWorld, WorldsView, view_worlds

from wordcraft_kg.agents.discovery import Plays, make_discoverers, play_runs
from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.evaluation.discovery import ORACLES, open_guide
from wordcraft_kg.graphs.folder import open_graph
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import RecipeBook

SECRET_SHA256 = "41d8f1f427b75d39e4539abcb3101430ca07e85e8559f143f938f6e74071d546"
"""Of the secret, without blanks around it."""
SCRIPTED = ("random-no-repeat", "nearest-words", *ORACLES)
LEARNER = "recipe-learner"


def seeds(secret: Path | None, numbers: range) -> list[int]:
    """Return the seeds of worlds: the numbers themselves, or numbers that follow from a secret.

    Raises:
        ConfigError: if the secret is not the one of the committed hash.
    """
    if secret is None:
        return list(numbers)
    text = secret.read_text(encoding="utf-8").strip()
    if sha256(text.encode()).hexdigest() != SECRET_SHA256:
        raise ConfigError(f"`secret` {secret}: its SHA-256 is not the committed one.")
    # The number's remainder chooses the way, so that the ways take turns as in public worlds.
    drawn = [int(sha256(f"{text}/{number}".encode()).hexdigest()[:12], 16) for number in numbers]
    return [3 * seed + number % 3 for seed, number in zip(drawn, numbers, strict=True)]


def cut_worlds(options: argparse.Namespace, source: RecipeBook) -> Iterator[RecipeGraph]:
    """Yield the worlds to play: those of the numbers, or the whole book."""
    if options.worlds == "whole":
        yield RecipeGraph.from_book(source)
        return
    first, _, last = options.worlds.partition("-")
    numbers = range(int(first), int(last or first) + 1)
    for number, seed in zip(numbers, seeds(options.secret, numbers), strict=True):
        graph = RecipeGraph.from_book(cut_world(source, seed))
        if options.secret is not None:
            # The name would tell the seed.
            graph.name = f"secret-{number}-{source.name}"
        yield graph


def merged(plays: list[Plays]) -> Plays:
    """Return the plays of several players in one world."""
    return Plays(
        tuple(name for one in plays for name in one.players),
        np.concatenate([one.known for one in plays]),
        np.concatenate([one.repeated for one in plays]),
        np.concatenate([one.learnt for one in plays]),
    )


def played(
    graph: RecipeGraph, options: argparse.Namespace, book: RecipeGraph | None
) -> PlayedWorld:
    """Let all players play a world."""
    names = [*SCRIPTED, *(["book-votes"] if book is not None else [])]
    scripted = make_discoverers(names, graph, book=book)
    fits: list[list[Plays]] = [[play_runs(graph, scripted, options.attempts, options.runs)]]
    shared = {}
    for name, folders in options.scorers.items():
        for number, folder in enumerate(folders):
            guide = open_guide(folder, graph)
            shared[name] = guide.shared
            learner = RecipeDiscoverer(guide.recipes)
            learners = {name: learner}
            if options.ablate:
                learners[f"{name}, no doubt"] = learner.variant(0)
            if len(fits) <= number:
                fits.append([])
            fits[number].append(play_runs(graph, learners, options.attempts, options.runs))
    return PlayedWorld(graph, [merged(plays) for plays in fits], shared)


def text(view: WorldsView) -> None:
    """Print a row for each player and a row for each world."""
    for name, player in view.players.items():
        known = "  ".join(f"{mark}: {each.mean:.1f}" for mark, each in player.known.items())
        area = player.area
        bounds = "" if area.low is None else f" [{area.low:.3f}, {area.high:.3f}]"
        passed = "" if player.passed is None else f"  passed {player.passed.mean:.0%}"
        print(f"{name:24} {known}  area {area.mean:.3f}{bounds}{passed}")
    for name, each in view.differences.items():
        print(
            f"{view.best} - {name}: {each.mean:+.3f} [{each.low or 0:+.3f}, {each.high or 0:+.3f}]"
        )


def main() -> None:
    """Cut the worlds, play, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", help="the book to cut worlds out of")
    parser.add_argument("--worlds", default="0-19", help="numbers of worlds, first-last, or whole")
    parser.add_argument("--secret", type=Path, help="file with the secret")
    parser.add_argument("--wrong", type=int, help="per cent of the recipes with another result")
    parser.add_argument("--scorer", action="append", default=[], help="NAME=FOLDER[,FOLDER]")
    parser.add_argument("--ablate", action="store_true", help="each learner without doubt, too")
    parser.add_argument("--book", help="another book, for the player book-votes")
    parser.add_argument("--attempts", type=int, default=500)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.scorers = {}
    for given in options.scorer:
        name, _, folders = given.partition("=")
        options.scorers[f"{LEARNER} {name}"] = [Path(folder) for folder in folders.split(",")]
    source = open_book(options.source)
    if options.wrong:
        source = with_wrong_recipes(source, options.wrong)
    book = None if options.book is None else open_graph(options.book).graph
    worlds = []
    for graph in cut_worlds(options, source):
        began = time.process_time()
        worlds.append(played(graph, options, book))
        print(f"{graph.name}: {time.process_time() - began:.0f} s", flush=True)
    view = view_worlds(worlds)
    text(view)
    if options.json:
        write_atomically(options.json, dump_json(checked_values(view)))


if __name__ == "__main__":
    main()
