"""``wordcraft-kg discover``."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import counted, quoted
from wordcraft_kg.cli.console import Output, aligned, check_file, split_labels, write_file
from wordcraft_kg.cli.options import Force, Graph, OptionalBook, Words

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.discovery import DiscoveryView, KnownEntities
    from wordcraft_kg.evaluation.reference import ReferenceRow

EXAMPLES = (
    "wordcraft-kg discover everyday --players random,greedy --runs 20",
    "wordcraft-kg discover everyday --scorer models/everyday-recipes --out discovery.html",
    "wordcraft-kg discover little-alchemy-2 --scorer models/everyday-recipes --attempts 500 --runs "
    "20",
    "wordcraft-kg discover everyday --book little-alchemy-2 --attempts 500 --runs 10",
)


def discover(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph = "everyday",
    *,
    attempts: int = 100,
    runs: int = 100,
    players: Words = None,
    scorer: Path | None = None,
    book: OptionalBook = None,
    base: Words = None,
    seed: int = 0,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Evaluate scripted players in open-ended mode: count discoveries, and compare with people.

    Args:
        attempts: combinations for each run.
        runs: runs for each player.
        players: comma-separated: random, random-no-repeat, nearest-words (similar labels), greedy,
            empowerment (both know the graph), recipe-learner (guided by --scorer), book-votes
            (guided by --book). Default: all that --scorer and --book allow, without nearest-words.
        scorer: model folder of train-recipes, on this book or another one.
        book: another book whose recipes guide book-votes.
        base: comma-separated entities known at the start. Default: the graph's base. People begin
            with air, earth, fire and water.
        seed: root seed.
        out: HTML page to write, with curves, a map of discoveries and the reasons of
            recipe-learner.
    """
    check_file(out, force=force)  # before minutes of play
    from wordcraft_kg.agents.discovery import DISCOVERERS, GUIDED
    from wordcraft_kg.evaluation.discovery import explain_run, open_guide, view_discovery
    from wordcraft_kg.graphs.folder import open_graph

    played = open_graph(graph).graph
    guide = None if scorer is None else open_guide(scorer, played)
    # Nearest words load word vectors, so they play on request alone.
    playable = [name for name in DISCOVERERS if name not in (*GUIDED, "nearest-words")]
    if guide is not None:
        playable.append("recipe-learner")
    votes = None if book is None else open_graph(book).graph
    if votes is not None:
        playable.append("book-votes")
    selection = list(dict.fromkeys(split_labels(players))) if players else playable
    if not selection:
        raise ConfigError(f"`players`: expected at least one of {', '.join(DISCOVERERS)}.")
    labels = split_labels(base) if base else None
    view, plays = view_discovery(
        played,
        selection,
        attempts=attempts,
        runs=runs,
        seed=seed,
        base=labels,
        scorer=guide,
        book=votes,
    )
    if out is not None:
        from wordcraft_kg.reports.discovery_report import discovery_page

        if guide is not None and "recipe-learner" in selection:
            start = [played.id_of(label) for label in view.base]
            tried = explain_run(played, guide, attempts, seed, start)
            view = replace(view, tried=tried)
        write_file(out, discovery_page(view, plays, played), force=force)
        view = replace(view, out=str(out))
    output.result(view, _text(view))


def _about_world(view: "DiscoveryView") -> Iterator[str]:
    """Yield lines about a world's pairs, and about its main bottleneck."""
    world = view.statistics
    if world is None:
        return
    yield f"{world.pairs:,} pairs, {world.success_rate:.1%} of which make something"
    if view.attempts > world.pairs:
        yield f"note: more attempts than pairs; a run ends when all {world.reachable:,} are known"
    if not world.bottlenecks:
        return
    main = world.bottlenecks[0]
    yield f"main bottleneck: {quoted(main.entity)}, needed for {main.needed_by:,} other entities"
    learnt = []
    for name, (passage, *_) in view.passed.items():
        when = "" if passage.attempt is None else f" (attempt {passage.attempt:g})"
        learnt.append(f"{name} {passage.share:.0%}{when}")
    yield f"learnt in the runs of: {', '.join(learnt)}"


def _cell(known: "KnownEntities") -> str:
    """Return a mean with its interval, if there is one."""
    # A player without chance does the same in each run: there is nothing between the ends.
    if known.low is None or known.high is None or known.low >= known.high:
        return f"{known.mean:.1f}"
    return f"{known.mean:.1f} [{known.low:.1f}, {known.high:.1f}]"


def _published(view: "DiscoveryView") -> list["ReferenceRow"]:
    """Return the published results that can stand beside these runs."""
    shown = []
    for row in view.references:
        is_known = row.play is None and row.measure == "entities known"
        # Published results for fewer attempts are no comparison.
        if is_known and str(view.marks[-1]) in row.figures:
            shown.append(row)
    return shown


def _rows(view: "DiscoveryView", published: Sequence["ReferenceRow"]) -> list[tuple[str, ...]]:
    """Return the table: a row for each player, one for people, one for each published result."""
    marks = [str(mark) for mark in view.marks]
    rows: list[tuple[str, ...]] = [("entities known after", *marks, "repeated")]
    for name, known in view.players.items():
        cells = map(_cell, known.values())
        # Repetitions are counted over whole runs, so the last mark has them all.
        repeated = known[marks[-1]].repeated
        rows.append((name, *cells, f"{repeated:.1%}"))
    means = []
    for mark in marks:
        mean = view.people.get(mark)
        means.append("" if mean is None else f"{mean:g}")
    # People played with other entities, so their row is a rough guide and says so.
    rows.append(("people, another game", *means))
    for row in published:
        values = []
        for mark in marks:
            figure = row.figures.get(mark)
            values.append("" if figure is None else f"{figure.value:g}")
        rows.append((f"{row.player}, published", *values))
    return rows


def _text(view: "DiscoveryView") -> Iterator[str]:
    published = _published(view)
    reachable = f"{view.reachable:,} of {view.entities:,} entities reachable"
    yield f"{view.graph}: {reachable} from {', '.join(map(quoted, view.base))}"
    yield f"{view.runs:,} runs of {view.attempts:,} attempts: mean [95% interval]"
    yield from _about_world(view)
    yield ""
    yield from aligned(_rows(view, published))
    yield ""
    yield f"people: {view.people_source}"
    for reference, rows in groupby(published, key=attrgetter("reference")):
        yield f"{', '.join(row.player for row in rows)}: {reference}"
    if view.knows_recipes:
        seen = "it has seen these combinations"
        yield f"note: {view.scorer} was trained on recipes of {view.graph}: {seen}"
    if view.shared_recipes or view.contradicted:
        shared = counted(view.shared_recipes, "recipe")
        pairs = counted(view.contradicted, "pair")
        yield f"      {shared} of {view.graph} in its training, {pairs} with other results only"
    if view.out:
        yield f"wrote {view.out}"
