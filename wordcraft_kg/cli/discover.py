"""``wordcraft-kg discover``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import counted, quoted
from wordcraft_kg.cli.console import Output, aligned, split_labels
from wordcraft_kg.cli.options import Graph, OptionalBook, Words

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.discovery import DiscoveryView, KnownEntities

EXAMPLES = (
    "wordcraft-kg discover everyday --players random,greedy --runs 20",
    "wordcraft-kg discover everyday --scorer models/everyday-recipes",
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
    """
    from wordcraft_kg.agents.discovery import DISCOVERERS, GUIDED
    from wordcraft_kg.evaluation.discovery import open_guide, view_discovery
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
    view = view_discovery(
        played,
        selection,
        attempts=attempts,
        runs=runs,
        seed=seed,
        base=labels,
        scorer=guide,
        book=votes,
    )
    output.result(view, _text(view))


def _cell(known: "KnownEntities") -> str:
    """Return a mean with its interval, if there is one."""
    # A player without chance does the same in each run: there is nothing between the ends.
    if known.low is None or known.high is None or known.low >= known.high:
        return f"{known.mean:.1f}"
    return f"{known.mean:.1f} [{known.low:.1f}, {known.high:.1f}]"


def _rows(view: "DiscoveryView") -> list[tuple[str, ...]]:
    """Return the table: a row for each player, and one for people."""
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
    return rows


def _text(view: "DiscoveryView") -> Iterator[str]:
    reachable = f"{view.reachable:,} of {view.entities:,} entities reachable"
    yield f"{view.graph}: {reachable} from {', '.join(map(quoted, view.base))}"
    yield f"{view.runs:,} runs of {view.attempts:,} attempts: mean [95% interval]"
    # Unordered pairs, an entity with itself included.
    if view.attempts > view.reachable * (view.reachable + 1) // 2:
        yield f"note: more attempts than pairs; a run ends when all {view.reachable:,} are known"
    yield ""
    yield from aligned(_rows(view))
    yield ""
    yield f"people: {view.people_source}"
    if view.knows_recipes:
        seen = "it has seen these combinations"
        yield f"note: {view.scorer} was trained on recipes of {view.graph}: {seen}"
    if view.shared_recipes or view.contradicted:
        shared = counted(view.shared_recipes, "recipe")
        pairs = counted(view.contradicted, "pair")
        yield f"      {shared} of {view.graph} in its training, {pairs} with other results only"
