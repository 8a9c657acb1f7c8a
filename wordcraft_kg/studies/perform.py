"""Performing a task in its folder: train, resume, or return the finished task."""

import logging
import platform
import time
from errno import EDQUOT, ENOSPC
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    OutputExistsError,
    WordCraftKGError,
    reason,
)
from wordcraft_kg.graphs import (
    OpenedGraph,
    PlayedGraph,
    RecipeGraph,
    SplitConfig,
    TaskPart,
    make_split,
    open_book,
    open_graph,
    write_graph_folder,
)
from wordcraft_kg.runs.record import RunFiles, package_versions
from wordcraft_kg.runs.training import train
from wordcraft_kg.studies.plan import Kind, Outcome, Task, agent_config, content_of, scorer_config
from wordcraft_kg.studies.results import (
    METRICS_FILE,
    REMAKE,
    RunMetrics,
    ScorerMetrics,
    TaskMetrics,
    read_metrics,
    write_metrics,
)
from wordcraft_kg.studies.study import PLAYER

if TYPE_CHECKING:
    from wordcraft_kg.agents.players import Player

METRICS: dict[Kind, type[TaskMetrics | RunMetrics]] = {
    "graphs": TaskMetrics,
    "scorers": ScorerMetrics,
    "runs": RunMetrics,
}
_LARGE = ("constants.safetensors", "policy.safetensors", "episodes.jsonl")
"""Run files that its metrics do not need: tens of megabytes each."""


def is_done(task: Task, root: Path) -> bool:
    """Return whether a task has intact results in the results folder ``root``."""
    if not (task.folder(root) / METRICS_FILE).exists():
        return False
    try:
        read_metrics(task.folder(root), METRICS[task.kind])
    except ArtefactError as error:
        logging.getLogger(__name__).warning("%s The task is repeated now.", error)
        return False
    return True


def platform_of(device: str) -> str:
    """Return what decides rounding besides versions.

    That is the system, the machine, and the instruction set or (for a device) the GPU.
    """
    import torch

    cuda = device.startswith("cuda")
    unit = torch.cuda.get_device_name(device) if cuda else torch.backends.cpu.get_cpu_capability()
    return f"{platform.system()} {platform.machine()} {unit}"


def make_graph(task: Task, root: Path) -> None:
    """Write a graph's folder in the results folder ``root``, and replace an earlier one.

    Raises:
        RecipeFileError: if the book is missing or damaged.
        ArtefactError: if the book has changed since the study was planned: the address is for the
            earlier content.
    """
    folder = task.folder(root)
    recipes = open_book(task.book)
    graph = RecipeGraph.from_book(recipes)
    split = make_split(graph, SplitConfig(**task.settings["split"]))
    planned_split = task.settings.get("split_hash", split.hash)
    if graph.hash != task.settings["graph"] or split.hash != planned_split:
        raise ArtefactError(
            f"the book '{task.book}' has changed since the study was planned; repeat the command."
        )
    write_graph_folder(folder, recipes, split, force=True)
    write_metrics(
        folder, TaskMetrics(seconds=0.0, versions={"wordcraft-kg": version("wordcraft-kg")})
    )


def perform(task: Task, root: Path, keep_all: bool = True) -> Outcome:
    """Train or resume a task; raises no error, so that other tasks go on.

    Args:
        task: task of the kind "scorers" or "runs", whose inputs are done.
        root: results folder.
        keep_all: keep also files of a run that its results do not need, such as the agent's
            weights.

    Returns:
        The outcome, with the error of a failed training.
    """
    try:
        _check_content(task)
        if task.kind == "scorers":
            _scorer(task, root)
        else:
            _run(task, root, keep_all)
    except KeyboardInterrupt:
        return Outcome(task.address, "interrupted")
    except (ArtefactError, OutputExistsError) as error:
        # The error's own remedy is that of a single training.
        return Outcome(task.address, "failed", f"{error} {REMAKE}")
    except WordCraftKGError as error:
        return Outcome(task.address, "failed", str(error))
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT):
            remedy = "Finished tasks are safe; free some space, then repeat the command."
            return Outcome(task.address, "failed", f"{error}. {remedy}")
        # An error that is not the user's: its traceback goes to the log.
        logging.getLogger(__name__).exception("'%s' failed", task.title)
        return Outcome(task.address, "failed", reason(error))
    return Outcome(task.address, "done")


def _check_content(task: Task) -> None:
    """Raise ConfigError for other vectors than those of the address, which has their hash."""
    features = task.settings["settings"].get("features")
    planned = task.settings.get("content")
    if planned is not None and content_of(features)["content"] != planned:
        raise ConfigError(
            f"the vectors of '{features}' have changed since the study was planned, or are others "
            "on this machine; repeat the command."
        )


def _run(task: Task, root: Path, keep_all: bool) -> None:
    from wordcraft_kg.agents.agent_training import AgentTraining

    if PLAYER in task.settings["settings"]:
        _play(task, root)
        return
    folder = task.folder(root)
    inputs = [str(root / address) for address in task.needs]
    graph = inputs[0]
    scorer = inputs[1] if len(inputs) > 1 else None
    config = agent_config(task.settings["settings"], graph, scorer)
    train(AgentTraining, config, folder, keep=True)
    # Results are written before files go: a kill in between leaves a task that is done.
    write_metrics(folder, _run_metrics(folder, open_graph(graph), task.device))
    if not keep_all:
        for name in _LARGE:
            (folder / name).unlink()


def _play(task: Task, root: Path) -> None:
    """Let a player without training play the test tasks, and write its results."""
    from wordcraft_kg.agents import players
    from wordcraft_kg.agents.agent_config import TaskConfig
    from wordcraft_kg.agents.evaluation import Evaluator
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.models.policies.policy_config import PolicyConfig
    from wordcraft_kg.models.scorers.features import make_features

    began = time.perf_counter()
    settings = dict(task.settings["settings"])
    name = settings.pop(PLAYER)
    features = settings.pop("features", PolicyConfig.features)
    opened = open_graph(str(root / task.needs[0]))
    if name == "random pair":
        player: Player = players.random_distinct
    elif name == "nearest words":
        vectors = make_features(features, opened.graph.entities).unit_vectors
        player = players.nearest_words(vectors)
    else:
        model = open_model(root / task.needs[1])
        by_name = players.scorer_players(opened.graph, model.scorer, model.triples, plans=True)
        player = by_name[{"best pair": players.BEST_PAIR, "planner": players.PLANNER}[name]]
    evaluator = Evaluator(World(opened, TaskConfig(**settings).environment("test")))
    result = evaluator(player)
    figures = RunMetrics(
        seconds=round(time.perf_counter() - began, 3),
        versions=dict(package_versions()),
        platform=platform_of(task.device),
        graph=PlayedGraph.of(opened),
        success={"test": float(result.success.mean())},
        by_plan={"test": float(result.by_plan.mean())},
        terminations={str(reason): share for reason, share in result.shares().items()},
        won="".join(map(str, result.success.sum(axis=1))),
        distractor_seeds=evaluator.distractor_seeds,
        curve=(),
        steps=0,
        steps_per_second=0,
    )
    folder = task.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    write_metrics(folder, figures)


def _run_metrics(folder: Path, opened: OpenedGraph, device: str) -> RunMetrics:
    from wordcraft_kg.agents.agent_folder import AGENTS
    from wordcraft_kg.agents.agent_records import read_episodes, read_metrics, read_summary

    files = RunFiles(folder, AGENTS.read_record(folder))
    summary = read_summary(files)
    part: TaskPart = "test" if "test" in summary.success else "train"
    lines = read_metrics(files.bytes("metrics.jsonl"), folder / "metrics.jsonl")
    name = f"{part}_success"
    # Five digits hold a share of all tasks, and keep studies with many points small.
    curve = [(row.step, round(row.figures[name], 5)) for row in lines if name in row.figures]
    distractor_seeds = summary.success[part].distractor_seeds
    played = [task for task in read_episodes(folder) if task.part == part]
    return RunMetrics(
        seconds=summary.seconds,
        versions=files.run.versions,
        platform=platform_of(device),
        graph=PlayedGraph.of(opened),
        success={name: rate.mean for name, rate in summary.success.items()},
        by_plan={name: rate.by_plan for name, rate in summary.success.items()},
        terminations={str(name): share for name, share in summary.outcomes[part].items()},
        won="".join(str(round(task.success * distractor_seeds)) for task in played),
        distractor_seeds=distractor_seeds,
        curve=tuple(curve),
        steps=summary.steps,
        steps_per_second=summary.steps_per_second,
    )


def _scorer(task: Task, root: Path) -> None:
    """Train a scorer and write its results."""
    from wordcraft_kg.models.links.link_config import LinksConfig
    from wordcraft_kg.models.links.link_training import LinksTraining
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
    from wordcraft_kg.models.recipes.recipe_training import RecipesTraining
    from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for

    folder = task.folder(root)
    graph = str(root / task.needs[0])
    command = task.settings["command"]
    config = scorer_config(command, task.settings["settings"])
    began = time.perf_counter()
    if command in RecipesConfig.commands:
        train(RecipesTraining, RecipesConfig(graph, config), folder, keep=True)
    else:
        train(LinksTraining, LinksConfig(graph, config), folder, keep=True)
    seconds = time.perf_counter() - began
    model = open_model(folder)
    unseen = model.opened.split.held_out("test")
    # On the full graph the scorer has seen the test triples.
    mrr = None
    if model.kg == "partial" and len(unseen):
        sample = sampled_for(model.opened.graph, unseen)
        ranked = rank_triples(model.scorer, sample, model.opened.graph.triples)
        mrr = round(mean_reciprocal_rank(ranked), 6)
    figures = ScorerMetrics(
        seconds=round(seconds, 3),
        versions=model.run.versions,
        platform=platform_of(task.device),
        mrr=mrr,
        kg=model.kg,
    )
    write_metrics(folder, figures)
