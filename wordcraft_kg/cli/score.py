"""``wordcraft-kg score``."""

import csv
import io
import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Model

if TYPE_CHECKING:
    from wordcraft_kg.base.records import Record
    from wordcraft_kg.evaluation.recipe_scores import ScoredRecipe, ScoredRecipeRow
    from wordcraft_kg.evaluation.scores import ScoredEntity, ScoredRow, ScoringModel
    from wordcraft_kg.graphs.folder import Taught
    from wordcraft_kg.models.scorers.queries import Query, RecipeQuery

EXAMPLES = (
    "wordcraft-kg score models/everyday flour combinesWith water",
    "wordcraft-kg score models/everyday _ componentOf bread --top 5 --new-only",
    "wordcraft-kg score models/everyday --in pairs.csv --out scores.csv",
    "wordcraft-kg score models/everyday-recipes flour + water",
    "wordcraft-kg score models/everyday-recipes _ + water = dough",
)


EXPLAINED = 3
"""Answers for which the recipes that speak for them are shown."""


def score(
    model: Model,
    head: str | None = None,
    relation: str | None = None,
    tail: str = "",
    *rest: str,
    top: int = 10,
    new_only: Flag = False,
    queries: Annotated[Path | None, Parameter(name="--in")] = None,
    out: Path | None = None,
    force: Flag = False,
    graph: str | None = None,
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
        force: replace that file if it exists.
        graph: where the graph is now, if it has moved since the training.
    """
    from wordcraft_kg.cli.failures import with_options
    from wordcraft_kg.evaluation.scores import AnyLabel, ScoringModel, with_new_words
    from wordcraft_kg.models.scorers.queries import Query, parse_query, read_queries

    whole("top", top, 1)
    words = [word for word in (head, relation) if word is not None] + [word for word in (tail, *rest) if word]
    is_recipe = any("+" in word for word in words)
    if (queries is None) != bool(words) or (queries is None and not is_recipe and (head is None or relation is None)):
        raise ConfigError(
            "score needs a head, a relation and perhaps a tail, or a recipe such as a + b, or a file of them with --in."
        )
    if queries is None and out is not None:
        raise ConfigError(f"--out {out}: only the scores of a file are written; give one with --in.")
    loaded = ScoringModel.open(model, graph, needs_graph=new_only)
    if loaded.split is None:
        logging.getLogger(__name__).warning("not shown which triples are known: %s", with_options(loaded.missing))
    entities = AnyLabel(loaded.scorer.entities)
    if queries is not None:
        asked = read_queries(queries, entities)
        _score_file(with_new_words(loaded, model, asked, queries), asked, top, new_only, out, force, output)
        return
    query = parse_query(words, frozenset(loaded.scorer.entities), entities)
    loaded = with_new_words(loaded, model, [query])
    if isinstance(query, Query):
        _score_query(loaded, query, top, new_only, output)
    else:
        _score_recipe(loaded, query, top, new_only, output)


def _score_query(model: "ScoringModel", query: "Query", top: int, new_only: bool, output: Output) -> None:
    from wordcraft_kg.evaluation.scores import note_of_words, view_open_slot, view_triple

    words = note_of_words(model)

    if query.is_open:
        slot = view_open_slot(model, query, top, new_only=new_only)
        lines = (_line(best, slot.head or best.entity, slot.relation, slot.tail or best.entity) for best in slot.top)
        output.result(slot, [*lines, *words, *_note(slot.trained_on, (best.known for best in slot.top))])
        return
    _refuse_new_only(new_only)
    triple = view_triple(model, query)
    text = [
        f"{triple.score:.4f}  {triple.head} {triple.relation} {triple.tail}"
        + (f"   known: {triple.known}" if triple.known else "")
        + (f"   probability {_chance(triple.probability)}" if triple.probability is not None else ""),
        f"rank among all {len(model.scorer.entities):,} entities, unfiltered: "
        f"tail {triple.rank_as_tail:,}, head {triple.rank_as_head:,}",
        *words,
        *_note(triple.trained_on, [triple.known]),
    ]
    output.result(triple, text)


def _score_recipe(model: "ScoringModel", query: "RecipeQuery", top: int, new_only: bool, output: Output) -> None:
    from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, view_open_recipe, view_recipe
    from wordcraft_kg.evaluation.scores import note_of_words

    scoring = RecipeScoring.of(model)
    if query.is_open:
        view = view_open_recipe(scoring, query, top, new_only=new_only)
        lines = [line for number, best in enumerate(view.top) for line in _recipe(best, explained=number < EXPLAINED)]
        output.result(view, [*lines, *note_of_words(model), *_recipe_notes(view.trained_on, view.top)])
        return
    _refuse_new_only(new_only)
    recipe = view_recipe(scoring, query)
    ranks = (
        f"rank among all {len(scoring.scorer.entities):,} entities, unfiltered: result {recipe.rank_as_result:,}, "
        f"{recipe.ingredient_a} {recipe.rank_as_ingredient_a:,}, {recipe.ingredient_b} {recipe.rank_as_ingredient_b:,}"
    )
    output.result(
        recipe,
        [*_recipe(recipe, explained=True), ranks, *note_of_words(model), *_recipe_notes(recipe.trained_on, [recipe])],
    )


def _refuse_new_only(new_only: bool) -> None:
    if new_only:
        raise ConfigError("--new-only chooses among several; leave a slot open or give a file with --in.")


def _score_file(
    model: "ScoringModel",
    queries: "list[Query] | list[RecipeQuery]",
    top: int,
    new_only: bool,
    out: Path | None,
    force: bool,
    output: Output,
) -> None:
    from wordcraft_kg.base.artefacts import staged_file, write_atomically
    from wordcraft_kg.evaluation import recipe_scores, scores
    from wordcraft_kg.evaluation.scores import note_of_words
    from wordcraft_kg.models.scorers.queries import RecipeQuery

    # A file holds queries of one kind.
    recipes = [query for query in queries if isinstance(query, RecipeQuery)]
    triples = [query for query in queries if not isinstance(query, RecipeQuery)]
    scoring = recipe_scores.RecipeScoring.of(model) if recipes else None

    def answered() -> tuple[list[Any], list[str], list[str]]:
        """Return the rows, their lines, and what must be said about them."""
        if scoring is None:
            rows = list(scores.score_queries(model, triples, top, new_only=new_only))
            lines = [_line(row, row.head, row.relation, row.tail) for row in rows]
            return rows, lines, _note(model.kg, (row.known for row in rows))
        found = list(recipe_scores.score_recipe_queries(scoring, recipes, top, new_only=new_only))
        return found, [_recipe_line(row) for row in found], _recipe_notes(model.kg, found)

    def view(rows: list[Any]) -> "Record":
        if scoring is None:
            return scores.view_file(model, triples, rows, out)
        return recipe_scores.view_recipe_file(scoring, recipes, rows, out)

    words = note_of_words(model)

    if out is None:
        rows, lines, notes = answered()
        output.result(view(rows), [*lines, *words, *notes])
        return
    with staged_file(out, force=force) as file:
        rows, _, notes = answered()
        kind = scores.ScoredRow if scoring is None else recipe_scores.ScoredRecipeRow
        delimiter = "\t" if out.suffix.lower() in (".tsv", ".tab") else ","
        write_atomically(file, _table(kind.__struct_fields__, rows, delimiter))
    output.result(view(rows), [*words, *notes, f"wrote {out}: {len(rows):,} scores of {len(queries):,} queries"])


def _line(found: "ScoredEntity | ScoredRow", head: str, relation: str, tail: str) -> str:
    known = f"{found.known:<5}  " if found.known else ""
    chance = "" if found.probability is None else f"   {_chance(found.probability)}"
    return f"{found.score:9.4f}  {known}{head} {relation} {tail}{chance}"


def _chance(probability: float) -> str:
    return "> 99 %" if probability > 0.99 else f"{100 * probability:.2g} %"


def _note(kg: "Taught | None", known: Iterable[str | None]) -> list[str]:
    """Return what must be said about a model that has seen some of the triples."""
    if kg == "full" and {"valid", "test"} & set(known):
        return ["The model was trained on the full graph: it has seen test triples too."]
    return []


def _recipe(recipe: "ScoredRecipe", *, explained: bool) -> Iterator[str]:
    from wordcraft_kg.evaluation.recipe_scores import because

    yield _recipe_line(recipe)
    if explained and recipe.because:
        yield f"{'':9}  because {because(recipe.because)}"


def _recipe_line(recipe: "ScoredRecipe | ScoredRecipeRow") -> str:
    score, known = f"{recipe.score:9.4f}  ", f"{recipe.known:<5}  " if recipe.known else ""
    memory = "   (memory)" if recipe.memory else ""
    share = getattr(recipe, "probability", None)
    chance = "" if share is None else f"   {_chance(share)}"
    return f"{score}{known}{recipe.ingredient_a} + {recipe.ingredient_b} -> {recipe.result}{chance}{memory}"


def _recipe_notes(kg: "Taught | None", recipes: "Sequence[ScoredRecipe | ScoredRecipeRow]") -> list[str]:
    """Return what must be said about recipes that a scorer remembers."""
    notes = _note(kg, (recipe.known for recipe in recipes))
    if any(recipe.memory for recipe in recipes):
        notes = ["(memory): the scorer was trained on this recipe, so its score is no prediction.", *notes]
    return notes


def _table(columns: Sequence[str], rows: "Iterable[Record]", delimiter: str) -> Iterator[str]:
    """Yield the lines of a file of scores; where a value is None, its cell is empty."""
    buffer = io.StringIO()
    if delimiter == "\t":  # labels hold no tab
        writer = csv.writer(buffer, delimiter=delimiter, lineterminator="\n", quoting=csv.QUOTE_NONE, quotechar=None)
    else:
        writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_cell(getattr(row, column)) for column in columns])
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
    yield buffer.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.9g}" if isinstance(value, float) else value
