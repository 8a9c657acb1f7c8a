"""Measure agent success, and the evidence for the default settings.

    python benchmarks/agent_quality.py choices BOOK    vary a single setting, evaluate on validation tasks
    python benchmarks/agent_quality.py test BOOK       evaluate the documented agents on test tasks

The script prints each run's command and keeps runs in --out; existing runs are not repeated. Two runs share the
machine, so speeds are not comparable: see train_speed.py.
"""

import argparse
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.envs.world import World

MARKS = (100_000, 300_000, 1_000_000)
"""Environment steps at which the learning curves are read."""
PLAIN = {"scale": "standardise", "self-edges": "keep"}
PARTIAL = {"scorer": "partial", **PLAIN}
FULL = {"scorer": "full", **PLAIN}
RELEASED = {
    "mixing": "softmax",
    "scale": "none",
    "self-edges": "keep",
    "value-readout": "logits",
    "pooling": "max",
}
CHOSEN = {"mixing": "free", "scale": "ranks", "self-edges": "observed", "value-readout": "softmax"}
CHOICES: dict[str, dict[str, object]] = {
    "no KG": {},
    "no KG, value from raw logits": {"value-readout": "logits"},
    "partial KG": PARTIAL,
    "partial KG, λ by softmax": {**PARTIAL, "mixing": "softmax"},
    "partial KG, scale by ranks": {**PARTIAL, "scale": "ranks"},
    "partial KG, scale by log-softmax": {**PARTIAL, "scale": "log-softmax"},
    "partial KG, no scale": {**PARTIAL, "scale": "none"},
    "partial KG, self edges observed": {**PARTIAL, "self-edges": "observed"},
    "partial KG, self edges dropped": {**PARTIAL, "self-edges": "drop"},
    "partial KG, self edges observed, ranks": {
        **PARTIAL,
        "self-edges": "observed",
        "scale": "ranks",
    },
    "partial KG, self edges dropped, ranks": {**PARTIAL, "self-edges": "drop", "scale": "ranks"},
    "partial KG, λ by softmax, observed, ranks": {
        **PARTIAL,
        "mixing": "softmax",
        "self-edges": "observed",
        "scale": "ranks",
    },
    "partial KG, value from raw logits": {**PARTIAL, "value-readout": "logits"},
    "full KG": FULL,
    "full KG, λ by softmax": {**FULL, "mixing": "softmax"},
    "full KG, self edges observed": {**FULL, "self-edges": "observed"},
    "full KG, self edges dropped": {**FULL, "self-edges": "drop"},
    "full KG, self edges observed, ranks": {**FULL, "self-edges": "observed", "scale": "ranks"},
    "full KG, self edges dropped, ranks": {**FULL, "self-edges": "drop", "scale": "ranks"},
    "full KG, λ by softmax, self edges dropped": {
        **FULL,
        "mixing": "softmax",
        "self-edges": "drop",
    },
}
AGENTS: dict[str, dict[str, object]] = {
    "no KG": {},
    "partial KG": {"scorer": "partial", **CHOSEN},
    "partial KG, standardised, self edges kept": PARTIAL,
    "partial KG, as released": {"scorer": "partial", **RELEASED},
    "full KG": {"scorer": "full", **CHOSEN},
    "full KG, standardised, self edges kept": FULL,
    "full KG, standardised, self edges dropped": {**FULL, "self-edges": "drop"},
    "full KG, as released": {"scorer": "full", **RELEASED},
    "simple MLP": {"policy": "mlp"},
    "no KG, shuffled GloVe": {"features": "shuffled:glove"},
    "no KG, random features": {"features": "random"},
}


def command(*arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "wordcraft_kg", *arguments, "--quiet", "--json"],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        sys.exit(f"{' '.join(arguments)}\n{done.stderr}")


def check(run: Path, given: dict[str, object]) -> None:
    """Make sure that a run that is there is the one that is wanted, and whole."""
    agent = open_agent(run)
    found = agent.config.values()
    wrong = [
        name
        for name, value in given.items()
        if name != "scorer" and str(found[name.replace("-", "_")]) != str(value)
    ]
    if agent.run.status != "done" or wrong:
        sys.exit(
            f"{run} is {agent.run.status} and differs in {wrong}: remove it, or take another --out"
        )


def make_inputs(book: str, home: Path, *, is_choice: bool) -> Path:
    """Build the graph and train both scorers, unless they are there; return the graph's folder."""
    graph = home / "graph"
    if not graph.exists():
        split = ["--train-ratio", "0.8", "--seed", "0"]
        # Choices are made on validation tasks.
        if is_choice:
            split += ["--valid-ratio", "0.1"]
        command("build-graph", book, "--split", "by-recipe", *split, "--out", str(graph))
    for kg in ("partial", "full"):
        if not (home / kg).exists():
            command("train-complex", str(graph), "--kg", kg, "--out", str(home / kg))
    return graph


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("choices", "test"))
    parser.add_argument("book")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/runs"))
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--distractors", default="8")
    parser.add_argument("--only", help="names, semicolons separate")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    is_choice = options.what == "choices"
    seeds = options.seeds or (2 if is_choice else 5)
    home = options.out / options.what
    graph = make_inputs(options.book, home, is_choice=is_choice)
    variants = CHOICES if is_choice else AGENTS
    if options.only:
        variants = {name: variants[name] for name in options.only.split(";")}
    part = "valid" if is_choice else "test"
    print(
        f"success on {part} tasks after {options.steps:,} steps, {seeds} seeds: mean [range] [95 % "
        "interval over seeds]"
    )
    for distractors in map(int, options.distractors.split(",")):
        evaluators = {}
        jobs = {
            (name, seed): home / f"{distractors}-{name}-{seed}".replace(" ", "-")
            for name in variants
            for seed in range(seeds)
        }

        def train(key: tuple[str, int], distractors: int = distractors, jobs: dict = jobs) -> None:
            name, seed = key
            given = {
                **variants[name],
                "seed": seed,
                "distractors": distractors,
                "steps": options.steps,
            }
            if "scorer" in given:
                given["scorer"] = home / given["scorer"]
            if jobs[key].exists():
                check(jobs[key], given)
                return
            arguments = [
                text for option, value in given.items() for text in (f"--{option}", str(value))
            ]
            command("train-agent", str(graph), *arguments, "--out", str(jobs[key]))

        with ThreadPoolExecutor(options.jobs) as pool:
            list(pool.map(train, jobs))
        for name in variants:
            means, early = [], []
            for seed in range(seeds):
                agent = open_agent(jobs[name, seed])
                key = agent.config.tasks
                if key not in evaluators:
                    evaluators[key] = Evaluator(World(agent.opened, key.environment(part)))
                means.append(evaluators[key](PolicyPlayer(agent.policy)).success.mean())
                curve = [
                    (row.step, row.figures["test_success"])
                    for row in agent.metrics
                    if "test_success" in row.figures
                ]
                early.append(
                    [min(curve, key=lambda point: abs(point[0] - mark))[1] for mark in MARKS]
                )
            interval = student_interval(means)
            shown = f"[{interval[0]:.3f}, {interval[1]:.3f}]" if interval else ""
            if not is_choice:  # the curve's points are test tasks too
                shown += "   at " + ", ".join(
                    f"{mark / 1e6:g}M {value:.3f}"
                    for mark, value in zip(MARKS, np.mean(early, axis=0), strict=True)
                )
            figures = f"{np.mean(means):.3f} [{min(means):.3f}, {max(means):.3f}] {shown}"
            print(f"{distractors} distractors  {name:41s} {figures}", flush=True)


if __name__ == "__main__":
    main()
