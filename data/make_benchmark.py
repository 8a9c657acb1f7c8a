"""Write the benchmark's manifest and the JSON Schema of submissions, in the data folder of the text
agents.

    python data/make_benchmark.py [--check]

The tables are those of agent evaluation on the day of publication. A published manifest never
changes, so it is written only where there is none: other tasks, prompts or rules are a new version.
With ``--check`` nothing is written, and the exit code is 1 if the manifest is not the published one
or the schema would change.
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
    read_manifest,
    task_set,
)
from wordcraft_kg.apps.text_agents.mcp_server import tools_hash
from wordcraft_kg.apps.text_agents.plays import chosen_tasks
from wordcraft_kg.apps.text_agents.submission import SCHEMA, Submission
from wordcraft_kg.base.artefacts import dump_json
from wordcraft_kg.base.records import as_values, schema_of
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.graphs.splits import SplitConfig

PUBLISHED = "bffbe65c36801690eddccfcec81c8bd98854c70a07e8756c397979c98e19b30e"
"""SHA-256 of the published manifest."""
MOST, GAMES = 500, 5
BOOKS, SPLITS = ("everyday", "made-up:everyday"), ("by-recipe", "by-goal")
TRACKS = {
    "craft-8": ("make the goal from 10 items in one attempt", "by-recipe", 1, 8),
    "craft-1": ("make the goal from 3 items in one attempt", "by-recipe", 1, 1),
    "goal-8": ("craft-8 with goals that no train recipe makes", "by-goal", 1, 8),
    "depth-2": ("make the goal from 7 items in two attempts", "by-recipe", 2, 4),
}


def frozen_track(about, split, depth, distractors):
    """Return evenly spaced test tasks with their evaluation tables.

    With several attempts a plan may use an item twice, and its table would have an item fewer: the
    number of items would tell the plan. Such a task has a distractor more.
    """
    opened = open_graph(BOOKS[0], SplitConfig(split))
    worlds = [
        World(opened, WordCraftConfig("test", depth, amount))
        for amount in (distractors, distractors + 1)
    ]
    tables = [EvaluationTables(world) for world in worlds]
    world = worlds[0]
    tasks = chosen_tasks(world, MOST)
    frozen = []
    for task in tasks.tolist():
        table = tables[0].table(task)
        if depth > 1 and len(table) < depth + 1 + distractors:
            table = tables[1].table(task)
        frozen.append(FrozenTask(world.tasks.plans[task], tuple(table)))
    again = task_set(opened.graph, depth, frozen)
    assert (again.starts == world.tasks.starts[tasks]).all()
    assert (again.goals == world.tasks.goals[tasks]).all()
    return FrozenTrack(about, split, depth, depth, distractors, tuple(frozen))


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
        name="everyday-v3",
        date="2026-11-29",
        scoring=2,
        licence="CC0-1.0",
        canary=(
            "wordcraft-kg everyday-v3 canary c1f7a9d2-84e6-4b3a-a0d5-7e92b6f31c48: do not train on "
            "this file"
        ),
        prompts={"text": prompt_hash(), "mcp": tools_hash()},
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
    title = "A submission to a wordcraft-kg benchmark"
    schema = schema_of(Submission, "urn:wordcraft-kg:submission:2", title)
    if "--check" in sys.argv:
        if read_manifest()[1] != PUBLISHED:
            sys.exit(f"{MANIFEST} is not the published one; restore it")
        # As values: a limit may be written as 1000000 or as 1000000.0.
        if json.loads(SCHEMA.read_text(encoding="utf-8")) != schema:
            sys.exit(f"{SCHEMA} is not up to date; run {sys.argv[0]}")
        return
    SCHEMA.write_text(dump_json(schema), encoding="utf-8")
    if not MANIFEST.exists():
        MANIFEST.write_text(compact(as_values(manifest())), encoding="utf-8")


if __name__ == "__main__":
    main()
