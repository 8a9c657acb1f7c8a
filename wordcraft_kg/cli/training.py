"""What the training commands share: training, reporting, and how to continue after Ctrl-C."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.records import as_values
from wordcraft_kg.runs.interruption import interruption_message

if TYPE_CHECKING:
    from wordcraft_kg.agents.training import TrainedAgent
    from wordcraft_kg.models.links.training import TrainedLinks


def train(config: LinksConfig, out: Path | None, force: bool, output: Output) -> int:
    """Train a link predictor, print the outcome and return the exit code."""
    from wordcraft_kg.models.links.training import train_links

    progress = output.progress(f"{config.settings.kg} graph")
    return report(train_links(config, out, force=force, progress=progress), output)


def report(trained: "TrainedLinks", output: Output) -> int:
    """Print the outcome of a training run and return 0; raise KeyboardInterrupt when Ctrl-C ended it."""
    metrics = trained.metrics
    if metrics is None:
        raise KeyboardInterrupt(interruption_message(trained.folder, "epoch", trained.epoch))
    values = {"out": str(trained.folder), **as_values(metrics)}
    rows = [
        ("trained", f"{metrics.epochs} epochs on {metrics.triples:,} triples ({metrics.kg} graph)"),
        ("time", f"{metrics.seconds:.1f} s, {metrics.seconds_per_epoch:.3f} s per epoch"),
        ("parameters", f"{metrics.parameters:,}"),
        ("train MRR", f"{metrics.train_mrr:.3f} on its own training triples (memory)"),
    ]
    if metrics.choice:
        rows.append(("chosen", str(metrics.choice)))
    if metrics.valid_mrr is not None:
        rows.append(("valid MRR", f"{metrics.valid_mrr:.3f} at best, in epoch {metrics.best_epoch}"))
    if metrics.train_mrr < 0.1:
        logging.getLogger(__name__).warning(
            "the model hardly fits its own training triples; try %s.", _how_to_fit(LinksConfig.read(trained.folder))
        )
    output.result(
        values, [*aligned(rows), f"wrote {trained.folder}/   next: wordcraft-kg evaluate-links {trained.folder}"]
    )
    return 0


def _how_to_fit(config: LinksConfig) -> str:
    """Say which options of its command make a model remember more."""
    settings = config.settings
    if isinstance(settings, ComplExConfig):
        return "more --epochs, a larger --dim, or a smaller --n3"
    return "more --epochs, another --learning-rate" + (", or --loop symmetric" if settings.loop == "slcwa" else "")


def finished_without_report(folder: Path) -> "TrainedAgent | None":
    """Return the outcome of a finished run if its report is missing, else None."""
    from wordcraft_kg.agents.agent_folder import AGENTS
    from wordcraft_kg.agents.records import read_summary
    from wordcraft_kg.agents.training import TrainedAgent

    run = AGENTS.read_record(folder)
    if run.status != "done" or (folder / "report").exists():
        return None
    summary = read_summary(folder, run)
    return TrainedAgent(folder, summary.steps, summary)


def report_agent(trained: "TrainedAgent", graph: str | None, output: Output) -> int:
    """Write the report of an agent's training, print the outcome and return 0.

    Raises:
        KeyboardInterrupt: when Ctrl-C ended the training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.report import write_report
    from wordcraft_kg.views.agents import group_agents

    summary, folder = trained.summary, trained.folder
    if summary is None:
        raise KeyboardInterrupt(interruption_message(folder, "step", trained.step))
    success = summary.success
    part: TaskPart = "test" if "test" in success else "train"
    report = make_agent_report(group_agents([open_agent(folder, graph)]), part=part)
    write_report(report, folder / "report", force=True)
    values = {
        "out": str(folder),
        "report": str(folder / "report" / "index.html"),
        **as_values(summary),
        "success": {name: found.mean for name, found in success.items()},
    }
    values["success_ci"] = {name: [found.ci_low, found.ci_high] for name, found in success.items()}
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
            for name, found in success.items()
        ),
    ]
    output.result(values, [*aligned(rows), f"wrote {folder}/   open {folder / 'report' / 'index.html'}"])
    return 0
