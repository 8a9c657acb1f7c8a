"""What learning adds: the success of trained agents minus the success of their scorers alone, on
the same tables.

    wordcraft-kg reproduce benchmarks/agent_against_scorer.toml --out results
    python benchmarks/agent_against_scorer.py results --json figures.json

The agent of each run in the results folder plays all test tasks on 5 tables each, and so does w
alone, the pair with the highest recipe score. Prints a row for each book, split kind and number of
distractors: means over runs, then over splits, with an interval over splits that is never narrower
than that of the tasks in one. For other books change ``book`` in the study, and ``scorer_cost`` for
small ones; ``reached_first`` in small_books.py shows how a large book is cut.
"""

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.evaluation.players import view_evaluation


def measured(run: Path) -> dict[str, Any]:
    """Return the setting of a run, and how its agent compares with w alone."""
    agent = open_agent(run)
    tasks, split = agent.config.tasks, agent.opened.split.config
    view = view_evaluation(run, agent, "trained", "test", [tasks.distractors], 5)
    (success,), (compared,) = view.success.values(), (view.against_scorer or {}).values()
    return {
        "book": agent.opened.graph.name,
        "split": split.kind,
        "distractors": tasks.distractors,
        "split_seed": split.seed,
        "scorer_cost": agent.config.trainer.scorer_cost,
        "seed": agent.config.trainer.seed,
        "agent": success.mean,
        "gain": compared.gain,
        "interval": list(compared.gain_ci),
        "differs": compared.differs,
    }


def main() -> None:
    """Measure the runs of a results folder, print a table, and write all figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, help="results folder of `wordcraft-kg reproduce`")
    parser.add_argument("--json", type=Path, help="file for the figures of each run")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = [
        measured(path.parent) for path in sorted(options.results.glob("runs/*/evaluation.json"))
    ]
    setting = ("book", "split", "distractors", "scorer_cost")
    rows.sort(key=lambda row: [row[name] for name in (*setting, "split_seed", "seed")])
    for values, cell in itertools.groupby(rows, key=lambda row: [row[name] for name in setting]):
        runs = list(cell)
        splits = sorted({row["split_seed"] for row in runs})
        gains = [
            np.mean([row["gain"] for row in runs if row["split_seed"] == split]) for split in splits
        ]
        # One split says nothing of others.
        low, high = student_interval(gains, within=(-1, 1)) or (-1.0, 1.0)
        agent, differs = (np.mean([row[name] for row in runs]) for name in ("agent", "differs"))
        worst, above, below = (
            min(row["interval"][0] for row in runs),
            sum(row["interval"][0] > 0 for row in runs),
            sum(row["interval"][1] < 0 for row in runs),
        )
        print(
            f"{values[0]:18} {values[1]:10} {values[2]} distractors, penalty {values[3]}: agent "
            f"{agent:.3f}, gain {np.mean(gains):+.4f} [{low:+.4f}, {high:+.4f}], splits "
            f"{' '.join(f'{gain:+.3f}' for gain in gains)}; differs {differs:.2f}; lowest end "
            f"{worst:+.3f}, {above} runs above 0, {below} below"
        )
    if options.json:
        write_atomically(options.json, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
