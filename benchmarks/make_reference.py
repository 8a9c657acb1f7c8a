"""Measure the scripted players of a file of published results again, and write the file.

    python benchmarks/make_reference.py everyday
    python benchmarks/make_reference.py everyday --check

They play test tasks of depth 1 with 1, 2 and 8 distractors, of depth 2 with 1 and 8, and in open-ended
mode. Rows of scorers and agents stay: their reference is the command that measured them. ``--check``
writes nothing; the exit code is 1 if a figure differs from the file.
"""

import argparse
import json
import platform
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version

from wordcraft_kg.agents.discovery import MARKS
from wordcraft_kg.agents.players import FEWEST_USES, is_words_player
from wordcraft_kg.base.errors import TaskError
from wordcraft_kg.base.records import as_values, read_record
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.discovery import view_discovery
from wordcraft_kg.evaluation.players import view_baselines
from wordcraft_kg.evaluation.reference import (
    PACK,
    MeasuredValue,
    OpenPlay,
    PlayedGraph,
    ReferencePack,
    ReferenceRow,
    TaskPlay,
)
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph

PLAYS = ((TaskPlay("test", 1, 1), (1, 2, 8)), (TaskPlay("test", 2, 2), (1, 8)))
BASES = (None, ("air", "earth", "fire", "water"))
"""The graph's own, and that of people who play Little Alchemy 2."""
RUNS = 100
CHANCE = ("random", "random, distinct", "random-no-repeat", FEWEST_USES)
ORACLES = ("recipe oracle", "greedy", "empowerment")
"""Players that know all recipes, those of the test tasks too."""
OPEN_PLAYERS = ("random", "random-no-repeat", "greedy", "empowerment")
ORDER = ("chance", "words", "knowledge graph", "scorer", "oracle", "agent")
PACKAGES = ("wordcraft-kg", "torch", "numpy")


def main() -> None:
    """Measure, and write or compare a file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", help="graph folder, recipe book or known book's name")
    parser.add_argument("--check", action="store_true", help="compare players with the file")
    chosen = parser.parse_args()
    opened = open_graph(chosen.graph)
    path = PACK / f"{opened.graph.name}.json"
    before = read_record(path, ReferencePack).rows if path.exists() else ()
    scripted = [*scripted_rows(opened)]
    trained = [row for row in before if row.kind in ("scorer", "agent")]
    rows = tuple(sorted([*scripted, *trained], key=lambda row: ORDER.index(row.kind)))
    if chosen.check:
        wrong = [row.player for row in (*rows, *before) if (row in rows) != (row in before)]
        sys.exit(f"not as in the file: {', '.join(dict.fromkeys(wrong))}" if wrong else 0)
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    pack = ReferencePack(
        format="wordcraft-kg references 1",
        title=opened.graph.name,
        graph=PlayedGraph.of(opened),
        versions=versions,
        rows=rows,
    )
    values = as_values(pack)
    # A line for each row, for readable diffs.
    lines = ",\n".join(json.dumps(row, ensure_ascii=False) for row in values.pop("rows"))
    head = json.dumps(values, ensure_ascii=False)[:-1]
    path.write_text(f'{head}, "rows": [\n{lines}\n]}}\n', encoding="utf-8")


def scripted_rows(opened: OpenedGraph) -> Iterator[ReferenceRow]:
    """Yield the rows of scripted players: crafting tasks, then open-ended play."""
    for play, columns in PLAYS:
        try:
            yield from task_rows(opened, play, columns)
        except TaskError as error:
            print(error, file=sys.stderr)
    bases = (opened.graph.labels(Discovery(opened.graph, base).base) for base in BASES)
    for base in dict.fromkeys(bases):
        yield from open_rows(opened, OpenPlay(base))


def task_rows(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> Iterator[ReferenceRow]:
    """Yield a row for each scripted player on crafting tasks."""
    config = WordCraftConfig(part=play.part, depth=play.depth, max_attempts=play.attempts)
    view = view_baselines(opened, opened.graph.name, config, columns)
    listed = ",".join(map(str, columns))
    options = f"--part {play.part} --depth {play.depth} --distractors {listed}"
    figures: dict[str, dict[str, MeasuredValue]] = {}
    for row in view.rows:
        # Rows of a group of goals have no place in a table with one result for each count.
        if not row.goals:
            of_player = figures.setdefault(row.player, {})
            of_player[str(row.distractors)] = rounded(row.success, row.low, row.high, row.by_plan)
    for player, of_player in figures.items():
        yield ReferenceRow(
            player=player,
            kind=kind_of(player),
            measure="success",
            figures=of_player,
            reference=f"wordcraft-kg evaluate-agent {opened.graph.name} {options}",
            play=play,
            interval=view.intervals,
            remark="knows the recipes of the test tasks" if player.startswith("full KG") else "",
        )


def open_rows(opened: OpenedGraph, play: OpenPlay) -> Iterator[ReferenceRow]:
    """Yield a row for each player in open-ended play."""
    view, _ = view_discovery(
        opened.graph, OPEN_PLAYERS, attempts=MARKS[-1], runs=RUNS, base=play.base
    )
    for player, known in view.players.items():
        figures = {mark: rounded(at.mean, at.low, at.high) for mark, at in known.items()}
        yield ReferenceRow(
            player=player,
            kind=kind_of(player),
            measure="entities known",
            figures=figures,
            reference=f"wordcraft-kg discover {opened.graph.name} --base '{','.join(play.base)}'",
            play=play,
            interval="95 %, over runs",
            remark="knows the graph" if player in ORACLES else "",
        )


def rounded(
    value: float, low: float | None, high: float | None, by_plan: float | None = None
) -> MeasuredValue:
    """Return a value with six digits."""
    return MeasuredValue(
        *(None if number is None else round(number, 6) for number in (value, low, high, by_plan))
    )


def kind_of(player: str) -> str:
    """Return the kind of a scripted player."""
    if is_words_player(player):
        return "words"
    if player in CHANCE:
        return "chance"
    return "oracle" if player in ORACLES else "knowledge graph"


if __name__ == "__main__":
    main()
