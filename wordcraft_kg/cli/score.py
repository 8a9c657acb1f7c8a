"""``wordcraft-kg score``."""

import csv
import io
import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.completion import Model
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.errors import ConfigError
from wordcraft_kg.settings import whole

if TYPE_CHECKING:
    from wordcraft_kg.graphs.folder import KG
    from wordcraft_kg.models.scorers.queries import Query
    from wordcraft_kg.views.scores import ScoredRow, ScoringModel

EXAMPLES = (
    "wordcraft-kg score models/everyday flour combinesWith water",
    "wordcraft-kg score models/everyday _ componentOf bread --top 5 --new-only",
    "wordcraft-kg score models/everyday --in pairs.csv --out scores.csv",
)


def score(
    model: Model,
    head: str | None = None,
    relation: str | None = None,
    tail: str = "",
    *,
    top: int = 10,
    new_only: Flag = False,
    queries: Annotated[Path | None, Parameter(name="--in")] = None,
    out: Path | None = None,
    force: Flag = False,
    graph: str | None = None,
    output: Output = Output(),
) -> None:
    """Score a triple, list the best entities for an open slot, or do so for each line of a file.

    Each triple is marked by the recipes that give it: train, valid, test, or new if no recipe of the book does.

    Args:
        model: model folder.
        head: entity, or _ for an open slot. An entity called _ or ? takes precedence; then write the other one.
        relation: combinesWith or componentOf.
        tail: entity, or _ for an open slot, which is the default.
        top: number of entities to list for an open slot.
        new_only: leave out the triples that the book has already.
        queries: CSV or TSV file of head, relation and tail; a slot that is empty or _ is open.
        out: CSV or TSV file to write the scores of --in to. Default: show them.
        force: replace that file if it exists.
        graph: where the graph is now, if it has moved since the training.
    """
    from wordcraft_kg.cli.failures import with_options
    from wordcraft_kg.models.scorers.queries import Query, read_queries
    from wordcraft_kg.views.scores import ScoringModel

    whole("top", top, 1)
    if (queries is None) == (head is None or relation is None):
        raise ConfigError("score needs a head, a relation and perhaps a tail, or a file of them with --in.")
    if queries is None and out is not None:
        raise ConfigError(f"--out {out}: only the scores of a file are written; give one with --in.")
    loaded = ScoringModel.open(model, graph, needs_graph=new_only)
    if loaded.split is None:
        logging.getLogger(__name__).warning("not shown which triples are known: %s", with_options(loaded.missing))
    entities = frozenset(loaded.scorer.entities)
    if queries is not None:
        _score_file(loaded, read_queries(queries, entities), top, new_only, out, force, output)
        return
    assert head is not None
    assert relation is not None
    _score_query(loaded, Query.of(head, relation, tail, entities), top, new_only, output)


def _score_query(model: "ScoringModel", query: "Query", top: int, new_only: bool, output: Output) -> None:
    from wordcraft_kg.views.scores import view_open_slot, view_triple

    if query.is_open:
        slot = view_open_slot(model, query, top, new_only=new_only)
        lines = (
            _line(best.score, best.known, slot.head or best.entity, slot.relation, slot.tail or best.entity)
            for best in slot.top
        )
        output.result(slot, [*lines, *_note(slot.trained_on, (best.known for best in slot.top))])
        return
    if new_only:
        raise ConfigError("--new-only chooses among several triples; leave a slot open or give a file with --in.")
    triple = view_triple(model, query)
    text = [
        f"{triple.score:.4f}  {triple.head} {triple.relation} {triple.tail}"
        + (f"   known: {triple.known}" if triple.known else ""),
        f"rank among all {len(model.scorer.entities):,} entities, unfiltered: "
        f"tail {triple.rank_as_tail:,}, head {triple.rank_as_head:,}",
        *_note(triple.trained_on, [triple.known]),
    ]
    output.result(triple, text)


def _score_file(
    model: "ScoringModel",
    queries: "Sequence[Query]",
    top: int,
    new_only: bool,
    out: Path | None,
    force: bool,
    output: Output,
) -> None:
    from wordcraft_kg.artefacts import staged_file, write_atomically
    from wordcraft_kg.views.scores import score_queries, view_file

    if out is None:
        rows = list(score_queries(model, queries, top, new_only=new_only))
        lines = (_line(row.score, row.known, row.head, row.relation, row.tail) for row in rows)
        output.result(view_file(model, queries, rows), [*lines, *_note(model.kg, (row.known for row in rows))])
        return
    with staged_file(out, force=force) as file:
        rows = list(score_queries(model, queries, top, new_only=new_only))
        write_atomically(file, _table(rows, "\t" if out.suffix.lower() in (".tsv", ".tab") else ","))
    note = _note(model.kg, (row.known for row in rows))
    output.result(
        view_file(model, queries, rows, out),
        [*note, f"wrote {out}: {len(rows):,} scores of {len(queries):,} queries"],
    )


def _line(score: float, known: str | None, head: str, relation: str, tail: str) -> str:
    return f"{score:9.4f}  " + (f"{known:<5}  " if known else "") + f"{head} {relation} {tail}"


def _note(kg: "KG | None", known: Iterable[str | None]) -> list[str]:
    """Return what must be said about a model that has seen some of the triples."""
    if kg == "full" and {"valid", "test"} & set(known):
        return ["The model was trained on the full graph: it has seen test triples too."]
    return []


def _table(rows: "Sequence[ScoredRow]", delimiter: str) -> Iterator[str]:
    """Yield the lines of a file of scores; where a value is None, its cell is empty."""
    buffer = io.StringIO()
    if delimiter == "\t":  # labels hold no tab
        writer = csv.writer(buffer, delimiter=delimiter, lineterminator="\n", quoting=csv.QUOTE_NONE, quotechar=None)
    else:
        writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["line", "head", "relation", "tail", "score", "rank", "known"])
    for row in rows:
        writer.writerow([row.line, row.head, row.relation, row.tail, f"{row.score:.9g}", row.rank, row.known])
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
    yield buffer.getvalue()
