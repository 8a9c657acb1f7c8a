"""``wordcraft-kg people serve`` and ``wordcraft-kg people summary``."""

import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.apps.people.study_config import CONSENT, StudyConfig
from wordcraft_kg.base import ConfigError, as_lines, counted, read_small_file, staged_file
from wordcraft_kg.cli.console import Flag, Output, aligned, whole_numbers
from wordcraft_kg.cli.options import Book, Force

if TYPE_CHECKING:
    from wordcraft_kg.apps.people.study import Session, TableKey
    from wordcraft_kg.apps.people.summary import (
        AgentGame,
        AnswerRate,
        HumanSummary,
    )

GROUP = "Tasks and play"
SUBJECT = "Run a study with people in the browser, and compare people with agents: serve, summary."
EXAMPLES = {
    "people serve": (
        "wordcraft-kg people serve everyday --tasks 20 --out study",
        "wordcraft-kg people serve kitchen --distractors 1,8 --forms 10 --out study",
    ),
    "people summary": (
        "wordcraft-kg people summary study",
        "wordcraft-kg people summary one two --json",
        "wordcraft-kg people summary study --run runs/recipes",
        "wordcraft-kg people summary study --export answers.jsonl",
    ),
}


def people_serve(  # noqa: PLR0913 - parameters are the command's options
    graph: Book,
    *,
    out: Path,
    tasks: int = StudyConfig.tasks,
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    forms: int = StudyConfig.forms,
    seed: int = StudyConfig.seed,
    consent: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8766,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    no_browser: Flag = False,
    output: Output = Output(),
) -> None:
    """Serve the human protocol of the paper in the browser; Ctrl-C stops the server.

    Repeat the command to resume.

    Several people can participate at once. Each answer is on disk before the next page. The study
    stores only the selected items, times and page loads.

    Args:
        graph: graph folder, recipe book file, or built-in book name.
        out: study folder.
        tasks: number of train tasks with feedback, and of test tasks without feedback.
        distractors: comma-separated numbers of distractors on a table. Several numbers are
            conditions, with people spread evenly over them. Default: 8.
        forms: number of task samples, with people spread evenly over them; 1 gives everybody the
            same tasks.
        seed: seed for the first form; further forms have the following seeds.
        consent: text file with the consent text. Default: a text that matches the stored data.
        host: address to listen on; other addresses than 127.0.0.1, such as 0.0.0.0, open the pages
            to other machines.
        port: port to listen on; 0 selects a free port.
        allow_host: further permitted host name or address, as with --host 0.0.0.0 or behind a
            proxy. May be given several times.
        no_browser: do not open the browser.
    """
    from wordcraft_kg.apps.people.study import HumanStudy, kept_answers
    from wordcraft_kg.base.extras import check_extra

    check_extra("explore")
    from wordcraft_kg.apps.people.web_app import make_study_app
    from wordcraft_kg.apps.web.serving import listen, serve

    amounts = whole_numbers("distractors", distractors) if distractors else StudyConfig.distractors
    config = StudyConfig(tasks, tuple(amounts), forms, seed, _consent(consent))
    # Before anything is written: a port in use must not leave a begun study.
    with listen(host, port) as listening:
        study = HumanStudy(graph, config)
        with kept_answers(out, study) as answers:

            def started(address: str) -> None:
                output.result({"address": address}, [f"{address}   Ctrl-C stops the server"])

            app = make_study_app(study, answers, host, allow_host or ())
            serve(app, listening, started, in_browser=not no_browser)
    print(
        f"stopped; the answers are in {out}: `wordcraft-kg people summary {out}` counts them, and "
        "the same command resumes the study",
        file=sys.stderr,
    )


def _consent(path: Path | None) -> str:
    if path is None:
        return CONSENT
    try:
        # Windows editors may add a byte order mark.
        lines = read_small_file(path).decode("utf-8-sig").strip().splitlines()
    except UnicodeError:
        raise ConfigError(f"--consent {path}: expected UTF-8 text.") from None
    # Blanks at the end of a line must not hide the blank line between two paragraphs.
    paragraphs = "\n".join(line.strip() for line in lines).split("\n\n")
    return "\n\n".join(paragraph.strip() for paragraph in paragraphs if paragraph.strip())


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
        output.result(*_exported(read_study(studies[0]), export, force))
        return
    if force:
        raise ConfigError("--force replaces an exported file; add --export FILE.")
    sources = {path: read_study(path) for path in studies}
    sessions = list(chain.from_iterable(sources.values()))
    view = view_people(sources, _compared(run or [], sessions))
    output.result(view, _text(view))


def _exported(
    sessions: "list[Session]", out: Path, force: bool
) -> tuple[dict[str, Any], list[str]]:
    lines = as_lines(chain.from_iterable(session.lines() for session in sessions))
    with staged_file(out, force=force) as path:
        path.write_text("".join(lines), encoding="utf-8")
    view = {"out": str(out), "people": len(sessions), "answers": len(lines)}
    return view, [f"wrote {out}: answers: {len(lines):,}, people: {len(sessions):,}"]


def _compared(
    runs: list[Path], sessions: "list[Session]"
) -> "dict[str, dict[TableKey, AgentGame]]":
    if not runs:
        return {}
    # Imported late: without --run, the command plays no agent.
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.apps.people.summary import agent_successes

    return {agent.name: agent_successes(agent, sessions) for agent in map(open_agent, runs)}


def _text(view: "HumanSummary") -> Iterator[str]:
    begun = sum(condition.sessions for condition in view.conditions)
    finished = sum(condition.finished for condition in view.conditions)
    yield f"{view.graph}; sessions: {begun}, finished: {finished}"
    rows = []
    for condition in view.conditions:
        amount = counted(condition.distractors, "distractor")
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
    yield from aligned(rows)
    yield from NOTE


def _metrics(row: "AnswerRate") -> str:
    if row.interval is None:
        return "no answers"
    return (
        f"{row.successes} of {row.answered} correct, rate {row.rate:.3f} {_interval(row.interval)}"
    )


def _interval(bounds: tuple[float, float] | None) -> str:
    return f"[{bounds[0]:.3f}, {bounds[1]:.3f}]" if bounds else ""
