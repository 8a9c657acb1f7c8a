"""``wordcraft-kg reference``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import (
    Flag,
    Output,
    aligned,
    check_file,
    split_labels,
    whole_numbers,
    write_file,
)
from wordcraft_kg.cli.options import Force, Graph, Paths, Words
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.reference import OpenPlay, ReferenceRow, TaskPlay
    from wordcraft_kg.evaluation.reference_table import ReferenceTable

EXAMPLES = (
    "wordcraft-kg reference everyday --distractors 1,2,8",
    "wordcraft-kg reference everyday --external-results runs/no-kg",
    "wordcraft-kg reference everyday --open-ended",
)
OURS = "Measured here, on this graph and split"
THEIRS = "From the literature, in other environments: not the same tasks"


def reference(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph = "everyday",
    *,
    distractors: Words = None,
    part: TaskPart = "test",
    depth: int = 1,
    attempts: int | None = None,
    open_ended: Flag = False,
    base: Words = None,
    external_results: Paths = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Show reference results of chance, words, graphs, scorers, agents, people and language models.

    External results can be added. Missing results are measured with scripted players.

    Args:
        distractors: comma-separated numbers of distractors. Default: 1,2,8.
        part: evaluated tasks: train, valid, test or all.
        depth: recipes in the shortest plan, 1 to 5.
        attempts: attempts in an episode. Default: depth.
        open_ended: show known entities after n attempts in open-ended mode instead of success on
            tasks.
        base: comma-separated entities known at the start in open-ended mode. Default: the graph's
            base.
        external_results: results to add to the table: agent run folder (or folder with several
            seeds), model folder (the scorer alone), output of `people serve`, `evaluate-text` or
            `mcp --out`, or Inspect AI log. May be repeated.
        out: HTML page to write, with the same table.
    """
    check_file(out, force=force)  # before minutes of play
    from wordcraft_kg.envs.config import WordCraftConfig
    from wordcraft_kg.evaluation.reference import TaskPlay
    from wordcraft_kg.evaluation.reference_table import DISTRACTORS, open_play, view_references
    from wordcraft_kg.graphs.folder import open_graph

    if open_ended:
        if distractors or (part, depth, attempts) != ("test", 1, None):
            raise ConfigError(
                "--open-ended has no tasks; leave --distractors, --part, --depth and --attempts "
                "out."
            )
        opened = open_graph(graph)
        played = open_play(opened, split_labels(base) if base else None)
        view = view_references(opened, played, DISTRACTORS, external_results or ())
    else:
        if base:
            raise ConfigError("`base` is for open-ended mode; add `open_ended`.")
        amounts = whole_numbers("distractors", distractors) if distractors else list(DISTRACTORS)
        # Each number is checked before anything is measured; the attempts are the same in all.
        for amount in amounts:
            config = WordCraftConfig(
                part=part, depth=depth, num_distractors=amount, max_attempts=attempts
            )
        play = TaskPlay(part, depth, config.attempts)
        view = view_references(open_graph(graph), play, amounts, external_results or ())
    if out is not None:
        from wordcraft_kg.reports.pages import render_page

        write_file(out, render_page("reference_page.html.j2", report=view), force=force)
        view = replace(view, out=str(out))
    output.result(view, _text(view))


def _text(view: "ReferenceTable") -> Iterator[str]:
    graph = view.graph
    split = f"split {graph.kind} {graph.split[:12]}"
    yield f"{graph.name} {graph.hash[:12]}, {split}: {_played(view.play)}"
    everything = (*view.rows, *view.literature)
    # Footnotes: equal notes have one number.
    given = [note for note in map(_note, everything) if note]
    notes = list(dict.fromkeys(given))
    # A second column for each, if any row has the share of goals by the task's own recipe.
    has_own = any(any(map(row.shown_by_plan, view.columns)) for row in everything)
    yield from _lines_of_rows(view, notes, has_own=has_own)
    yield ""
    yield from (f"[{number}] {note}" for number, note in enumerate(notes, 1))
    if has_own:
        yield (
            "own: success by the task's own recipe; "
            "the rest by other recipes for the goal, such as train recipes"
        )
    yield f"intervals: {'; '.join(_intervals(view.rows))}"
    # The package holds results for its own books; others take time, and the reader knows why.
    if view.measured:
        plural = "" if view.measured == (1,) else "s"
        numbers = ", ".join(map(str, view.measured))
        now = f"{numbers} {_unit(view)}{plural}"
        reason = f"has no results for {now}" if view.pack else "does not have this graph and split"
        yield f"measured now: scripted players with {now}, because the pack {reason}"
    if view.out:
        yield f"wrote {view.out}"


def _lines_of_rows(view: "ReferenceTable", notes: Sequence[str], *, has_own: bool) -> Iterator[str]:
    """Yield the titles of the columns, then our rows and the literature's below their titles."""
    titles = ["", ""]
    for column in view.columns:
        titles.append(counted(column, _unit(view)))
        if has_own:
            titles.append("own")

    def name(row: "ReferenceRow") -> str:
        note = _note(row)
        mark = f" [{notes.index(note) + 1}]" if note else ""
        yours = " (yours)" if row.origin == "external" else ""
        return f"{row.player}{yours}{mark}"

    def figures(row: "ReferenceRow") -> Iterator[str]:
        for column in view.columns:
            yield row.shown(column)
            if has_own:
                yield row.shown_by_plan(column)

    fitting = [
        row for row in (*view.rows, *view.literature) if row.fits(view.measure, view.columns)
    ]
    cells = [(name(row), row.kind, *figures(row)) for row in fitting]
    # One table, aligned as a whole; its lines are then told apart by the titles between them.
    lines = iter(aligned([titles, *cells]))
    yield f"  {next(lines)}"
    for title, rows in ((OURS, view.rows), (THEIRS, view.literature)):
        yield from ("", title)
        for row in rows:
            if row.fits(view.measure, view.columns):
                yield f"  {next(lines)}"
            else:
                yield f"  {name(row)}, {row.kind}: {row.in_words}"


def _unit(view: "ReferenceTable") -> str:
    return "distractor" if view.measure == "success" else "attempt"


def _note(row: "ReferenceRow") -> str:
    return (row.reference if row.origin == "literature" else row.remark) or ""


def _played(play: "TaskPlay | OpenPlay") -> str:
    from wordcraft_kg.evaluation.reference import TaskPlay

    if isinstance(play, TaskPlay):
        tasks = f"{play.part} tasks of depth {play.depth}"
        return f"success on {tasks}, {counted(play.attempts, 'attempt')}"
    return f"entities known in open-ended mode from {', '.join(play.base)}"


def _intervals(rows: "Sequence[ReferenceRow]") -> list[str]:
    """Return the kinds of intervals; with several, also the kinds of players that each is for."""
    players: dict[str, dict[str, None]] = {}  # ordered sets
    for row in rows:
        if row.interval:
            players.setdefault(row.interval, {})[row.kind] = None
    if len(players) == 1:
        return list(players)
    return [f"{interval} ({', '.join(kinds)})" for interval, kinds in players.items()]
