"""Measure how difficult the tasks of the book everyday are, and write ``difficulty.csv.gz``.

    python data/make_difficulty.py FOLDER

For each task the file has the number of tables, out of five with eight distractors, on which it is
solved by nearest words, by a learner (an agent without knowledge, after a short training) and by a
planner (of a recipe scorer, which on train tasks has not seen the task's recipes). FOLDER keeps the
trained models, so that the command can be repeated; they take about ten minutes of one core.
"""

import gzip
import sys
from pathlib import Path

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    RecipesConfig,
    SplitConfig,
    TaskConfig,
    WordCraftConfig,
    World,
    evaluate,
    load_policy,
    open_graph,
    train_agent,
    train_recipes,
)
from wordcraft_kg.agents.players import words_player
from wordcraft_kg.apps.text_agents.benchmark_players import best_player
from wordcraft_kg.apps.text_agents.plays import (
    DIFFICULTY_COLUMNS,
    DIFFICULTY_FILE,
    MEASURED_TABLES,
    task_keys,
)
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.models.model_folder import open_model

WORLDS = (("by-recipe", 1), ("by-recipe", 2), ("by-goal", 1))
"""Splits and depths of the benchmark's tracks."""
STEPS = 300_000
"""Environment steps of the learner: it is far from remembering all train tasks then."""


def prepare(folder: Path, split: str, depth: int) -> None:
    """Train the models of a split and a depth that are missing."""
    opened = open_graph("everyday", SplitConfig(split))
    model = folder / f"{split}-recipes"
    if not model.exists():
        train_recipes(RecipesConfig(opened), model)
    run = folder / f"{split}-{depth}"
    if not run.exists():
        trainer = ImpalaConfig(steps=STEPS, eval_every=0)
        train_agent(AgentConfig(opened, tasks=TaskConfig(depth=depth), trainer=trainer), run)


def lines_of(folder: Path, split: str, depth: int, part: str) -> list[str]:
    """Play all tasks of a part; return the lines of the file."""
    world = World(open_graph("everyday", SplitConfig(split)), WordCraftConfig(part, depth))
    ((_, words),) = words_player(world.graph).items()
    model = open_model(folder / f"{split}-recipes", world.opened)
    seen = world.tasks if part == "train" else None
    _, planner = best_player(model, world.graph, ["planner"], seen)
    learner = load_policy(folder / f"{split}-{depth}")
    counts = [
        evaluate(player, world, distractor_seeds=MEASURED_TABLES).success.sum(1)
        for player in (words, learner, planner)
    ]
    print(
        split,
        depth,
        part,
        len(world.tasks),
        *(f"{each.mean() / MEASURED_TABLES:.3f}" for each in counts),
    )
    rows = zip(task_keys(world), *counts, strict=True)
    return [",".join(map(str, (*key, *solved))) for key, *solved in rows]


def main(folder: Path) -> None:
    """Train what is missing, play all tasks and write the file."""
    lines = [",".join(DIFFICULTY_COLUMNS)]
    for split, depth in WORLDS:
        prepare(folder, split, depth)
        for part in ("train", "test"):
            lines += lines_of(folder, split, depth, part)
    # Without a time, so that equal measurements are equal bytes.
    text = "\n".join(lines) + "\n"
    write_atomically(DIFFICULTY_FILE, gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
