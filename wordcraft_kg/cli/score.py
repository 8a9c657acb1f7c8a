"""``wordcraft-kg score``."""

import csv
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Flag, Output, aligned, check_file, write_file
from wordcraft_kg.cli.options import Force, MovedGraph

if TYPE_CHECKING:
    from wordcraft_kg.base.records import Record
    from wordcraft_kg.evaluation.queries import Query, RecipeQuery
    from wordcraft_kg.evaluation.scores import ScoringModel
    from wordcraft_kg.graphs.folder import TrainedOn

EXAMPLES = (
    "wordcraft-kg score models/everyday flour combinesWith water",
    "wordcraft-kg score models/everyday _ componentOf bread --top 5 --new-only",
    "wordcraft-kg score models/everyday --in pairs.csv --out scores.csv",
    "wordcraft-kg score models/everyday-recipes flour + water",
    "wordcraft-kg score models/everyday-recipes _ + water = dough",
)
EXPLAINED = 3
"""Number of answers that are shown with evidence."""


def score(  # noqa: PLR0913 - parameters are the command's options
    model: Path,
    head: str | None = None,
    relation: str | None = None,
    tail: str = "",
    *rest: str,
    top: int = 10,
    new_only: Flag = False,
    queries: Annotated[Path | None, Parameter(name="--in")] = None,
    out: Path | None = None,
    force: Force = False,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Score a triple or a recipe, rank entities for an open slot, or score all queries in a file.

    The output marks each triple or recipe as train, valid, test, or new (not in the book). Models
    with folds also give probabilities for triples outside the training data.

    With a train-recipes model, a + b ranks the results, a + b = c (or a + b c) scores a recipe, and
    _ + b = c ranks partners. Answers come with supporting train recipes and a note if in-sample.
    Entities outside the graph are scored by the words in their labels, with a note.

    Args:
        model: model folder.
        head: entity, or _ for an open slot. If an entity is called _ (or ?), write ? (or _) for the
            open slot.
        relation: combinesWith or componentOf.
        tail: entity, or _ for an open slot (default).
        rest: further words of a recipe such as a + b = c; quote labels with blanks or signs, and 'a
            + b -> c'.
        top: entities to list for an open slot.
        new_only: leave out known triples or recipes.
        queries: CSV or TSV file with head, relation and tail, or with the header
            ingredient_a,ingredient_b,result; an empty cell or _ is an open slot.
        out: CSV or TSV file for the scores of --in. Default: print the scores.
    """
    from wordcraft_kg.cli.failures import with_options
    from wordcraft_kg.evaluation.queries import parse_query, read_queries
    from wordcraft_kg.evaluation.scores import ScoringModel, note_of_words, with_new_words

    whole("top", top, 1)
    words = [word for word in (head, relation) if word is not None] + [
        word for word in (tail, *rest) if word
    ]
    _check_query(words, has_relation=relation is not None, file=queries, out=out)
    loaded = ScoringModel.open(model, graph, needs_graph=new_only)
    if loaded.split is None:
        logging.getLogger(__name__).warning(
            "not shown which triples are known: %s", with_options(loaded.missing)
        )
    entities = frozenset(loaded.scorer.entities)
    if queries is not None:
        file_queries = read_queries(queries, entities)
        loaded = with_new_words(loaded, model, file_queries, queries)
        _score_file(loaded, file_queries, top, new_only, out, force, output)
        return
    query = parse_query(words, entities)
    loaded = with_new_words(loaded, model, [query])
    view, scored, lines = _score_query(loaded, query, top, new_only)
    output.result(view, [*lines, *note_of_words(loaded), *_notes(loaded.kg, scored)])


def _check_query(
    words: list[str], *, has_relation: bool, file: Path | None, out: Path | None
) -> None:
    is_query = has_relation or any("+" in word for word in words)
    has_file = file is not None
    # Either words or a file, and words alone must be a whole query.
    if bool(words) == has_file or not (has_file or is_query):
        raise ConfigError(
            "score needs a head, a relation and optionally a tail; a recipe such as a + b; or a "
            "query file with --in."
        )
    if file is None and out is not None:
        raise ConfigError(
            f"--out {out}: only the scores for a file are written; add a query file with --in."
        )


def _score_query(
    model: "ScoringModel", query: "Query | RecipeQuery", top: int, new_only: bool
) -> "tuple[Record, Sequence[Any], list[str]]":
    from wordcraft_kg.evaluation.queries import RecipeQuery
    from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, view_open_recipe, view_recipe
    from wordcraft_kg.evaluation.scores import view_open_slot, view_triple

    if query.is_open:
        if isinstance(query, RecipeQuery):
            recipes = view_open_recipe(RecipeScoring.of(model), query, top, new_only=new_only)
            return recipes, recipes.top, [*_lines(recipes.top)]
        slot = view_open_slot(model, query, top, new_only=new_only)
        triples = [
            f"{slot.head or best.entity} {slot.relation} {slot.tail or best.entity}"
            for best in slot.top
        ]
        return slot, slot.top, [*_lines(slot.top, triples)]
    if new_only:
        raise ConfigError(
            "--new-only filters a ranking; leave a slot open, or give a query file with --in."
        )
    view: Any
    if isinstance(query, RecipeQuery):
        view = view_recipe(RecipeScoring.of(model), query)
        slots = {
            "result": "result",
            view.ingredient_a: "ingredient_a",
            view.ingredient_b: "ingredient_b",
        }
    else:
        view = view_triple(model, query)
        slots = {"tail": "tail", "head": "head"}
    # A dictionary by what is printed: for a + a, both ingredients are one slot.
    ranks = []
    for name, role in slots.items():
        rank = getattr(view, f"rank_as_{role}")
        ranks.append(f"{name} {rank:,}")
    entities = f"{len(model.scorer.entities):,} entities"
    ranking = f"rank among all {entities}, unfiltered: {', '.join(ranks)}"
    return view, [view], [*_lines([view]), ranking]


def _score_file(
    model: "ScoringModel",
    queries: Any,
    top: int,
    new_only: bool,
    out: Path | None,
    force: bool,
    output: Output,
) -> None:
    from wordcraft_kg.evaluation.queries import RecipeQuery
    from wordcraft_kg.evaluation.recipe_scores import (
        RecipeScoring,
        ScoredRecipeRow,
        score_recipe_queries,
    )
    from wordcraft_kg.evaluation.scores import ScoredRow, note_of_words, score_queries, view_file

    check_file(out, force=force)
    kind: type[Any] = ScoredRow
    if isinstance(queries[0], RecipeQuery):
        kind = ScoredRecipeRow
        scored: list[Any] = list(
            score_recipe_queries(RecipeScoring.of(model), queries, top, new_only=new_only)
        )
    else:
        scored = list(score_queries(model, queries, top, new_only=new_only))
    # Scores that go into a file are not printed as well; what qualifies them always is.
    text = [] if out else list(_lines(scored))
    text += note_of_words(model)
    text += _notes(model.kg, scored)
    if out is not None:
        delimiter = "\t" if out.suffix.lower() in (".tsv", ".tab") else ","
        write_file(out, _table(kind.__struct_fields__, scored, delimiter), force=force)
        text.append(f"wrote {out}: {len(scored):,} scores for {len(queries):,} queries")
    output.result(view_file(model, queries, scored, out), text)


def _lines(scored: Sequence[Any], things: Sequence[str] | None = None) -> Iterator[str]:
    from wordcraft_kg.evaluation.recipe_scores import because

    if not scored:
        yield "no answer: nothing is left to propose"
        return
    rows = []
    for row_record, thing in zip(scored, things or map(_thing, scored), strict=True):
        note = "(in-sample)" if getattr(row_record, "in_sample", False) else ""
        rows.append(
            (f"{row_record.score:9.4f}", row_record.known or "", thing, _chance(row_record), note)
        )
    is_recipe = hasattr(scored[0], "in_sample")
    names = (
        f"{'nats' if is_recipe else 'score':>9}",
        "part",
        "recipe" if is_recipe else "triple",
        "probability",
        "",
    )
    # A column in which no row has anything has no heading either.
    headings = []
    for place, name in enumerate(names):
        is_filled = any(row[place] for row in rows)
        headings.append(name if is_filled else "")
    heading, *lines = aligned([headings, *rows])
    yield heading
    for number, (line, row_record) in enumerate(zip(lines, scored, strict=True)):
        yield line
        # Only recipes have these fields, and only the best rows are explained.
        if number < EXPLAINED:
            support = getattr(row_record, "because", ())
            if support:
                yield f"{'':9}  because {because(support)}"
            for piece in getattr(row_record, "outside", ()):
                yield f"{'':9}  {piece}"


def _thing(row: Any) -> str:
    if hasattr(row, "relation"):
        return f"{row.head} {row.relation} {row.tail}"
    return f"{row.ingredient_a} + {row.ingredient_b} -> {row.result}"


def _chance(row: Any) -> str:
    share = getattr(row, "probability", None)
    if share is None:
        return ""
    if share > 0.99:
        return "> 99 %"
    if share < 0.001:
        return "< 0.1 %"
    return f"{100 * share:.2g} %"


def _notes(kg: "TrainedOn | None", scored: Sequence[Any]) -> Iterator[str]:
    from wordcraft_kg.evaluation.recipe_scores import BECAUSE

    if any(getattr(row, "because", ()) for row in scored):
        yield f"because: {BECAUSE}."
    if any(getattr(row, "outside", ()) for row in scored):
        yield (
            "Lines with the name of a source: knowledge from outside the train recipes; in "
            "brackets a table's value."
        )
    if any(getattr(row, "in_sample", False) for row in scored):
        yield (
            "(in-sample): the scorer was trained on this recipe, so the score is not a prediction."
        )
    if kg == "full" and {"valid", "test"} & {row.known for row in scored}:
        yield "The model was trained on the full graph, test triples included."


def _table(columns: Sequence[str], rows: Sequence[Any], delimiter: str) -> str:
    import pandas as pd

    values = {}
    for column in columns:
        values[column] = [getattr(row, column) for row in rows]
    frame: Any = pd.DataFrame(values)
    if "in_sample" in frame:
        # As in JSON, and as readers in other languages expect.
        frame["in_sample"] = frame["in_sample"].astype(str).str.lower()
    # Labels hold no tab, so that tables with tabs need no quotes.
    quoting = csv.QUOTE_NONE if delimiter == "\t" else csv.QUOTE_MINIMAL
    text: str = frame.to_csv(
        sep=delimiter, index=False, float_format="%.9g", lineterminator="\n", quoting=quoting
    )
    return text
