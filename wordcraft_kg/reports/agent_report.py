"""The agent report: one run, several seeds of it, or several agents side by side; its numbers, pictures and page."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import ENDINGS, Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import explain_episodes
from wordcraft_kg.agents.players import random_entity, recipe_oracle
from wordcraft_kg.artefacts import dump_json, staged_folder, write_atomically
from wordcraft_kg.errors import ConfigError, GraphMismatchError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.actor_critic import AttentionPolicy
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page
from wordcraft_kg.statistics import (
    interquartile_mean,
    paired_difference,
    probability_of_improvement,
    probability_of_improvement_interval,
    stratified_bootstrap,
    task_bootstrap,
)

REPORT_FORMAT = "wordcraft-kg agent report 1"
RULES = ("depth", "max_attempts", "distractor_weighting", "distractor_policy", "ambiguity")
"""Settings of the tasks in which agents that are compared must agree."""
DISTRACTORS = (1, 8)
"""Numbers of distractors that every report has, besides those trained with."""
MIN_SEEDS = 5
SYMBOLS = {"alpha": "λα", "u": "λu", "v": "λv"}
_TOP = 10**6


@dataclass(frozen=True)
class AgentReport:
    """A report's numbers (``report.json``) and its pictures by name."""

    values: dict[str, Any]
    pictures: dict[str, Any]


def group_agents(agents: Sequence[OpenedAgent]) -> dict[str, list[OpenedAgent]]:
    """Return runs by agent: those that differ in nothing but the seed belong together.

    A group is called as its runs are, without the seed at their end.

    Raises:
        ConfigError: if a run is given twice, that is, two of a group have the same seed.
    """
    by_settings: dict[Any, list[OpenedAgent]] = {}
    for agent in agents:
        inputs = tuple(agent.run.inputs.get(name) for name in ("graph", "split", "scorer"))
        config = agent.config
        key = (inputs, config.tasks, config.policy, replace(config.trainer, seed=0, device="cpu", threads=1))
        by_settings.setdefault(key, []).append(agent)
    groups: dict[str, list[OpenedAgent]] = {}
    for members in by_settings.values():
        seeds = [agent.config.trainer.seed for agent in members]
        if len(set(seeds)) < len(seeds):
            names = ", ".join(agent.name for agent in members)
            raise ConfigError(f"{names}: two of these runs are the same agent with the same seed; give each once.")
        stems = {re.sub(r"[-_.]?(seed|s)?[-_]?\d+$", "", agent.name) or agent.name for agent in members}
        name = stems.pop() if len(members) > 1 and len(stems) == 1 else members[0].name
        while name in groups:
            name += "′"
        groups[name] = members
    return groups


def make_agent_report(
    groups: dict[str, list[OpenedAgent]],
    *,
    part: TaskPart = "test",
    distractors: Sequence[int] | None = None,
    draws: int = 5,
    episodes: int = 2,
) -> AgentReport:
    """Judge agents on all tasks of a part, greedily, with the same tables for all.

    Args:
        groups: runs by agent, see :func:`group_agents`; the first is the reference of comparisons.
        part: tasks to play.
        distractors: numbers of distractors. Default: 1, 8 and those trained with.
        draws: of distractors for each task.
        episodes: to explain for each agent.

    Raises:
        GraphMismatchError: if the runs are not all on one graph and split.
        ConfigError: if they play by different rules, see :data:`RULES`, or none can play with such distractors.
    """
    everyone = [agent for members in groups.values() for agent in members]
    first = everyone[0]
    for agent in everyone[1:]:
        if agent.opened.split.hash != first.opened.split.hash:
            raise GraphMismatchError(
                f"'{agent.name}' and '{first.name}' were trained on different graphs or splits: their tasks are not "
                "the same, and their figures cannot be compared. Train them on one graph folder."
            )
        for rule in RULES:
            found, expected = getattr(agent.config.tasks, rule), getattr(first.config.tasks, rule)
            if found != expected:
                raise ConfigError(
                    f"'{agent.name}' plays with {rule} {found} and '{first.name}' with {expected}: their figures "
                    "cannot be compared."
                )
    if distractors is None:
        distractors = sorted({*DISTRACTORS, *(agent.config.tasks.distractors for agent in everyone)})
    played = [amount for amount in distractors if any(_can_play(agent, amount) for agent in everyone)]
    if not played:
        raise ConfigError(
            f"an mlp plays with {first.config.tasks.distractors} distractors only, which it was made for."
        )
    headline = first.config.tasks.distractors
    if headline not in played:
        headline = played[-1]
    judge = _Judge(part, draws)
    entries = [_entry(name, members, judge, played, headline) for name, members in groups.items()]
    _compare(entries, judge)
    graph, split, tasks = first.opened.graph, first.opened.split, first.config.tasks
    values: dict[str, Any] = {
        "format": REPORT_FORMAT,
        "graph": {"name": graph.name, "hash": graph.hash, "entities": graph.num_entities, "recipes": graph.num_recipes},
        "split": {"kind": split.config.kind, "seed": split.config.seed, "hash": split.hash},
        "part": part,
        "depth": tasks.depth,
        "distractors": played,
        "headline": headline,
        "draws": draws,
        "tasks": len(judge.evaluators[headline].tasks),
        "agents": entries,
        "baselines": _baselines(first, judge, played),
        "episodes": [
            {"agent": name, "run": members[0].name, "episodes": _episodes(members[0], part, headline, episodes)}
            for name, members in groups.items()
        ],
    }
    return AgentReport(values, _pictures(values))


def write_agent_report(report: AgentReport, out: Path, *, force: bool = False) -> None:
    """Write ``index.html`` and ``report.json`` (checked against its schema) into a folder."""
    jsonschema.validate(report.values, report_schema())
    with staged_folder(out, force=force) as folder:
        write_atomically(folder / "report.json", dump_json(report.values))
        write_atomically(folder / "index.html", render(report))


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``report.json``."""
    text = resources.files("wordcraft_kg.reports").joinpath("schemas/agent_report.schema.json").read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def render(report: AgentReport) -> str:
    """Return the report as one self-contained HTML page."""
    return render_page(
        "agent_report.html.j2",
        report=report.values,
        pictures=report.pictures,
        min_seeds=MIN_SEEDS,
        symbols=SYMBOLS,
        bar=charts.contribution_bar,
    )


class _Judge:
    """Plays policies, with one set of environments for each number of distractors."""

    def __init__(self, part: TaskPart, draws: int):
        self.part, self.draws = part, draws
        self.evaluators: dict[int, Evaluator] = {}
        self.success: dict[tuple[str, int], NDArray[np.bool_]] = {}

    def __call__(self, agent: OpenedAgent, distractors: int, player: Any) -> Evaluation:
        if distractors not in self.evaluators:
            config = agent.config.tasks.environment(self.part, distractors)
            self.evaluators[distractors] = Evaluator(agent.opened, config, draws=self.draws)
        return self.evaluators[distractors](player)


def _can_play(agent: OpenedAgent, distractors: int) -> bool:
    """Whether a policy takes tables of this size; an mlp is made for one."""
    return agent.config.policy.policy != "mlp" or distractors == agent.config.tasks.distractors


def _entry(
    name: str, members: list[OpenedAgent], judge: _Judge, distractors: Sequence[int], headline: int
) -> dict[str, Any]:
    """All figures of one agent."""
    config, run = members[0].config, members[0].run
    settings = {key: value for key, value in config.differing().items() if key not in ("seed", "graph")}
    entry: dict[str, Any] = {
        "name": name,
        "runs": [agent.name for agent in members],
        "seeds": [agent.config.trainer.seed for agent in members],
        "checkpoints": [agent.checkpoint for agent in members],
        "settings": {key: str(value) for key, value in settings.items()},
        "kg": run.kg,
        "trained_with": config.tasks.distractors,
        "steps": [agent.metrics[-1].step if agent.metrics else 0 for agent in members],
        "seconds": [agent.metrics[-1].seconds if agent.metrics else None for agent in members],
        "steps_per_second": [agent.evaluation and agent.evaluation.steps_per_second for agent in members],
        "success": {},
        "outcomes": {},
        "slices": {},
        "curves": _curves(members),
        "lambdas": _lambda_curves(members),
    }
    for amount in distractors:
        if not _can_play(members[0], amount):
            continue
        found = [judge(agent, amount, PolicyPlayer(agent.policy)) for agent in members]
        means = [float(result.success.mean()) for result in found]
        every = np.concatenate([result.success for result in found], axis=1)
        judge.success[name, amount] = every
        interval = stratified_bootstrap(means, np.mean)
        entry["success"][str(amount)] = {
            "mean": float(np.mean(means)),
            "iqm": float(interquartile_mean(means)),
            "seed_ci": None if interval is None else list(interval),
            "task_ci": list(task_bootstrap(every)),
            "seeds": means,
            "by_plan": float(np.mean([result.by_plan.mean() for result in found])),
            "picks": float(np.mean([result.picks.mean() for result in found])),
        }
        entry["outcomes"][str(amount)] = {
            ending: float(np.mean([result.shares()[ending] for result in found])) for ending in ENDINGS
        }
        if amount == headline:
            entry["slices"] = _slices(members[0], judge.evaluators[amount], every)
    return entry


def _compare(entries: list[dict[str, Any]], judge: _Judge) -> None:
    """Add to each agent its difference from the first one, and how likely a run of it is better than one of that."""
    for entry in entries:
        for amount, figures in entry["success"].items():
            reference = entries[0]["success"].get(amount)
            for key in ("difference", "difference_ci", "p_better", "p_better_ci"):
                figures[key] = None
            if entry is entries[0] or reference is None:
                continue
            tables = (judge.success[found["name"], int(amount)] for found in (entry, entries[0]))
            figures["difference"], *figures["difference_ci"] = paired_difference(*tables)
            seeds = figures["seeds"], reference["seeds"]
            if max(map(len, seeds)) > 1:  # of one run each it would be 0 or 1, and say nothing
                interval = probability_of_improvement_interval(*seeds)
                figures["p_better"] = probability_of_improvement(*seeds)
                figures["p_better_ci"] = None if interval is None else list(interval)


def _baselines(agent: OpenedAgent, judge: _Judge, distractors: Sequence[int]) -> list[dict[str, Any]]:
    rows = []
    for name, player in (("random", random_entity), ("recipe oracle", recipe_oracle)):
        success = {str(amount): float(judge(agent, amount, player).success.mean()) for amount in distractors}
        rows.append({"name": name, "success": success})
    return rows


def _curves(members: list[OpenedAgent]) -> dict[str, list[list[float | None]]]:
    """Success over training by part: step, mean over seeds, and the interval of the mean."""
    found = {}
    for part in ("test", "train"):
        key = f"{part}_success"
        rows = [{row.step: row.figures[key] for row in agent.metrics if key in row.figures} for agent in members]
        shared = sorted(set.intersection(*(set(row) for row in rows))) if rows else []
        points: list[list[float | None]] = []
        for step in shared:
            seeds = [row[step] for row in rows]
            interval = stratified_bootstrap(seeds, np.mean) or (None, None)
            points.append([step, float(np.mean(seeds)), *interval])
        if points:
            found[part] = points
    return found


def _lambda_curves(members: list[OpenedAgent]) -> list[dict[str, Any]]:
    """λ over training, by source and pick, the mean over seeds."""
    found = []
    for source in SYMBOLS:
        for pick in ("first", "second"):
            key = f"lambda_{source}_{pick}"
            rows = [{row.step: row.figures[key] for row in agent.metrics if key in row.figures} for agent in members]
            shared = sorted(set.intersection(*(set(row) for row in rows)))
            shared = shared[:: max(1, len(shared) // 100)]
            if shared:
                points = [[step, float(np.mean([row[step] for row in rows]))] for step in shared]
                found.append({"source": source, "pick": pick, "points": points})
    return found


def _slices(agent: OpenedAgent, evaluator: Evaluator, success: NDArray[np.bool_]) -> dict[str, list[dict[str, Any]]]:
    """Success by how many train recipes make the goal, by its layer, and by how well the scorer ranks its links."""
    graph, split = agent.opened.graph, agent.opened.split
    tasks = evaluator.engine.world.tasks
    train = graph.recipes[split.is_in("train")]
    made = np.bincount(train[:, 2], minlength=graph.num_entities)[tasks.goals]
    found = {
        "train_recipes": _between(success, made, ((0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, _TOP))),
        "layer": _between(success, layers(graph)[tasks.goals], ((-1, -1), (0, 3), (4, 6), (7, 9), (10, _TOP))),
    }
    ranks = _link_ranks(agent, tasks)
    if ranks is not None:
        found["link_rank"] = _between(success, ranks, ((1, 3), (4, 10), (11, 30), (31, 100), (101, _TOP)))
    return {name: rows for name, rows in found.items() if rows}


def _link_ranks(agent: OpenedAgent, tasks: Any) -> Ids | None:
    """Return for each task the worse rank of its two parts among all entities by v; the best over its plans."""
    knowledge = agent.policy.knowledge if isinstance(agent.policy, AttentionPolicy) else None
    if knowledge is None or "v" not in knowledge.sources:
        return None
    scores = knowledge.scores[knowledge.sources.index("v"), :-1, :-1].numpy()
    recipes = agent.opened.graph.recipes
    ranks = []
    for goal, plans in zip(tasks.goals.tolist(), tasks.plans, strict=True):
        row = scores[goal]
        ranks.append(min(max(_mean_rank(row, row[part]) for part in recipes[plan[-1], :2]) for plan in plans))
    return np.ceil(ranks).astype(np.int64)


def _mean_rank(scores: NDArray[np.float32], score: np.float32) -> float:
    """Return the rank of a score; equal ones share the mean of theirs."""
    return float((scores > score).sum() + ((scores == score).sum() + 1) / 2)


def _between(success: NDArray[np.bool_], values: Ids, bounds: Sequence[tuple[int, int]]) -> list[dict[str, Any]]:
    rows = []
    for low, high in bounds:
        mask = (values >= low) & (values <= high)
        if mask.any():
            name = "never" if high < 0 else str(low) if low == high else f"{low}+" if high == _TOP else f"{low}–{high}"
            interval = task_bootstrap(success[mask])
            rows.append(
                {"slice": name, "tasks": int(mask.sum()), "success": float(success[mask].mean()), "ci": list(interval)}
            )
    return rows


def _episodes(agent: OpenedAgent, part: TaskPart, distractors: int, episodes: int) -> list[dict[str, Any]]:
    if agent.config.policy.policy == "mlp":
        distractors = agent.config.tasks.distractors
    return explain_episodes(
        agent.policy, agent.opened, agent.config.tasks.environment(part, distractors), episodes=episodes
    )


def _pictures(values: dict[str, Any]) -> dict[str, Any]:
    agents, part = values["agents"], values["part"]
    colours = {entry["name"]: i for i, entry in enumerate(agents)}
    series, dashed, shared = {}, set(), {}
    for entry in agents:
        for curve, points in entry["curves"].items():
            name = f"{entry['name']}, {curve}"
            series[name] = [tuple(point) for point in points]
            shared[name] = colours[entry["name"]]
            if curve == "train":
                dashed.add(name)
    pictures: dict[str, Any] = {
        "curves": charts.curves(
            series,
            "environment steps",
            "greedy success",
            "Success on train and test tasks over training",
            percent=True,
            dashed=dashed,
            colours=shared,
        ),
        "lambdas": {},
        "slices": {},
    }
    for entry in agents:
        if entry["lambdas"]:
            lines = {
                f"{SYMBOLS[row['source']]} {row['pick']}": [(x, y, None, None) for x, y in row["points"]]
                for row in entry["lambdas"]
            }
            pictures["lambdas"][entry["name"]] = charts.curves(
                lines,
                "environment steps",
                "mean λ in the last batch",
                f"Mixing coefficients of {entry['name']} over training",
                dashed={name for name in lines if name.endswith("second")},
                colours={name: list(SYMBOLS.values()).index(name.split()[0]) for name in lines},
            )
    titles = {
        "train_recipes": "train recipes that make the goal",
        "layer": "crafting rounds to the goal",
        "link_rank": "worse rank of the two parts by v",
    }
    for key, title in titles.items():
        groups = {entry["name"]: entry["slices"][key] for entry in agents if key in entry["slices"]}
        if groups:
            labels = sorted({row["slice"] for rows in groups.values() for row in rows}, key=_lower_bound)
            cells = {
                name: [next(((r["success"], *r["ci"]) for r in rows if r["slice"] == label), None) for label in labels]
                for name, rows in groups.items()
            }
            pictures["slices"][key] = charts.dots(
                labels, cells, title, f"success on {part} tasks", f"Success by {title}"
            )
    return pictures


def _lower_bound(label: str) -> int:
    return -1 if label == "never" else int(re.split("[–+]", label)[0])
