"""``wordcraft-kg people summary``."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import Force

if TYPE_CHECKING:
    from wordcraft_kg.apps.people.protocol import AgentGame, Session, TableKey
    from wordcraft_kg.apps.people.summary import AnswerRate, ExportedAnswers, HumanSummary

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg people summary study",
    "wordcraft-kg people summary one two --json",
    "wordcraft-kg people summary study --run runs/recipes",
    "wordcraft-kg people summary study --export answers.jsonl",
)
NOTE = (
    "95 % intervals: Wilson for rates, as if all answers were independent; bootstrap",
    "over people, and for agents over tasks that the split holds out together",
    "(Wilson for equal results). They are too narrow for few people.",
)


def people_summary(
    *studies: Path,
    run: Annotated[list[Path] | None, Parameter(negative=(), consume_multiple=False)] = None,
    export: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Show success rates of people in the protocol of the paper, and of agents for comparison.

    Intervals are 95 %.

    Args:
        studies: study folders (`people serve`) with equal graph and split.
        run: run folder of an agent, which plays at exactly the same tables. May be given several
            times.
        export: write the answers in one study folder to this JSON lines file instead; the server
            may be running.
    """
    from wordcraft_kg.apps.people.study import read_study
    from wordcraft_kg.apps.people.summary import view_people

    if export is not None:
        if run or len(studies) != 1:
            raise ConfigError("--export takes one folder of `people serve`, without --run.")
        output.result(*_exported(studies[0], export, force))
        return
    if force:
        raise ConfigError("--force replaces an exported file; add --export FILE.")
    sources = {path: read_study(path).sessions() for path in studies}
    if len(sources) < len(studies):
        raise ConfigError("a path is given twice; give each path once.")
    sessions = list(chain.from_iterable(sources.values()))
    view = view_people(sources, _compared(run or [], sessions))
    output.result(view, _text(view))


def _exported(folder: Path, out: Path, force: bool) -> tuple["ExportedAnswers", list[str]]:
    from wordcraft_kg.apps.people.study import read_study
    from wordcraft_kg.apps.people.summary import ExportedAnswers
    from wordcraft_kg.base.artefacts import staged_file
    from wordcraft_kg.base.records import as_lines

    # Read and checked as a whole before the file is made.
    study = read_study(folder)
    lines = as_lines(study.lines())
    with staged_file(out, force=force) as path:
        path.write_text("".join(lines), encoding="utf-8")
    view = ExportedAnswers(str(out), len(study.people), len(lines))
    return view, [f"wrote {out}: answers: {view.answers:,}, people: {view.people:,}"]


def _compared(
    runs: list[Path], sessions: "list[Session]"
) -> "dict[str, dict[TableKey, AgentGame]]":
    if not runs:
        return {}
    # Imported late: without --run, the command plays no agent.
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.apps.people.comparison import agent_successes

    return {agent.name: agent_successes(agent, sessions) for agent in map(open_agent, runs)}


def _text(view: "HumanSummary") -> Iterator[str]:
    yield f"{view.graph}; sessions: {view.sessions}, finished: {view.finished}"
    rows = []
    has_notes = False
    for condition in view.conditions:
        noun = "distractor" if condition.distractors == 1 else "distractors"
        amount = f"{condition.distractors} {noun}"
        for part, row in condition.parts.items():
            rows.append((f"{amount}, {part}", _metrics(row)))
            if row.people_interval:
                rows.append((f"  over {row.people} people", _interval(row.people_interval)))
            for name, agent in row.agents.items():
                shown = (
                    f"{agent.successes} of {row.answered} at the same {agent.tables} tables, "
                    f"rate {agent.rate:.3f} {_interval(agent.interval)}"
                )
                rows.append((f"  {name}", shown.rstrip()))
            has_notes |= bool(row.people_interval or row.agents)
    yield from aligned(rows)
    if has_notes:
        yield from NOTE


def _metrics(row: "AnswerRate") -> str:
    if row.interval is None:
        return "no answers"
    return (
        f"{row.successes} of {row.answered} correct, rate {row.rate:.3f} {_interval(row.interval)}"
    )


def _interval(bounds: tuple[float, float] | None) -> str:
    return f"[{bounds[0]:.3f}, {bounds[1]:.3f}]" if bounds else ""
