"""``wordcraft-kg compare``."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from msgspec.structs import replace

from wordcraft_kg.base import MAX_SIZE, ConfigError, check_output, counted, whole
from wordcraft_kg.cli.console import (
    Output,
    aligned,
    check_file,
    check_table,
    refuse_given,
    whole_numbers,
    write_file,
    write_table,
)
from wordcraft_kg.cli.options import AGENT, Force, MovedGraph, Part, Table, Words
from wordcraft_kg.runs.record import read_run, run_folders, run_name

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.agent_metrics import AgentSuccess
    from wordcraft_kg.evaluation.agents import AgentsView
    from wordcraft_kg.evaluation.ranked_links import ComparedModel, LinkComparison

EXAMPLES = (
    "wordcraft-kg compare models/everyday models/everyday-recipes --out comparison.html",
    "wordcraft-kg compare runs/no-kg runs/partial",
    "wordcraft-kg compare runs/no-kg-seeds runs/partial-seeds --distractors 1,2,8",
)

# Of the bootstrap, on which intervals hardly depend; and `explain` shows more episodes.
FILE_ONLY = ["--resamples", "--seed", "--episodes"]

PAGE_ENDINGS = (".html", ".htm")
"""Endings of a page; the first is added to any other file name."""


@dataclass(frozen=True)
class AgentOptions:
    """Options for agents.

    Attributes:
        distractors: comma-separated numbers of distractors. Default: 1, 8 and the training value.
        distractor_seeds: distractor seeds for each task. Default: 5, or 1 above 6,000 tasks.
        episodes: episodes to explain for each agent.
    """

    part: Part = "test"
    distractors: Words = None
    distractor_seeds: int | None = None
    episodes: int = 2


@dataclass(frozen=True)
class LinkOptions:
    """Options for link predictors.

    Attributes:
        resamples: bootstrap resamples.
        seed: seed for the bootstrap, and for the sample if there are very many queries.
    """

    resamples: int = 2_000
    seed: int = 0


def compare(
    *runs: Path,
    agents: Annotated[AgentOptions, Parameter(name="*", group="Agents")] = AgentOptions(),
    links: Annotated[LinkOptions, Parameter(name="*", group="Link predictors")] = LinkOptions(),
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
            predictors (.html is added to another ending).
    """
    check_table(table, force=force)
    if not runs:
        raise ConfigError("compare needs run folders (agents) or model folders (link predictors).")
    folders = [run_folders(run) for run in runs]
    kinds = [read_run(seeds[0], "a run of an agent or a link predictor").kind for seeds in folders]
    agent = next((run for run, kind in zip(runs, kinds, strict=True) if kind == AGENT), None)
    predictor = next((run for run, kind in zip(runs, kinds, strict=True) if kind != AGENT), None)
    if agent and predictor:
        mixture = f"'{agent}' is an agent and '{predictor}' is a link predictor"
        raise ConfigError(
            f"{mixture}: they cannot be compared. Give agents only, or link predictors only."
        )
    if agent:
        refuse_given(links, "link predictors, but agents are compared")
        everyone = list(chain.from_iterable(folders))
        _compare_agents(everyone, agents, graph, out, table, force, output)
    else:
        refuse_given(agents, "agents, but link predictors are compared")
        contenders = list(zip(runs, folders, strict=True))
        _compare_links(contenders, links, graph, out, table, force, output)


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
    from wordcraft_kg.evaluation.agents import group_agents, summarise_agents, view_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    if options.distractor_seeds is not None:
        whole("distractor_seeds", options.distractor_seeds, 1, MAX_SIZE)
    whole("episodes", options.episodes, 0, MAX_SIZE)
    amounts = whole_numbers("distractors", options.distractors) if options.distractors else None
    groups = group_agents([open_agent(folder, graph) for folder in runs])
    folder = out or Path("reports") / "-and-".join(groups)
    check_output(folder, force=force)
    view = view_agents(
        groups,
        part=options.part,
        distractors=amounts,
        distractor_seeds=options.distractor_seeds,
        episodes=options.episodes,
    )
    write_report(make_agent_report(view), folder, force=force)
    page = folder / "index.html"
    rows = []
    for amount, agent in product(view.distractors, view.agents):
        success = agent.success.get(str(amount))
        if success is not None:
            rows.append(
                {
                    "agent": agent.name,
                    "distractors": amount,
                    "success": success.mean,
                    "over tasks": success.task_ci,
                    "over seeds": success.seed_ci,
                    "difference": success.difference,
                    "of difference": success.difference_ci,
                }
            )
    wrote = write_table(table, rows, force=force)
    text = [*_agents_text(view), *wrote, f"wrote {folder}/   open {page}"]
    output.result(summarise_agents(view, str(page)), text)


def _agents_text(view: "AgentsView") -> Iterator[str]:
    from wordcraft_kg.evaluation.agents import by_success

    reference = view.agents[0].name
    for amount in view.distractors:
        yield f"{view.part} tasks of depth {view.depth}, {counted(amount, 'distractor')}"
        rows = []
        for agent in by_success(view, amount):
            cells = _success(agent.success.get(str(amount)), view.split.unit)
            is_reference = agent.name == reference and len(view.agents) > 1
            rows.append((f"  {agent.name}", *cells, "reference" if is_reference else ""))
        yield from aligned(rows)
        for agent in view.agents:
            if str(amount) not in agent.success:
                yield f"  {agent.name} plays with {agent.trained_with} distractors only"


def _success(success: "AgentSuccess | None", unit: str) -> Iterator[str]:
    if success is None:
        yield "-"
        return
    tasks = _interval(success.task_ci)
    if success.seed_ci is None:
        yield f"{success.mean:.3f} {tasks} over {unit}, one seed"
    else:
        # Seeds may be alike by chance: their interval alone can be a point.
        seeds = _interval(success.seed_ci)
        yield f"{success.mean:.3f} {seeds} over {len(success.seeds)} seeds, {tasks} over {unit}"
    if success.difference is not None and success.difference_ci is not None:
        yield f"{success.difference:+.3f} {_interval(success.difference_ci, '+')} over {unit}"


def _interval(ends: tuple[float, float], sign: str = "") -> str:
    return f"[{ends[0]:{sign}.3f}, {ends[1]:{sign}.3f}]"


def _compare_links(
    runs: Sequence[tuple[Path, Sequence[Path]]],
    options: LinkOptions,
    graph: str | None,
    out: Path | None,
    table: Path | None,
    force: bool,
    output: Output,
) -> None:
    if out is not None and out.suffix.lower() not in PAGE_ENDINGS:
        # With the ending of a page, so that a browser shows it.
        out = out.with_name(out.name + PAGE_ENDINGS[0])
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
    view = compare(contenders, resamples=options.resamples, seed=options.seed)
    if out is not None:
        from wordcraft_kg.reports.link_report import comparison_page

        write_file(out, comparison_page(view), force=force)
        view = replace(view, out=str(out))
    rows = [
        {
            "model": model.name,
            "MRR": model.mrr,
            "interval": model.mrr_ci,
            "hits@1": model.hits_at_1,
            "hits@10": model.hits_at_10,
            "difference": model.difference,
            "of difference": model.difference_ci,
        }
        for model in by_mrr(view)
    ]
    output.result(view, [*_links_text(view), *write_table(table, rows, force=force)])


def _links_text(view: "LinkComparison") -> Iterator[str]:
    from wordcraft_kg.evaluation.ranked_links import by_mrr

    sample = (
        ""
        if view.sampled_from is None
        else f"a uniform sample of {view.triples:,} of {view.sampled_from:,} "
    )
    yield f"{view.queries:,} queries for {sample}unseen triples"
    yield from aligned((model.name, *_mrr(model)) for model in by_mrr(view))
    for model in view.models:
        if model.has_seen_the_test_recipes:
            yield f"note: {model.name} was trained on all recipes: it has seen these triples"
    if view.best is not None:
        level = (
            f"; no significant difference: {', '.join(view.not_significant)}"
            if view.not_significant
            else ""
        )
        yield f"best: {view.best}{level}"
    widened = (
        f"; intervals for differences are widened for {view.pairs} pairs of models (Bonferroni)"
    )
    yield f"95 % intervals over {view.unit}" + (widened if view.pairs > 1 else "")
    if view.out:
        yield f"wrote {view.out}   open {view.out}"


def _mrr(model: "ComparedModel") -> Iterator[str]:
    yield f"MRR {model.mrr:.3f} {_interval(model.mrr_ci or (0.0, 0.0))}"
    yield f"hits@10 {model.hits_at_10:.3f}"
    spread = (
        f"{len(model.seeds)} seeds {min(model.mrr_of_seeds):.3f} to {max(model.mrr_of_seeds):.3f}"
    )
    yield spread if len(model.seeds) > 1 else ""
    if model.difference is not None and model.difference_ci is not None:
        low, high = model.difference_ci
        verdict = "excludes 0" if low > 0 or high < 0 else "includes 0: no difference is shown"
        yield f"difference {model.difference:+.3f} {_interval(model.difference_ci, '+')} {verdict}"
    else:
        yield "reference"
