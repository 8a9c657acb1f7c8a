"""``wordcraft-kg reference``."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from msgspec.structs import replace

from wordcraft_kg.base.errors import ConfigError, OutputExistsError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, split_labels, whole_numbers
from wordcraft_kg.cli.options import Book
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.reference import OpenPlay, ReferenceRow, TaskPlay
    from wordcraft_kg.studies.references import ReferenceTable

EXAMPLES = (
    "wordcraft-kg reference everyday --distractors 1,2,8",
    "wordcraft-kg reference everyday --beside runs/no-kg",
    "wordcraft-kg reference everyday --open-ended",
)
List = Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)]
OURS = "Measured here, on this graph and split"
PLURALS = {
    "chance": "chance",
    "knowledge graph": "knowledge graphs",
    "oracle": "oracles",
    "agent": "agents",
    "people": "people",
    "language model": "language models",
    "other": "others",
}
THEIRS = "From the literature, in other environments: not the same tasks"


def reference(
    graph: Book = "everyday",
    *,
    distractors: List = None,
    part: TaskPart = "test",
    depth: int = 1,
    attempts: int | None = None,
    open_ended: Flag = False,
    base: List = None,
    beside: Annotated[list[Path] | None, Parameter(negative=(), consume_multiple=False)] = None,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Show figures to compare with: chance, graphs, the oracle, agents, people, language models, and your own.

    What the package has no figures of is measured now, by scripted players.

    Args:
        graph: graph folder, book's file, or known book's name.
        distractors: comma-separated numbers of distractors. Default: 1,2,8.
        part: tasks that were played: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        attempts: attempts in an episode. Default: depth.
        open_ended: entities known after n attempts of open-ended play, instead of success on tasks.
        base: comma-separated entities known at the start of open-ended play. Default: the graph's base.
        beside: your own, in the same table: run folder of an agent or a folder of its seeds, folder of `study serve`,
            file of `play --protocol paper`, folder of `evaluate-words`, file of `mcp --out`, log of Inspect AI. May be
            given several times.
        out: HTML page to write, with the same table.
        force: replace the page if it exists.
    """
    if out is not None and out.exists() and not force:
        raise OutputExistsError(f"'{out}' exists. Choose another --out, or replace it with --force.")
    from wordcraft_kg.envs.config import WordCraftConfig
    from wordcraft_kg.evaluation.reference import TaskPlay
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.studies.references import DISTRACTORS, view_open_references, view_references

    if open_ended:
        if distractors or (part, depth, attempts) != ("test", 1, None):
            raise ConfigError("--open-ended has no tasks; leave --distractors, --part, --depth and --attempts out.")
        view = view_open_references(open_graph(graph), split_labels(base) if base else None, beside or ())
    else:
        if base:
            raise ConfigError("--base is about open-ended play; add --open-ended.")
        amounts = whole_numbers("distractors", distractors) if distractors else list(DISTRACTORS)
        for amount in amounts:
            config = WordCraftConfig(part=part, depth=depth, num_distractors=amount, max_attempts=attempts)
        play = TaskPlay(part, depth, config.attempts)
        view = view_references(open_graph(graph), play, amounts, beside or ())
    if out is not None:
        from wordcraft_kg.base.artefacts import staged_file, write_atomically
        from wordcraft_kg.studies.references import reference_page

        with staged_file(out, force=force) as file:
            write_atomically(file, reference_page(view))
        view = replace(view, out=str(out))
    output.result(view, _text(view))


def _text(view: "ReferenceTable") -> Iterator[str]:
    graph, tasks = view.graph, view.measure == "success"
    what = _played(view.play)
    yield f"{graph.name} {graph.hash[:12]}, split {graph.kind} {graph.split[:12]}: {what}"
    yield ""
    notes = list(dict.fromkeys(row.remark for row in view.rows if row.remark))
    sources = list(dict.fromkeys(row.reference for row in view.literature))
    ours = [(row, _name(row, _letter(notes.index(row.remark)) if row.remark else "")) for row in view.rows]
    theirs = [(row, _name(row, str(sources.index(row.reference) + 1))) for row in view.literature]
    width = max(len(name) for _, name in [*ours, *theirs])
    fitting = [row for row, _ in [*ours, *theirs] if row.fits(view.measure)]
    cells = {id(row): [row.shown(column) for column in view.columns] for row in fitting}
    titles = [counted(column, "distractor" if tasks else "attempt") for column in view.columns]
    widths = [max(map(len, column)) for column in zip(titles, *cells.values(), strict=True)]
    yield _line("", titles, width, widths)
    for title, rows in ((OURS, ours), (THEIRS, theirs)):
        if not rows:
            continue
        yield title
        for kind, members in groupby(rows, key=lambda pair: pair[0].kind):
            yield f"  {PLURALS[kind]}"
            for row, name in members:
                yield _line(name, cells.get(id(row)) or [row.in_words], width, widths)
        yield ""
    yield from (f"[{_letter(number)}] {note}" for number, note in enumerate(notes))
    yield from (f"[{number}] {source}" for number, source in enumerate(sources, 1))
    yield f"intervals: {'; '.join(_intervals(view))}"
    if view.measured:
        unit = "distractor" if tasks else "attempt"
        now = f"{', '.join(map(str, view.measured))} {unit}{'' if view.measured == (1,) else 's'}"
        there = f"has no figures for {now}" if view.pack else "does not have this graph and split"
        yield f"measured now: scripted players with {now}, because the pack {there}"
    if view.out:
        yield f"wrote {view.out}"


def _played(play: "TaskPlay | OpenPlay") -> str:
    from wordcraft_kg.evaluation.reference import TaskPlay

    if isinstance(play, TaskPlay):
        return f"success on {play.part} tasks of depth {play.depth}, {counted(play.attempts, 'attempt')}"
    return f"entities known in open-ended play from {', '.join(play.base)}"


def _line(name: str, cells: Sequence[str], width: int, widths: Sequence[int]) -> str:
    padded = [f"{cell:<{widths[i]}}" for i, cell in enumerate(cells)]
    return "  ".join([f"    {name:<{width}}", *padded]).rstrip()


def _name(row: "ReferenceRow", mark: str) -> str:
    return f"{row.player}{' (yours)' * (row.origin == 'beside')}{f' [{mark}]' if mark else ''}"


def _letter(number: int) -> str:
    """Return a footnote's letters: a to z, then aa, ab and so on."""
    rounds, letter = divmod(number, len(ascii_lowercase))
    return (_letter(rounds - 1) if rounds else "") + ascii_lowercase[letter]


def _intervals(view: "ReferenceTable") -> Iterator[str]:
    """Yield what intervals there are, and of which players."""
    of: dict[str, dict[str, None]] = {}
    for row in view.rows:
        if row.interval:
            of.setdefault(row.interval, {})[PLURALS[row.kind]] = None
    for interval, kinds in of.items():
        yield interval + (f" ({', '.join(kinds)})" if len(of) > 1 else "")
