"""``wordcraft-kg discover``."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.errors import ConfigError, OutputExistsError

EXAMPLES = (
    "wordcraft-kg discover everyday --players random,greedy --runs 20",
    "wordcraft-kg discover everyday --scorer models/everyday --out discovery.html",
)
List = Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)]


def discover(
    graph: str = "everyday",
    *,
    attempts: int = 100,
    runs: int = 100,
    players: List = None,
    scorer: Path | None = None,
    base: List = None,
    seed: int = 0,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Let players discover entities from the base in open-ended play, and set them beside people.

    Args:
        graph: graph folder, recipe book or known book's name.
        attempts: combinations that a player may try.
        runs: times that each player plays.
        players: comma-separated: random, random-no-repeat, greedy and empowerment (these two know the graph),
            empowerment-scorer (guided by --scorer). Default: all, the last one where there is a scorer.
        scorer: model folder, written by train-complex or train-links on this graph.
        base: comma-separated entities known at the start. Default: the graph's base; people begin with air, earth,
            fire and water.
        seed: root of all draws.
        out: HTML page to write, with the curves.
        force: replace the page if there is one.
    """
    if out is not None and out.exists() and not force:
        raise OutputExistsError(f"'{out}' exists. Choose another --out, or replace it with --force.")
    from wordcraft_kg.agents.discovery import (
        HUMAN_CURVE,
        HUMAN_SOURCE,
        PLAYERS,
        discovery_curves,
        make_players,
        summarise_curves,
    )
    from wordcraft_kg.envs.open_ended import Discovery
    from wordcraft_kg.graphs.folder import open_graph

    of = open_graph(graph).graph
    names = list(dict.fromkeys(split_labels(players))) if players else list(PLAYERS)[: None if scorer else -1]
    if not names:
        raise ConfigError(f"--players names nobody; there are {', '.join(PLAYERS)}.")
    loaded = None
    if scorer is not None:
        from wordcraft_kg.models.scorers.folder import load_scorer

        loaded = load_scorer(scorer, graph=of)
    start = Discovery(of, split_labels(base) if base else None)
    curves = discovery_curves(of, make_players(names, of, loaded), attempts, runs, seed, start.base)
    table = summarise_curves(curves)
    values: dict[str, Any] = {
        "graph": of.name,
        "hash": of.hash,
        "entities": of.num_entities,
        "base": list(of.labels(start.base)),
        "reachable": start.reachable,
        "attempts": attempts,
        "runs": runs,
        "seed": seed,
        "scorer": None if scorer is None else scorer.name,
        "marks": table["attempt"].unique().tolist(),
        "players": {name: _figures(table[table["player"] == name]) for name in names},
        "people": {str(attempt): known for attempt, known in HUMAN_CURVE.items()},
        "people_source": HUMAN_SOURCE,
    }
    if out is not None:
        from wordcraft_kg.artefacts import staged_file, write_atomically
        from wordcraft_kg.reports.discovery_report import discovery_page

        with staged_file(out, force=force) as file:
            write_atomically(file, discovery_page(values, curves))
        values["out"] = str(out)
    output.result(values, _text(values))


def _figures(table: Any) -> dict[str, dict[str, float | None]]:
    """Return what a player knows, by the number of attempts; None for the interval of a single run."""
    return {
        str(row["attempt"]): {
            name: None if row[name] != row[name] else float(row[name]) for name in ("mean", "low", "high", "repeated")
        }
        for row in table.to_dict("records")
    }


def _text(values: dict[str, Any]) -> list[str]:
    marks = [str(mark) for mark in values["marks"]]

    def cell(figures: dict[str, Any]) -> str:
        low, high = figures["low"], figures["high"]
        return f"{figures['mean']:.1f}" + (f" [{low:.1f}, {high:.1f}]" if low is not None and low < high else "")

    rows = [["entities known after", *marks, "repeated"]]
    rows += [
        [name, *(cell(figures[mark]) for mark in marks), f"{figures[marks[-1]]['repeated']:.1%}"]
        for name, figures in values["players"].items()
    ]
    people = values["people"]
    rows.append(["people, another game", *(f"{people[mark]:g}" if mark in people else "" for mark in marks), ""])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    text = [
        f"{values['graph']}: {values['reachable']:,} of {values['entities']:,} entities reachable from "
        f"{', '.join(values['base'])}",
        f"{values['runs']:,} runs of {values['attempts']:,} attempts: mean [95% interval]",
        "",
        *("  ".join(f"{part:<{width}}" for part, width in zip(row, widths, strict=True)).rstrip() for row in rows),
        "",
        f"people: {values['people_source']}",
    ]
    return text + ([f"wrote {values['out']}"] if "out" in values else [])
