"""``wordcraft-kg compare``."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base import ConfigError, check_output
from wordcraft_kg.cli.console import (
    Output,
    check_file,
    check_table,
    refuse_given,
    text_table,
    whole_numbers,
    write_file,
    write_table,
)
from wordcraft_kg.cli.options import AGENT, Force, MovedGraph, Part, Table, Words
from wordcraft_kg.runs.record import read_run, run_folders, run_name

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.agents import AgentsView
    from wordcraft_kg.evaluation.ranked_links import LinkComparison

EXAMPLES = (
    "wordcraft-kg compare models/everyday models/everyday-recipes --out comparison.html",
    "wordcraft-kg compare runs/no-kg runs/partial",
    "wordcraft-kg compare runs/no-kg-seeds runs/partial-seeds --distractors 1,2,8",
)


@dataclass(frozen=True)
class AgentOptions:
    """Options for agents.

    Attributes:
        distractors: comma-separated numbers of distractors. Default: 1, 8 and the training value.
        distractor_seeds: distractor seeds for each task. Default: 5, or 1 above 6,000 tasks.
    """

    part: Part = "test"
    distractors: Words = None
    distractor_seeds: int | None = None


def compare(
    *runs: Path,
    agents: Annotated[AgentOptions, Parameter(name="*", group="Agents")] = AgentOptions(),
    graph: MovedGraph = None,
    out: Path | None = None,
    table: Table = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Compare agents on the same tables, or link predictors on the same unseen triples.

    Differences are paired and resampled (bootstrap).

    Runs that differ only in the seed count as the same agent. Agents also get a report.

    Args:
        runs: agents' run folders, or model folders, for the same graph and split; or folders
            written with --seeds. The first is the reference of the differences; tables are sorted
            by success or MRR, best first.
        out: report folder for agents (default: reports/<agents' names>), or HTML page for link
            predictors, such as comparison.html.
    """
    check_table(table, force=force)
    if not runs:
        raise ConfigError("compare needs run folders (agents) or model folders (link predictors).")
    folders = [run_folders(run) for run in runs]
    kinds = [read_run(seeds[0], "a run of an agent or a link predictor").kind for seeds in folders]
    # A link predictor among agents is refused by its name when it is opened.
    if AGENT in kinds:
        everyone = list(chain.from_iterable(folders))
        _compare_agents(everyone, agents, graph, out, table, force, output)
    else:
        refuse_given(agents, "agents, but link predictors are compared")
        contenders = list(zip(runs, folders, strict=True))
        _compare_links(contenders, graph, out, table, force, output)


def _compare_agents(
    runs: Sequence[Path],
    options: AgentOptions,
    graph: str | None,
    out: Path | None,
    table: Path | None,
    force: bool,
    output: Output,
) -> None:
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.agents import group_agents, view_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    amounts = whole_numbers("distractors", options.distractors) if options.distractors else None
    groups = group_agents([open_agent(folder, graph) for folder in runs])
    folder = out or Path("reports") / "-and-".join(groups)
    check_output(folder, force=force)
    view = view_agents(
        groups,
        part=options.part,
        distractors=amounts,
        distractor_seeds=options.distractor_seeds,
    )
    write_report(make_agent_report(view), folder, force=force)
    page = folder / "index.html"
    rows = rows_of_agents(view)
    text = [
        f"{view.part} tasks of depth {view.depth}; tasks resampled by {view.unit}, "
        f"differences to {view.agents[0].name}",
        *text_table(rows),
        *write_table(table, rows, force=force),
        f"wrote {folder}/   open {page}",
    ]
    # Curves and episodes are in the report alone.
    values = {
        "report": str(page),
        "part": view.part,
        "depth": view.depth,
        "agents": {
            agent.name: {"runs": agent.runs, "seeds": agent.seeds, "success": agent.success}
            for agent in view.agents
        },
        "baselines": view.baselines,
    }
    output.result(values, text)


def rows_of_agents(view: "AgentsView") -> list[dict[str, Any]]:
    """Return the table of agents by number of distractors, the best first."""
    from wordcraft_kg.evaluation.agents import by_success

    rows = []
    for amount in view.distractors:
        for agent in by_success(view, amount):
            row: dict[str, Any] = {"agent": agent.name, "distractors": amount}
            # Some agents play with their training's number alone.
            success = agent.success.get(str(amount))
            if success is not None:
                row |= {
                    "success": success.mean,
                    "over tasks": success.task_ci,
                    "over seeds": success.seed_ci,
                    "difference": success.difference,
                    "of difference": success.difference_ci,
                }
            rows.append(row)
    return rows


def _compare_links(
    runs: Sequence[tuple[Path, Sequence[Path]]],
    graph: str | None,
    out: Path | None,
    table: Path | None,
    force: bool,
    output: Output,
) -> None:
    check_file(out, force=force)
    from wordcraft_kg.evaluation.ranked_links import Contender, by_mrr, compare
    from wordcraft_kg.models.model_folder import open_model

    if len(runs) < 2:
        raise ConfigError(f"only '{runs[0][0]}' to compare; give two link predictors or more.")
    names = Counter(run_name(folder) for folder, _ in runs)
    contenders = []
    for folder, seeds in runs:
        name = run_name(folder) if names[run_name(folder)] == 1 else str(folder)
        contenders.append(Contender(name, [open_model(run, graph) for run in seeds]))
    view = compare(contenders)
    if out is not None:
        from wordcraft_kg.reports.link_report import comparison_page

        write_file(out, comparison_page(view), force=force)
    rows = [
        {
            "model": model.name,
            "seeds": len(model.seeds),
            "MRR": model.mrr,
            "interval": model.mrr_ci,
            "hits@1": model.hits_at_1,
            "hits@10": model.hits_at_10,
            "difference": model.difference,
            "of difference": model.difference_ci,
        }
        for model in by_mrr(view)
    ]
    text = [*text_table(rows), *_notes(view), *write_table(table, rows, force=force)]
    if out is not None:
        text.append(f"wrote {out}   open {out}")
    output.result(view, text)


def _notes(view: "LinkComparison") -> Iterator[str]:
    sample = f" (a uniform sample of {view.sampled_from:,})" if view.sampled_from else ""
    widened = f", widened for {view.pairs} pairs of models (Bonferroni)" if view.pairs > 1 else ""
    yield (
        f"{view.queries:,} queries for {view.triples:,} unseen triples{sample}; 95 % intervals "
        f"over {view.unit}; differences to {view.models[0].name}{widened}"
    )
    for model in view.models:
        if model.has_seen_the_test_recipes:
            yield f"note: {model.name} was trained on all recipes: it has seen these triples"
    if view.best is not None:
        level = ", ".join(view.not_significant)
        yield f"best: {view.best}" + (f"; no significant difference: {level}" if level else "")
