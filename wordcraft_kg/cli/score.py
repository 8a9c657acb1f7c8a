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
    from wordcraft_kg.evaluation.scores import ScoringModel
    from wordcraft_kg.graphs.folder import TrainedOn
    from wordcraft_kg.models.scorers.queries import Query, RecipeQuery

EXAMPLES = (
    "wordcraft-kg score models/everyday flour combinesWith water",
    "wordcraft-kg score models/everyday _ componentOf bread --top 5 --new-only",
    "wordcraft-kg score models/everyday --in pairs.csv --out scores.csv",
    "wordcraft-kg score models/everyday-recipes flour + water",
    "wordcraft-kg score models/everyday-recipes _ + water = dough",
)
EXPLAINED = 3
"""Answers with their supporting recipes."""


def score(
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
    """Score a triple or a recipe, list the best entities for an open slot, or do so for each line of a file.

    Each triple, or recipe, is marked by the recipes that give it: train, valid, test, or new if no recipe of the book
    does. A model with folds says how probable those are that its training does not contain.

    With a model of train-recipes, a + b lists what a pair makes, a + b = c (or a + b c) scores a recipe, and _ + b = c
    lists the partners of b. It says which train recipes speak for an answer, and what it remembers from its training.
    It also scores entities that are not in the graph, by the words of their labels, and says so.

    Args:
        model: model folder.
        head: entity, or _ for an open slot. An entity called _ or ? takes precedence; then write the other one.
        relation: combinesWith or componentOf.
        tail: entity, or _ for an open slot, which is the default.
        rest: what else there is of a recipe such as a + b = c, which may also be one argument.
        top: number of entities to list for an open slot.
        new_only: leave out the triples, or recipes, that the book has already.
        queries: CSV or TSV file of head, relation and tail, or with the header ingredient_a,ingredient_b,result; a
            slot that is empty or _ is open.
        out: CSV or TSV file to write the scores of --in to. Default: show them.
    """
    from wordcraft_kg.cli.failures import with_options
    from wordcraft_kg.evaluation.scores import AnyLabel, ScoringModel, note_of_words, with_new_words
    from wordcraft_kg.models.scorers.queries import parse_query, read_queries

    whole("top", top, 1)
    words = [word for word in (head, relation) if word is not None] + [word for word in (tail, *rest) if word]
    _check_question(words, has_relation=relation is not None, file=queries, out=out)
    loaded = ScoringModel.open(model, graph, needs_graph=new_only)
    if loaded.split is None:
        logging.getLogger(__name__).warning("not shown which triples are known: %s", with_options(loaded.missing))
    entities = AnyLabel(loaded.scorer.entities)
    if queries is not None:
        asked = read_queries(queries, entities)
        loaded = with_new_words(loaded, model, asked, queries)
        _score_file(loaded, asked, top, new_only, out, force, output)
        return
    query = parse_query(words, frozenset(loaded.scorer.entities), entities)
    loaded = with_new_words(loaded, model, [query])
    view, found, lines = _score_query(loaded, query, top, new_only)
    output.result(view, [*lines, *note_of_words(loaded), *_notes(loaded.kg, found)])


def _check_question(words: list[str], *, has_relation: bool, file: Path | None, out: Path | None) -> None:
    is_question = has_relation or any("+" in word for word in words)
    if bool(words) == (file is not None) or (file is None and not is_question):
        raise ConfigError(
            "score needs a head, a relation and perhaps a tail, or a recipe such as a + b, or a file of them with --in."
        )
    if file is None and out is not None:
        raise ConfigError(f"--out {out}: only the scores of a file are written; give one with --in.")


def _score_query(
    model: "ScoringModel", query: "Query | RecipeQuery", top: int, new_only: bool
) -> "tuple[Record, Sequence[Any], list[str]]":
    """Return the answer to a query, its scored triples or recipes, and their lines."""
    from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, view_open_recipe, view_recipe
    from wordcraft_kg.evaluation.scores import view_open_slot, view_triple
    from wordcraft_kg.models.scorers.queries import RecipeQuery

    if query.is_open:
        if isinstance(query, RecipeQuery):
            recipes = view_open_recipe(RecipeScoring.of(model), query, top, new_only=new_only)
            return recipes, recipes.top, [*_lines(recipes.top)]
        slot = view_open_slot(model, query, top, new_only=new_only)
        triples = [f"{slot.head or best.entity} {slot.relation} {slot.tail or best.entity}" for best in slot.top]
        return slot, slot.top, [*_lines(slot.top, triples)]
    if new_only:
        raise ConfigError("--new-only chooses among several; leave a slot open or give a file with --in.")
    view: Any
    if isinstance(query, RecipeQuery):
        view = view_recipe(RecipeScoring.of(model), query)
        slots = {"result": "result", view.ingredient_a: "ingredient_a", view.ingredient_b: "ingredient_b"}
    else:
        view = view_triple(model, query)
        slots = {"tail": "tail", "head": "head"}
    shown = ", ".join(f"{name} {getattr(view, f'rank_as_{slot}'):,}" for name, slot in slots.items())
    ranking = f"rank among all {len(model.scorer.entities):,} entities, unfiltered: {shown}"
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
    """Score the queries of a file, all triples or all recipes, and show the scores or write them."""
    from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, ScoredRecipeRow, score_recipe_queries
    from wordcraft_kg.evaluation.scores import ScoredRow, note_of_words, score_queries, view_file
    from wordcraft_kg.models.scorers.queries import RecipeQuery

    check_file(out, force=force)
    kind: type[Any] = ScoredRow
    if isinstance(queries[0], RecipeQuery):
        kind = ScoredRecipeRow
        found: list[Any] = list(score_recipe_queries(RecipeScoring.of(model), queries, top, new_only=new_only))
    else:
        found = list(score_queries(model, queries, top, new_only=new_only))
    text = [*([] if out else _lines(found)), *note_of_words(model), *_notes(model.kg, found)]
    if out is not None:
        delimiter = "\t" if out.suffix.lower() in (".tsv", ".tab") else ","
        write_file(out, _table(kind.__struct_fields__, found, delimiter), force=force)
        text.append(f"wrote {out}: {len(found):,} scores of {len(queries):,} queries")
    output.result(view_file(model, queries, found, out), text)


def _lines(found: Sequence[Any], things: Sequence[str] | None = None) -> Iterator[str]:
    """Yield a line for each scored triple or recipe, and the support of the first recipes."""
    from wordcraft_kg.evaluation.recipe_scores import because

    rows = [
        (f"{one.score:9.4f}", one.known or "", thing, _chance(one), "(memory)" * getattr(one, "memory", False))
        for one, thing in zip(found, things or map(_thing, found), strict=True)
    ]
    for number, (line, one) in enumerate(zip(aligned(rows), found, strict=True)):
        yield line
        if number < EXPLAINED and (support := getattr(one, "because", ())):
            yield f"{'':9}  because {because(support)}"


def _thing(found: Any) -> str:
    if hasattr(found, "relation"):
        return f"{found.head} {found.relation} {found.tail}"
    return f"{found.ingredient_a} + {found.ingredient_b} -> {found.result}"


def _chance(found: Any) -> str:
    share = getattr(found, "probability", None)
    return "" if share is None else f"probability {'> 99' if share > 0.99 else format(100 * share, '.2g')} %"


def _notes(kg: "TrainedOn | None", found: Sequence[Any]) -> Iterator[str]:
    """Yield the notes on triples or recipes that the model has seen in training."""
    if any(getattr(one, "memory", False) for one in found):
        yield "(memory): the scorer was trained on this recipe, so its score is no prediction."
    if kg == "full" and {"valid", "test"} & {one.known for one in found}:
        yield "The model was trained on the full graph: it has seen test triples too."


def _table(columns: Sequence[str], rows: Sequence[Any], delimiter: str) -> str:
    """Return the text of a file of scores; where a value is None, its cell is empty."""
    import pandas as pd

    frame: Any = pd.DataFrame([[getattr(row, column) for column in columns] for row in rows], columns=list(columns))
    if "memory" in frame:
        frame["memory"] = frame["memory"].astype(str).str.lower()
    quoting = csv.QUOTE_NONE if delimiter == "\t" else csv.QUOTE_MINIMAL  # labels hold no tab
    text: str = frame.to_csv(sep=delimiter, index=False, float_format="%.9g", lineterminator="\n", quoting=quoting)
    return text
