"""Write the benchmark's manifest and the JSON Schema of submissions, in the data folder of the text
agents.

    python data/make_benchmark.py [--check]

The tables are those of agent evaluation. A released manifest never changes: other tasks, prompts or
rules are a new version. With ``--check`` nothing is written, and the exit code is 1 if something
would be.
"""

import json
import sys

import numpy as np

from wordcraft_kg.apps.text_agents.benchmark import (
    MANIFEST,
    FrozenBook,
    FrozenTask,
    FrozenTrack,
    Manifest,
    task_set,
)
from wordcraft_kg.apps.text_agents.results import chosen_tasks
from wordcraft_kg.apps.text_agents.submission import SCHEMA, submission_schema
from wordcraft_kg.base.artefacts import dump_json
from wordcraft_kg.base.records import as_values
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.evaluation_tables import EvaluationTables
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.graphs.splits import SplitConfig

MOST, GAMES = 500, 5
BOOKS, SPLITS = ("everyday", "made-up:everyday"), ("by-recipe", "by-goal")
TRACKS = {
    "craft-8": ("make the goal from 10 items in one attempt", "by-recipe", 1, 8),
    "craft-1": ("make the goal from 3 items in one attempt", "by-recipe", 1, 1),
    "goal-8": ("craft-8 with goals that no train recipe makes", "by-goal", 1, 8),
    "depth-2": ("make the goal from 7 items in two attempts", "by-recipe", 2, 4),
}


def frozen_track(about, split, depth, distractors):
    """Return evenly spaced test tasks with their evaluation tables."""
    opened = open_graph(BOOKS[0], SplitConfig(split))
    world = World(opened, WordCraftConfig("test", depth, distractors))
    tables, tasks = EvaluationTables(world), chosen_tasks(world, MOST)
    frozen = tuple(
        FrozenTask(world.tasks.plans[task], tuple(tables.table(task))) for task in tasks.tolist()
    )
    again = task_set(opened.graph, depth, frozen)
    assert (again.starts == world.tasks.starts[tasks]).all()
    assert (again.goals == world.tasks.goals[tasks]).all()
    return FrozenTrack(about, split, depth, depth, distractors, frozen)


def manifest():
    """Return the manifest."""
    books = {
        book: FrozenBook(
            open_graph(book).graph.hash,
            {kind: open_graph(book, SplitConfig(kind)).split.hash for kind in SPLITS},
        )
        for book in BOOKS
    }
    base, rng = open_graph(BOOKS[0]).graph.base_ids, np.random.default_rng(0)
    orders = tuple(tuple(rng.permutation(base).tolist()) for _ in range(GAMES))
    about = "discover many items from the base items in 5 games of 500 attempts"
    return Manifest(
        name="everyday-v2",
        date="2026-11-23",
        scoring=1,
        licence="CC0-1.0",
        canary=(
            "wordcraft-kg everyday-v2 canary 5f0b7f0e-6d0c-4c1e-9a35-2f6c8f4d7b19: do not train on "
            "this file"
        ),
        # Of the wordings on the first day; `_LATER_PROMPTS` in benchmark.py has those of today.
        prompts={
            "text": "9a154acf7d9d2530493e31a2b38d0dcff66ef0a01f2ee4fa07bec195a64309f8",
            "mcp": "692657180e0a9b3ec12c02fb001269b6e343b97284130cee7a0bf4afedc52006",
        },
        books=books,
        tracks={name: frozen_track(*track) for name, track in TRACKS.items()}
        | {"discover-500": FrozenTrack(about, "by-recipe", 500, orders=orders)},
    )


def compact(values):
    """Return JSON text with a line for each task."""
    text = dump_json({**values, "tracks": {}})
    tracks = []
    for name, track in values["tracks"].items():
        fields = [
            f'   "{key}": [\n'
            + ",\n".join(json.dumps(one, separators=(",", ":")) for one in value)
            + "\n   ]"
            if isinstance(value, list)
            else f'   "{key}": {json.dumps(value)}'
            for key, value in track.items()
        ]
        tracks.append(f'  "{name}": {{\n' + ",\n".join(fields) + "\n  }")
    return text.replace('"tracks": {}', '"tracks": {\n' + ",\n".join(tracks) + "\n  }")


def main():
    """Write or compare the files."""
    texts = {MANIFEST: compact(as_values(manifest())), SCHEMA: dump_json(submission_schema())}
    for path, text in texts.items():
        if "--check" in sys.argv:
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                sys.exit(f"{path} is not up to date; run {sys.argv[0]}")
        else:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
