"""Suggested recipes that a book lacks, and scores of whole sets, each with supporting recipes.

:func:`suggest` answers a :class:`Wish`: for the whole book, with an item, for a goal, of a pair, or
of a list of entities. :mod:`~wordcraft_kg.evaluation.likely_recipes` finds recipes of pairs; models
of sets rank the sets of each goal.

:func:`table_lines` writes them as a table that a person ticks, :func:`write_accepted` a book with
the ticked recipes. The table is a recipe file, so every command that takes a book reads it
without options.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np

from wordcraft_kg.base import (
    ConfigError,
    Count,
    OutputExistsError,
    RecipeFileError,
    Record,
    Share,
    check_output_file,
    nearest,
)
from wordcraft_kg.evaluation.likely_recipes import LikelyRecipes, RecipeFinder
from wordcraft_kg.evaluation.scores import KNOWN, OPEN, Known, pieces_of_recipe
from wordcraft_kg.graphs import (
    MOST_INGREDIENTS,
    Ids,
    Recipe,
    RecipeBook,
    RecipeGraph,
    Split,
    TrainedOn,
    label_fault,
    layers,
    write_book,
)
from wordcraft_kg.graphs.book_check import BookCheck, check_book
from wordcraft_kg.graphs.book_files.reader import SELF_RESULT
from wordcraft_kg.graphs.book_files.rows import Place
from wordcraft_kg.graphs.book_files.words import own_header
from wordcraft_kg.graphs.book_files.writing import csv_line
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.recipes.recipe_records import SetMetrics
from wordcraft_kg.models.recipes.set_training import with_new_entities
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.knowledge import NO_INGREDIENT
from wordcraft_kg.models.scorers.sets.rules import Rule
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

_SUPPORT = 3
"""Most supporting recipes of a suggestion."""
PAGE = 20
"""Suggestions that a reader takes in at once."""
MOST_OF_ITEM = 3
"""Most suggestions of a page with one item that the reader did not name: with more, a page is a
single finding with many faces, and three show that it is no slip."""
MOST_GOALS = 2_000
"""Most goals whose sets a model of sets ranks at once; each takes milliseconds."""
_SETS = 20
"""Sets of each of these goals that are looked at."""


class Suggestion(Record):
    """A suggested or known recipe.

    Attributes:
        recipe: the recipe, by labels.
        probability: of pairs, that the pair makes the result; of sets, that a recipe of the result
            has exactly these ingredients. Calibrated on train recipes that the model had not seen;
            1 for a known recipe.
        known: split part with the recipe, or ``new``.
        because: train recipes of similar goals, or with similar ingredients, each with its strength
            relative to the strongest, which has 1.
        steps: attempts in a row until the result is there, from a list of entities; None elsewhere.
    """

    recipe: Recipe
    probability: Share
    known: Known
    because: tuple[tuple[Recipe, Share], ...]
    steps: Count | None = None


class Wish(Record):
    """The recipes that a user wants; without any name those of the whole book.

    Attributes:
        goal: label of the result; None for any.
        item: label of an ingredient; None for any.
        pair: labels of both ingredients; empty for any.
        table: labels of the entities to begin with; empty for any.
    """

    goal: str | None = None
    item: str | None = None
    pair: tuple[str, ...] = ()
    table: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the wish itself.

        Raises:
            ConfigError: if several wishes are named, or a pair has not two ingredients.
        """
        wishes = [name for name in self.__struct_fields__ if getattr(self, name) not in (None, ())]
        if len(wishes) > 1:
            raise ConfigError(
                f"{' and '.join(wishes)} together; expected one of a pair, an item, a goal and a "
                "list of entities. Leave the others out."
            )
        if self.pair and len(self.pair) != 2:
            raise ConfigError(
                f"'{' + '.join(self.pair)}' is no pair; expected two ingredients, such as ham + "
                "cheese. For recipes with one item use `with_item`."
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """All named entities."""
        single = (label for label in (self.goal, self.item) if label is not None)
        return (*single, *self.pair, *self.table)

    def takes(self, ingredients: Sequence[str], steps: int | None) -> bool:
        """Return whether a recipe of any goal is wanted; without steps, entities do not make it."""
        has_pair = not Counter(self.pair) - Counter(ingredients)
        has_item = self.item is None or self.item in ingredients
        return has_pair and has_item and not (self.table and steps is None)


class Suggestions(Record):
    """Suggested recipes.

    Attributes:
        wish: the wanted recipes.
        new: entities of the wish that the graph lacks, known by their parts and words.
        suggestions: recipes, best first.
        trained_on: training graph of the model.
        combines: probability that the wanted pair makes something that the book lacks; None without
            a pair.
        made: known recipes by which the listed entities lead to others, in order of their steps.
        num_made: number of such entities; ``made`` may be cut.
    """

    wish: Wish
    new: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]
    trained_on: TrainedOn
    combines: Share | None = None
    made: tuple[Suggestion, ...] = ()
    num_made: Count = 0


def parse_set(words: Sequence[str], entities: frozenset[str]) -> tuple[tuple[str, ...], str, int]:
    """Parse ``a + b + c -> d`` or ``_ + _ + _ -> d``.

    Args:
        words: the arguments of the query.
        entities: labels of the graph, which are never split.

    Returns:
        Labels of the ingredients, none for the best sets; label of the result; number of
        ingredients.

    Raises:
        ConfigError: for any other query, such as one without a result.
    """
    ingredients, result = pieces_of_recipe(words, entities)
    if result is None:
        raise ConfigError(
            f"no result in '{' '.join(words)}': a model of sets scores whole recipes; expected "
            "a + b + c = d. Add the result."
        )
    is_open = [label in OPEN and label not in entities for label in ingredients]
    if result in OPEN or (any(is_open) and not all(is_open)):
        raise ConfigError(
            f"cannot parse recipe '{' '.join(words)}' for a model of sets; expected "
            "a + b + c -> d, or _ + _ + _ -> d for the best sets of three."
        )
    if len(ingredients) > MOST_INGREDIENTS:
        raise ConfigError(
            f"{len(ingredients)} ingredients; expected 1 to {MOST_INGREDIENTS}. Split the recipe."
        )
    if result in ingredients:
        raise ConfigError(f"'{result}' is among its own ingredients; expected other ingredients.")
    return () if all(is_open) else ingredients, result, len(ingredients)


def is_set_model(model: Model) -> bool:
    """Return whether a model scores sets of any number of ingredients."""
    return isinstance(model.scorer, SetScorer)


def can_suggest(model: Model) -> bool:
    """Return whether a model scores whole recipes, and knows how probable they are."""
    folds = folds_of(model.scorer)
    has_probabilities = folds is not None and folds.probabilities is not None
    is_of_pairs = isinstance(whole_of(model.scorer), RecipeScorer)
    return is_set_model(model) or (is_of_pairs and has_probabilities)


def open_suggesting(folder: Path, graph: str | None = None) -> Model:
    """Open a model that can suggest recipes.

    Raises:
        ConfigError: if it scores links alone.

    Further errors are those of :func:`~wordcraft_kg.models.model_folder.open_model`.
    """
    model = open_model(folder, graph)
    if not isinstance(whole_of(model.scorer), SetScorer | RecipeScorer):
        raise ConfigError(
            f"{model.scorer.name} scores links, not recipes; expected a model from "
            "`wordcraft-kg train-recipes`."
        )
    return model


def suggest_sets(
    model: Model,
    goal: str,
    top: int,
    *,
    has_coverage: bool = True,
    size: int | None = None,
    new_only: bool = False,
    rule: Rule | None = None,
) -> Suggestions:
    """Suggest sets for a goal, also for one that the graph lacks if the model knows its parts.

    Args:
        model: a model of sets.
        goal: label.
        top: most recipes.
        has_coverage: whether ingredients must bring the goal's parts, and no others.
        size: number of ingredients; None for any.
        new_only: whether recipes of the book are left out.
        rule: which sets are allowed; None for all.

    Raises:
        ConfigError: if nothing is known of the goal, or the rule allows no set.
    """
    goal = goal if goal in model.opened.graph else goal.strip()
    scorer, new = _scorer_of(model, [goal])
    ranked = scorer.recipes(goal, 10**6, has_coverage=has_coverage, rule=rule)
    split = model.opened.split
    sets = []
    for ranked_set in ranked:
        labels = [scorer.entities[entity] for entity in ranked_set.ingredients]
        is_new = not new_only or _known(split, Recipe(labels, goal)) == "new"
        if is_new and size in (None, len(labels)):
            sets.append(ranked_set)
    suggestions = [
        _suggestion(split, scorer, ranked_set.ingredients, goal, ranked_set.score)
        for ranked_set in sets[:top]
    ]
    return Suggestions(Wish(goal=goal), new, tuple(suggestions), model.kg)


def score_set(model: Model, ingredients: Sequence[str], goal: str) -> Suggestions:
    """Score a whole recipe by a model of sets; entities that the graph lacks count by parts, words.

    Args:
        model: a model of sets.
        ingredients: labels.
        goal: label of the result.

    Raises:
        ConfigError: if nothing is known of an entity.
    """
    scorer, new = _scorer_of(model, [*ingredients, goal])
    ids = scorer.entity_ids(list(ingredients)).tolist()
    row = np.full((1, MOST_INGREDIENTS), NO_INGREDIENT)
    row[0, : len(ids)] = ids
    score = float(scorer.score_sets(row, scorer.entity_ids([goal]).numpy())[0])
    suggestion = _suggestion(model.opened.split, scorer, tuple(sorted(ids)), goal, score)
    return Suggestions(Wish(goal=goal), new, (suggestion,), model.kg)


def _scorer_of(model: Model, labels: Sequence[str]) -> tuple[SetScorer, tuple[str, ...]]:
    """Return the scorer with all labels of a query, and those that the graph lacks."""
    scorer, metrics = model.scorer, model.metrics
    assert isinstance(scorer, SetScorer)
    assert isinstance(metrics, SetMetrics)
    new = tuple(dict.fromkeys(label for label in labels if label not in model.opened.graph))
    for label in new:
        fault = label_fault(label)
        if fault is not None:
            raise ConfigError(f"{fault} Expected the name of an entity; correct the label.")
    if new:
        parts = model.settings.get("parts", metrics.parts)
        scorer = with_new_entities(scorer, new, parts, metrics.features)
    return scorer, new


def _suggestion(
    split: Split, scorer: SetScorer, ids: tuple[int, ...], goal: str, score: float
) -> Suggestion:
    entities = scorer.entities
    support = []
    for near in scorer.near_recipes(goal, ids, _SUPPORT):
        labels = [entities[entity] for entity in near.ingredients]
        support.append((Recipe(labels, entities[near.result]), near.strength))
    recipe = Recipe([entities[entity] for entity in ids], goal)
    return Suggestion(recipe, float(np.exp(score)), _known(split, recipe), tuple(support))


# Two splits, since tests and notebooks open several; a list of suggestions asks for many recipes.
@lru_cache(maxsize=2)
def _parts_of_recipes(split: Split) -> dict[Recipe, Known]:
    """Return the part of a split that has each recipe, by its labels."""
    recipes = split.graph.recipe_labels()
    return {recipe: KNOWN[part] for recipe, part in zip(recipes, split.parts, strict=True)}


def _known(split: Split, recipe: Recipe) -> Known:
    """Return the part of a split that has a recipe, or ``new``."""
    return _parts_of_recipes(split).get(recipe, "new")


# --- recipes that the book lacks ------------------------------------------------------------------


def suggest(
    model: Model,
    wish: Wish,
    top: int = PAGE,
    *,
    has_coverage: bool = True,
    new_only: bool = True,
    rule: Rule | None = None,
) -> Suggestions:
    """Suggest recipes that the book lacks, the most probable first, none of them for one item only.

    Args:
        model: from :func:`open_suggesting`.
        wish: the wanted recipes.
        top: most recipes.
        has_coverage: whether ingredients must bring the goal's parts, by a model of sets.
        new_only: whether a model of sets leaves out the book's recipes of a goal; all others do.
        rule: which sets of a goal are allowed; None for all.

    Raises:
        ConfigError: if the model has no probabilities, or, of sets, too many goals; or for a rule
            without sets of a goal.
        UnknownEntityError: for an entity that the graph lacks.
    """
    if wish.goal is not None and is_set_model(model):
        return suggest_sets(
            model, wish.goal, top, has_coverage=has_coverage, new_only=new_only, rule=rule
        )
    if rule is not None:
        raise ConfigError(
            "`rule` chooses among the sets of a goal, by a model of sets; expected such a model "
            "and `goal`. Leave `rule` out."
        )
    graph = model.opened.graph
    named = {graph.id_of(label) for label in wish.labels}
    steps = layers(graph, wish.table) if wish.table else None
    combines = None
    if is_set_model(model):
        listed = list(_likely_sets(model, wish, named, steps, top, has_coverage=has_coverage))
    else:
        # Test recipes are in the book, too.
        finder = RecipeFinder.of(
            model.scorer, graph.recipes, allows_self_results=graph.has_self_results
        )
        recipes = likely_pairs(finder, wish, graph, steps)
        rows = varied(recipes.rows.tolist(), top, named)
        listed = [
            _suggested_pair(
                finder.whole, recipes.rows[row], float(recipes.probabilities[row]), steps
            )
            for row in rows
        ]
        combines = float(recipes.combines[0]) if wish.pair else None
    known_steps = [] if steps is None else list(_made(model.opened.split, steps))
    return Suggestions(
        wish,
        (),
        tuple(listed),
        model.kg,
        combines,
        tuple(known_steps[:top]),
        len(known_steps),
    )


def likely_pairs(
    finder: RecipeFinder, wish: Wish, graph: RecipeGraph, steps: Ids | None = None
) -> LikelyRecipes:
    """Return the recipes of pairs that a wish asks for, all that are looked at.

    Args:
        finder: of the graph's model.
        wish: the wanted recipes.
        graph: the recipe graph.
        steps: shape (E,), attempts in which the listed entities lead to each; -1 for never.
    """
    if wish.goal is not None:
        goal = graph.id_of(wish.goal)
        return finder.likely(finder.pairs_for(goal), goal=goal)
    if wish.item is not None:
        return finder.likely(finder.pairs_with(graph.id_of(wish.item)))
    if wish.pair:
        return finder.likely(np.array([sorted(map(graph.id_of, wish.pair))]))
    if steps is not None:
        return finder.likely(finder.pairs_of(np.flatnonzero(steps >= 0)))
    return finder.likely(finder.pairs_like_known())


def varied(rows: Iterable[Sequence[int]], top: int, named: Iterable[int] = ()) -> list[int]:
    """Return the places of recipes for pages on which no item has more than its share.

    Args:
        rows: entities of each recipe, the best first.
        top: most recipes.
        named: entities that the reader asked for, which may be in every recipe.

    Returns:
        places in ``rows``: pages of :data:`PAGE` recipes, each with an entity at most
        :data:`MOST_OF_ITEM` times; a recipe that has no room waits for the next page.
    """
    waiting = list(enumerate(map(frozenset, rows)))
    places: list[int] = []
    while waiting and len(places) < top:
        uses = Counter[int]()
        page: list[int] = []
        postponed = []
        for place, items in waiting:
            is_crowded = any(uses[item] >= MOST_OF_ITEM for item in items.difference(named))
            if len(page) == PAGE or is_crowded:
                postponed.append((place, items))
            else:
                page.append(place)
                uses.update(items)
        places += page
        waiting = postponed
    return places[:top]


def _suggested_pair(
    scorer: RecipeScorer, row: Ids, probability: float, steps: Ids | None
) -> Suggestion:
    first, second, result = (scorer.entities[entity] for entity in row.tolist())
    support = [
        (witness.recipe, witness.strength)
        for witness in scorer.supporting_recipes(first, second, result, limit=_SUPPORT)
    ]
    step = _step(steps, row[:2].tolist())
    recipe = Recipe.of(first, second, result)
    return Suggestion(recipe, probability, "new", tuple(support), step)


def _step(steps: Ids | None, ingredients: Sequence[int]) -> int | None:
    """Return the attempt in which ingredients can be combined; None if nothing leads there."""
    if steps is None or (steps[list(ingredients)] < 0).any():
        return None
    return int(steps[list(ingredients)].max()) + 1


def _made(split: Split, steps: Ids) -> Iterator[Suggestion]:
    """Yield a known recipe for each entity that the listed ones lead to, in order of steps."""
    graph = split.graph
    *ingredients, results = graph.sets.T
    # The padding of small recipes is there from the start; what is never made comes last.
    unreached = graph.num_recipes + 1
    from_start = np.append(np.where(steps < 0, unreached, steps), 0)
    before = np.max([from_start[column] for column in ingredients], axis=0)
    is_first = (before < unreached) & (before + 1 == from_start[results])
    _, rows = np.unique(results[is_first], return_index=True)
    rows = np.flatnonzero(is_first)[rows]
    rows = rows[np.argsort(from_start[results[rows]], kind="stable")]
    recipes = graph.recipe_labels(graph.sets[rows])
    steps_of_recipes = from_start[results[rows]].tolist()
    for recipe, step in zip(recipes, steps_of_recipes, strict=True):
        yield Suggestion(recipe, 1.0, _known(split, recipe), (), step)


def _likely_sets(
    model: Model,
    wish: Wish,
    named: Collection[int],
    steps: Ids | None,
    top: int,
    *,
    has_coverage: bool,
) -> Iterator[Suggestion]:
    """Yield the most probable sets that a wish asks for, of all goals that the book makes."""
    scorer = model.scorer
    assert isinstance(scorer, SetScorer)
    split = model.opened.split
    graph = split.graph
    goals = np.flatnonzero(graph.recipe_counts).tolist()
    if len(goals) > MOST_GOALS:
        raise ConfigError(
            f"{graph.name} has {len(goals):,} goals; a model of sets ranks the sets of at most "
            f"{MOST_GOALS:,} at once. Name a goal."
        )
    ranked = []
    for goal in goals:
        # Without a set for one goal there are those of the others.
        with suppress(ConfigError):
            ranked += [
                (each, goal) for each in scorer.recipes(goal, _SETS, has_coverage=has_coverage)
            ]
    ranked.sort(key=lambda pair: -pair[0].score)
    candidates = []
    for ranked_set, goal in ranked:
        recipe = Recipe(graph.labels(ranked_set.ingredients), graph.entities[goal])
        step = _step(steps, ranked_set.ingredients)
        is_new = _known(split, recipe) == "new"
        has_self = recipe.is_self_result and not graph.has_self_results
        if is_new and not has_self and wish.takes(recipe.ingredients, step):
            candidates.append((ranked_set, goal, step))
    rows = varied(
        ((*ranked_set.ingredients, goal) for ranked_set, goal, _ in candidates), top, named
    )
    for row in rows:
        ranked_set, goal, step = candidates[row]
        suggestion = _suggestion(
            split, scorer, ranked_set.ingredients, graph.entities[goal], ranked_set.score
        )
        yield msgspec.structs.replace(suggestion, steps=step)


ACCEPT = "accept"
"""Column for the ticks."""
COLUMNS = ("probability", "because", ACCEPT)
"""Columns behind ingredients and result."""
TICKS = ("x", "yes", "y", "1", "true")
"""Cells that accept a recipe, in any case; all others leave it out."""


def check_new_table(out: Path) -> None:
    """Check, before any work, that a table can be written.

    Raises:
        RecipeFileError: if the ending is no table's, or the file's folder is not there.
        OutputExistsError: if the file exists.
    """
    _check_new(out)
    if out.suffix.lower() not in (".csv", ".tsv"):
        raise RecipeFileError(f"{out}: suggestions are written as .csv or .tsv. Change the ending.")


def _check_new(out: Path) -> None:
    check_output_file(out, force=True)
    if not out.parent.is_dir():
        raise RecipeFileError(f"no folder '{out.parent}' for `out`; expected one. Make it first.")
    if out.exists():
        raise OutputExistsError(f"'{out}' exists, and is not replaced. Choose another `out`.")


def table_lines(suggestions: Sequence[Suggestion], delimiter: str = ",") -> Iterator[str]:
    """Yield the lines of a table of suggestions: a header, and a line for each.

    Args:
        suggestions: recipes, in the order of the lines.
        delimiter: one character between cells.
    """
    width = max((len(suggestion.recipe) - 1 for suggestion in suggestions), default=2)
    yield csv_line((*own_header(width), *COLUMNS), delimiter)
    for suggestion in suggestions:
        *ingredients, result = suggestion.recipe
        empty = [""] * (width - len(ingredients))
        probability = f"{suggestion.probability:.3f}"
        nearest_recipe = str(suggestion.because[0][0]) if suggestion.because else ""
        further_cells = (probability, nearest_recipe, "")
        cells = (*ingredients, *empty, result, *further_cells)
        yield csv_line(cells, delimiter)


def ticked(path: Path, graph: RecipeGraph) -> list[Recipe]:
    """Return the ticked recipes of a table of suggestions, in its order.

    A result may be an entity that the book lacks: the person who ticks may name a new thing.

    Raises:
        RecipeFileError: if the table cannot be read, has no column of ticks or no tick, or a ticked
            row is no recipe, has an ingredient that the book lacks, or is in the book.
    """
    # A page of suggestions may have no set of three, without which readers refuse sets of one.
    check = check_book(path, single_ingredient="alone")
    reading = check.reading
    if reading is None:
        raise RecipeFileError(str(check.findings[0].message))
    columns = {name.strip().lower(): name for name in reading.ignored}
    if ACCEPT not in columns:
        columns_shown = ", ".join((*reading.columns, *reading.ignored))
        raise RecipeFileError(
            f"{path} has the columns {columns_shown}; expected a column '{ACCEPT}' with x in the "
            "rows to take, as in a table of `wordcraft-kg suggest --out`."
        )
    ticked_places = {
        place
        for place, cells in check.records.items()
        if cells.get(columns[ACCEPT], "").strip().lower() in TICKS
    }
    _check_none_is_lost(path, check, ticked_places, keeps_self_results=graph.has_self_results)
    book_recipes = set(graph.recipe_labels())
    recipes = []
    for recipe, place in check.places.items():
        if place not in ticked_places:
            continue
        for label in recipe.ingredients:
            if label not in graph:
                raise RecipeFileError(
                    f"{path}, line {place}: '{label}' is no entity of {graph.name}; expected "
                    "suggestions for this book. Nothing was written."
                    f"{nearest(label, graph.entities)}"
                )
        if recipe in book_recipes:
            raise RecipeFileError(
                f"{path}, line {place}: {recipe} is in {graph.name} already. Remove the tick. "
                "Nothing was written."
            )
        recipes.append(recipe)
    if not recipes:
        raise RecipeFileError(
            f"{path} has no tick; expected {', '.join(TICKS)} in the column '{ACCEPT}' of the rows "
            "to take. Nothing was written."
        )
    return recipes


def _check_none_is_lost(
    path: Path, check: BookCheck, ticked_places: Collection[Place], *, keeps_self_results: bool
) -> None:
    for reason, places in check.lost.items():
        lost_places = [place for place in places if place in ticked_places]
        is_lost = reason != SELF_RESULT or not keeps_self_results
        if lost_places and is_lost:
            raise RecipeFileError(
                f"{path}, line {lost_places[0]}: this row has a tick, but is among the rows "
                f"{reason}. Correct the row, or remove its tick. Nothing was written."
            )


def write_accepted(graph: RecipeGraph, recipes: Sequence[Recipe], out: Path) -> None:
    """Write a copy of a graph's book with further recipes.

    Args:
        graph: the graph; its own file stays as it is.
        recipes: the further recipes.
        out: a .csv, .tsv or .json file.

    Raises:
        RecipeFileError: if the ending is another.
        OutputExistsError: if the file exists.
    """
    _check_new(out)
    book = graph.to_book()
    longer = RecipeBook.of(
        book.name,
        [*book.recipes, *recipes],
        base=book.base,
        listed=book.idle,
        keep_self_results=True,
    )
    write_book(replace(longer, kinds=book.kinds, quantities=book.quantities), out)
