"""What the training commands share: training one seed or several, reporting, and how to continue after Ctrl-C."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.cli.console import Output, aligned, read_seeds
from wordcraft_kg.graphs.doses import dose_words
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.runs.folder import check_run_output
from wordcraft_kg.runs.interruption import interruption_message

if TYPE_CHECKING:
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.agents.training import TrainedAgent
    from wordcraft_kg.models.links.records import LinkMetrics
    from wordcraft_kg.models.links.training import TrainedLinks
    from wordcraft_kg.models.recipes.records import RecipeMetrics
    from wordcraft_kg.models.recipes.training import TrainedRecipes

T = TypeVar("T", "TrainedAgent", "TrainedLinks")
Values = dict[str, Any]


# --- link predictors -------------------------------------------------------------------------------------------------


def train(
    config: LinksConfig, seeds: str | None, out: Path | None, force: bool, trackers: Sequence[str], output: Output
) -> int:
    """Train a link predictor with one seed or several, print the outcome and return the exit code."""
    if out is not None and seeds is None:
        check_run_output(out, force=force)  # before torch takes seconds to import
    from wordcraft_kg.models.links.training import train_links

    if seeds is not None:
        return _train_links_seeds(config, seeds, out, force, trackers, output)
    progress = output.progress(f"{config.settings.kg} graph")
    return report(train_links(config, out, force=force, trackers=trackers, progress=progress), output)


def report(trained: "TrainedLinks", output: Output) -> int:
    """Print the outcome of a training run and return 0; raise KeyboardInterrupt when Ctrl-C ended it."""
    metrics = trained.metrics
    if metrics is None:
        raise KeyboardInterrupt(interruption_message(trained.folder, "epoch", trained.epoch))
    rows = [
        ("trained", f"{metrics.epochs} epochs on {metrics.triples:,} triples ({metrics.kg} graph)"),
        *_learned_from(metrics),
        ("time", f"{metrics.seconds:.1f} s, {metrics.seconds_per_epoch:.3f} s per epoch"),
        ("parameters", f"{metrics.parameters:,}"),
        ("train MRR", f"{metrics.train_mrr:.3f} on its own training triples (memory)"),
    ]
    if metrics.choice:
        rows.append(("chosen", str(metrics.choice)))
    if metrics.fold_mrr is not None:
        figures = f"{metrics.fold_mrr:.3f} where they were not in training, {metrics.fold_in_sample_mrr:.3f} where"
        rows.append(("folds", f"{metrics.folds}; MRR of train triples {figures} they were"))
    if metrics.valid_mrr is not None:
        rows.append(("valid MRR", f"{metrics.valid_mrr:.3f} at best, in epoch {metrics.best_epoch}"))
    if metrics.choice and not metrics.choice.beats_counting:
        logging.getLogger(__name__).warning(
            "on held-out train recipes no candidate is better than counting how often an entity occurs; expect no more "
            "of unseen triples."
        )
    if metrics.train_mrr < 0.1:
        logging.getLogger(__name__).warning(
            "the model hardly fits its own training triples; try %s.", _how_to_fit(LinksConfig.read(trained.folder))
        )
    output.result(
        _link_values(trained),
        [*aligned(rows), f"wrote {trained.folder}/   next: wordcraft-kg evaluate-links {trained.folder}"],
    )
    return 0


def _learned_from(metrics: "LinkMetrics | RecipeMetrics") -> list[tuple[str, str]]:
    words = dose_words(metrics.share, metrics.noise)
    return [("from", words)] if words else []


def _how_to_fit(config: LinksConfig) -> str:
    """Say which options of its command make a model remember more."""
    settings = config.settings
    if isinstance(settings, ComplExConfig):
        return "more --epochs, a larger --dim, or a smaller --n3"
    return "more --epochs, another --learning-rate" + (", or --loop symmetric" if settings.loop == "slcwa" else "")


def _link_values(trained: "TrainedLinks") -> Values:
    return {"out": str(trained.folder), **as_values(trained.metrics)}


def _train_links_seeds(
    config: LinksConfig, seeds: str, out: Path | None, force: bool, trackers: Sequence[str], output: Output
) -> int:
    from wordcraft_kg.base.records import parse_record
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.models.links.records import LinkMetrics
    from wordcraft_kg.models.links.training import LINKS, TrainedLinks, resume_links, train_links
    from wordcraft_kg.runs.record import RunRecord, verified_bytes
    from wordcraft_kg.runs.seeds import SeededTraining, train_seeds

    def settings(folder: Path, run: RunRecord) -> LinksConfig:
        verified_bytes(folder, run, "config.toml")
        return LinksConfig.read(folder)

    def finished(folder: Path, run: RunRecord) -> TrainedLinks:
        metrics = parse_record(verified_bytes(folder, run, "metrics.json"), LinkMetrics, folder / "metrics.json")
        return TrainedLinks(folder, metrics.epochs, metrics)

    configs = {
        seed: replace(config, settings=replace(config.settings, seed=seed))
        for seed in _seeds(seeds, config.settings.seed)
    }
    opened = open_graph(config.graph)
    parent = config.default_folder(opened.graph.name) if out is None else out
    training: SeededTraining[LinksConfig, TrainedLinks] = SeededTraining(
        LINKS,
        {"graph": opened.graph.hash, "split": opened.split.hash},
        lambda one, folder, force: train_links(
            one, folder, force=force, trackers=trackers, progress=output.progress(folder.name)
        ),
        lambda folder: resume_links(folder, graph=config.graph, progress=output.progress(folder.name)),
        finished,
        settings,
        # What is None was left to the training to decide, which wrote its decision into config.toml.
        lambda one: {name: value for name, value in vars(one.settings).items() if value is not None},
    )
    trained = _until_interrupted(train_seeds(parent, configs, training, force=force), len(configs), force)
    values = {str(seed): _link_values(outcome) for seed, outcome in trained.items()}
    rows = [
        (f"seed {seed}", f"train MRR {outcome.metrics.train_mrr:.3f} (memory), {outcome.metrics.epochs} epochs")
        for seed, outcome in trained.items()
        if outcome.metrics is not None
    ]
    following = f"wordcraft-kg compare {parent} ANOTHER"
    output.result({"out": str(parent), "seeds": values}, [*aligned(rows), f"wrote {parent}/   next: {following}"])
    return 0


def report_recipes(trained: "TrainedRecipes", output: Output) -> int:
    """Print the outcome of a recipe scorer's fit and return 0."""
    metrics = trained.metrics
    rows = [
        ("fitted", f"{metrics.recipes:,} recipes ({metrics.kg} graph)"),
        *_learned_from(metrics),
        ("time", f"{metrics.seconds:.1f} s"),
    ]
    if metrics.fold_mrr is not None:
        figures = f"{metrics.fold_mrr:.3f} where they were not in the fit, {metrics.fold_in_sample_mrr:.3f} where"
        rows.append(("folds", f"{metrics.folds}; MRR of train triples {figures} they were"))
    output.result(
        {"out": str(trained.folder), **as_values(metrics)},
        [*aligned(rows), f"wrote {trained.folder}/   next: wordcraft-kg evaluate-links {trained.folder}"],
    )
    return 0


# --- agents ----------------------------------------------------------------------------------------------------------


def finished_agent(folder: Path) -> "TrainedAgent":
    """Return the outcome of a finished run."""
    from wordcraft_kg.agents.agent_folder import AGENTS
    from wordcraft_kg.agents.records import read_summary
    from wordcraft_kg.agents.training import TrainedAgent

    summary = read_summary(folder, AGENTS.read_record(folder))
    return TrainedAgent(folder, summary.steps, summary)


def finished_without_report(folder: Path) -> "TrainedAgent | None":
    """Return the outcome of a finished run if its report is missing, else None."""
    from wordcraft_kg.agents.agent_folder import AGENTS

    is_done = AGENTS.read_record(folder).status == "done"
    return finished_agent(folder) if is_done and not (folder / "report").exists() else None


def train_one_agent(
    config: "AgentConfig", out: Path | None, force: bool, trackers: Sequence[str], output: Output
) -> int:
    """Train an agent, write its report, print the outcome and return the exit code."""
    from wordcraft_kg.agents.training import train_agent

    progress = output.progress("agent", unit="step")
    trained = train_agent(config, out, force=force, trackers=trackers, progress=progress)
    return report_agent(trained, config.graph, output)


def report_agent(trained: "TrainedAgent", graph: str | None, output: Output) -> int:
    """Write the report of an agent's training, print the outcome and return 0.

    Raises:
        KeyboardInterrupt: when Ctrl-C ended the training.
    """
    summary, folder = trained.summary, trained.folder
    if summary is None:
        raise KeyboardInterrupt(interruption_message(folder, "step", trained.step))
    _write_agent_report(trained, graph)
    rows = [
        ("trained", f"{summary.steps:,} steps in {summary.seconds:.1f} s"),
        (
            "speed",
            f"{summary.steps_per_second:,} steps/s; {summary.curves_share:.1%} of the time spent on the curves",
        ),
        *(
            (
                f"{name} tasks",
                f"success {found.mean:.3f} [{found.ci_low:.3f}, {found.ci_high:.3f}] greedy, "
                f"{found.tasks:,} tasks with {found.draws} draws of {summary.distractors} distractors",
            )
            for name, found in summary.success.items()
        ),
    ]
    page = folder / "report" / "index.html"
    output.result(_agent_values(trained), [*aligned(rows), f"wrote {folder}/   open {page}"])
    return 0


def _write_agent_report(trained: "TrainedAgent", graph: str | None) -> None:
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.agents import group_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    assert trained.summary is not None
    part: TaskPart = "test" if "test" in trained.summary.success else "train"
    report = make_agent_report(group_agents([open_agent(trained.folder, graph)]), part=part)
    write_report(report, trained.folder / "report", force=True)


def _agent_values(trained: "TrainedAgent") -> Values:
    assert trained.summary is not None
    success = trained.summary.success
    return {
        "out": str(trained.folder),
        "report": str(trained.folder / "report" / "index.html"),
        **as_values(trained.summary),
        "success": {name: found.mean for name, found in success.items()},
        "success_ci": {name: [found.ci_low, found.ci_high] for name, found in success.items()},
    }


def train_agent_seeds(
    config: "AgentConfig", seeds: str, out: Path | None, force: bool, trackers: Sequence[str], output: Output
) -> int:
    """Train an agent with several seeds, write their reports, print the outcome and return the exit code."""
    from wordcraft_kg.agents.agent_folder import AGENTS, read_run_config
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.agents.training import TrainedAgent, resume_agent, train_agent
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.models.scorers.folder import FOLDS_TENSORS
    from wordcraft_kg.runs.record import read_finished_run
    from wordcraft_kg.runs.seeds import SeededTraining, train_seeds

    def reported(trained: TrainedAgent) -> TrainedAgent:
        if trained.summary is not None and not (trained.folder / "report").exists():
            _write_agent_report(trained, config.graph)
        return trained

    configs = {
        seed: replace(config, trainer=replace(config.trainer, seed=seed)) for seed in _seeds(seeds, config.trainer.seed)
    }
    opened = open_graph(config.graph)
    parent = config.default_folder(opened.graph.name) if out is None else out
    scorer, folds = None, None
    if config.scorer is not None:
        weights = "model.safetensors"
        expected = "a model of train-complex, train-links, train-recipes or ask-opinions"
        outputs = read_finished_run(Path(config.scorer), expected, weights).outputs
        scorer = outputs[weights]
        folds = None if config.policy.in_sample else outputs.get(FOLDS_TENSORS)
    training: SeededTraining[AgentConfig, TrainedAgent] = SeededTraining(
        AGENTS,
        {"graph": opened.graph.hash, "split": opened.split.hash, "scorer": scorer, "scorer_folds": folds},
        lambda one, folder, force: train_agent(
            one, folder, force=force, trackers=trackers, progress=output.progress(folder.name, unit="step")
        ),
        lambda folder: resume_agent(folder, graph=config.graph, progress=output.progress(folder.name, unit="step")),
        lambda folder, _: finished_agent(folder),
        read_run_config,
        lambda one: one.values(),
    )
    outcomes = ((seed, reported(one)) for seed, one in train_seeds(parent, configs, training, force=force))
    trained = _until_interrupted(outcomes, len(configs), force)
    values = {str(seed): _agent_values(outcome) for seed, outcome in trained.items()}
    part = "test" if all("test" in one["success"] for one in values.values()) else "train"
    found = {seed: one["success"][part] for seed, one in values.items()}
    rows = [(f"seed {seed}", f"success {success:.3f} on {part} tasks") for seed, success in found.items()]
    spread = f"from {min(found.values()):.3f} to {max(found.values()):.3f}"
    rows.append(("mean", f"success {sum(found.values()) / len(found):.3f}, {spread}"))
    output.result(
        {"out": str(parent), "seeds": values},
        [*aligned(rows), f"wrote {parent}/   next: wordcraft-kg compare {parent}"],
    )
    return 0


# --- several seeds ---------------------------------------------------------------------------------------------------


def _seeds(seeds: str, seed: int) -> list[int]:
    if seed:
        raise ConfigError(f"--seed {seed} and --seeds {seeds}: give one of them.")
    return read_seeds(seeds)


def _until_interrupted(outcomes: Iterator[tuple[int, T]], number: int, force: bool) -> dict[int, T]:
    """Train the seeds and return their outcomes.

    Raises:
        KeyboardInterrupt: saying how to go on, if Ctrl-C ended one of them.
    """
    trained: dict[int, T] = {}
    try:
        for seed, outcome in outcomes:
            if outcome.interrupted:
                raise KeyboardInterrupt
            trained[seed] = outcome
    except KeyboardInterrupt:
        again = "the same command goes on with the others"
        if force:
            again = "the same command begins again; without --force it keeps seeds that were trained before"
        message = f"interrupted; {len(trained)} of {number} seeds are done, {again}"
        raise KeyboardInterrupt(message) from None
    return trained
