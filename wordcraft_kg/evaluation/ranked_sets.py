"""Top-k accuracy of whole sets for unseen goals: a model, baselines, and predictions of others."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from wordcraft_kg.base import ConfigError, Count, Record, Share, check_file
from wordcraft_kg.base.statistics import wilson_interval
from wordcraft_kg.graphs import Ids, TrainedOn
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.recipes.set_training import rows_of_sets
from wordcraft_kg.models.scorers.sets.knowledge import NO_INGREDIENT
from wordcraft_kg.models.scorers.sets.rules import Rule
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

TOP = (1, 3, 5, 10)
"""Numbers of first suggestions among which a right set counts."""
ALL = "all"
NEW_PARTS = "new parts"
NEW_SETS = "new sets"
_LISTED = 10
"""Most sets in a file of predictions."""
_MOST_BYTES = 2**27
_BINS = 10
_BASELINES = ("most frequent sets", "statistics of parts", "sets of the nearest goal")
Set = tuple[str, ...]
"""Labels of ingredients, sorted; one that is needed twice is named twice."""
Predictions = Mapping[str, Sequence[Sequence[str]]]
"""Sets of ingredients by goal, best first."""


class TopShares(Record):
    """Share of goals with a right set among the first k, by k.

    Attributes:
        goals: number of goals.
        shares: by k.
        intervals: 95 % intervals of the shares (Wilson), by k.
    """

    goals: Count
    shares: dict[int, Share]
    intervals: dict[int, tuple[Share, Share]]


class RankedMethod(Record):
    """Top-k accuracy of a method.

    Attributes:
        name: the model, a baseline, or the file of predictions.
        columns: all goals, goals whose parts no train goal has together, goals of which no right
            set is that of a train recipe.
        answered: number of goals for which the method names a set.
    """

    name: str
    columns: dict[str, TopShares]
    answered: Count


class RankedSets(Record):
    """Content of ``sets.json``: methods on the test goals of a model of sets.

    Attributes:
        model: name of the model's folder.
        graph: hash of the graph.
        split: hash of the split.
        methods: the model first.
        calibration_error: mean distance between probabilities and shares of right sets, in ten
            bins of the model's first five suggestions.
        trained_on: training graph of the model; full if all goals were seen in training, so that
            the shares are memory, not prediction.
        has_rule: whether a rule of the user's chose among the model's sets.
    """

    model: str
    graph: str
    split: str
    methods: tuple[RankedMethod, ...]
    calibration_error: Share
    trained_on: TrainedOn = "partial"
    has_rule: bool = False


class _Goals(NamedTuple):
    """Test goals, the sets that make them, and which goals each column has.

    Attributes:
        ids: entities.
        labels: their labels.
        right: their test sets.
        taken: their train sets, which are no answers.
        columns: which goals each column has.
        has_repeats: whether a recipe of the book needs an ingredient twice; if not, an ingredient
            that an answer names twice counts once.
    """

    ids: list[int]
    labels: list[str]
    right: list[frozenset[Set]]
    taken: list[frozenset[Set]]
    columns: dict[str, np.ndarray[Any, Any]]
    has_repeats: bool

    def answers(self, row: int, sets: Iterable[Sequence[str]]) -> list[Set]:
        """Return the sets that are answers for a goal, best first, each once.

        Args:
            row: number of the goal.
            sets: labels of ingredients.
        """
        ordered = (tuple(sorted(labels if self.has_repeats else set(labels))) for labels in sets)
        return [labels for labels in dict.fromkeys(ordered) if labels not in self.taken[row]]


def rank_sets(
    model: Model, name: str, files: Sequence[Path] = (), rule: Rule | None = None
) -> tuple[RankedSets, dict[str, list[list[str]]]]:
    """Evaluate a model of sets on the goals of its test recipes.

    Args:
        model: the model; a test goal's train sets are no answers of any method.
        name: name of the model.
        files: predictions of others, see :func:`read_predictions`.
        rule: which of the model's sets are allowed.

    Returns:
        the record, and the model's own predictions.

    Raises:
        ConfigError: if the split has no test recipes, a file no predictions of test goals, or two
            methods the same name.
    """
    scorer = model.scorer
    assert isinstance(scorer, SetScorer)
    names = [name, *_BASELINES, *(path.name for path in files)]
    for number, method in enumerate(names):
        if method in names[:number]:
            raise ConfigError(
                f"two methods are called '{method}'; expected a name of its own for the model and "
                "each file of predictions. Rename the file."
            )
    predictions_of_files = {path.name: read_predictions(path) for path in files}
    goals = _test_goals(model, scorer)
    for path in files:
        if not _num_answered(goals, predictions_of_files[path.name]):
            first_goal = next(iter(predictions_of_files[path.name]), "nothing")
            raise ConfigError(
                f"{path}: answers for '{first_goal}' and none of the test goals; expected goals "
                f"such as '{goals.labels[0]}'. Give the predictions for this split."
            )
    predictions: dict[str, list[list[str]]] = {}
    chances: list[float] = []
    is_right: list[bool] = []
    for row, (entity, label) in enumerate(zip(goals.ids, goals.labels, strict=True)):
        try:
            ranked = scorer.recipes(entity, _LISTED + len(goals.taken[row]), rule=rule)
        except ConfigError:
            ranked = []
        chance_of = {
            tuple(sorted(scorer.entities[member] for member in suggestion.ingredients)): (
                suggestion.probability
            )
            for suggestion in ranked
        }
        sets = goals.answers(row, chance_of)[:_LISTED]
        predictions[label] = [list(labels) for labels in sets]
        chances += [chance_of[labels] for labels in sets[:5]]
        is_right += [labels in goals.right[row] for labels in sets[:5]]
    methods: dict[str, Predictions] = {
        name: predictions,
        **_baselines(scorer, goals),
        **predictions_of_files,
    }
    hits = {method: _hits(goals, answers) for method, answers in methods.items()}
    rows = [
        RankedMethod(
            method,
            {
                column: _top_shares(table[is_in_column])
                for column, is_in_column in goals.columns.items()
            },
            _num_answered(goals, methods[method]),
        )
        for method, table in hits.items()
    ]
    record = RankedSets(
        model=name,
        graph=model.opened.graph.hash,
        split=model.opened.split.hash,
        methods=tuple(rows),
        calibration_error=_calibration_error(np.array(chances), np.array(is_right)),
        trained_on=model.kg,
        has_rule=rule is not None,
    )
    return record, predictions


def read_predictions(path: Path) -> Predictions:
    """Read sets of ingredients by goal, best first: ``{"mud": [["earth", "water"], ...], ...}``.

    Args:
        path: a JSON file.

    Raises:
        ConfigError: if it is no such file.
        ArtefactError: if it is too large.
    """
    if not path.is_file():
        raise ConfigError(
            f"no file '{path}'; expected predictions as JSON, sets of ingredients by goal. Check "
            "the path."
        )
    check_file(path, _MOST_BYTES)
    try:
        return msgspec.convert(json.loads(path.read_bytes()), dict[str, list[list[str]]])
    except (ValueError, RecursionError, msgspec.ValidationError) as error:
        raise ConfigError(
            f"{path}: no predictions ({str(error)[:80]}); expected JSON such as "
            '{"mud": [["earth", "water"]]}: sets of ingredients by goal, best first.'
        ) from None


def _test_goals(model: Model, scorer: SetScorer) -> _Goals:
    """Return the goals of the test part with their right sets, and the columns that count them.

    Raises:
        ConfigError: if the split has no test part.
    """
    graph, split = model.opened.graph, model.opened.split
    rows = rows_of_sets(graph, split.is_in("test"))
    if not len(rows):
        raise ConfigError(
            f"{graph.name} has no test recipes; build it with a split such as by-goal."
        )
    sets_of_goal = _sets_of_goals(graph.entities, rows)
    train_sets = _sets_of_goals(graph.entities, rows_of_sets(graph, split.is_in("train")))
    ids = sorted(sets_of_goal)
    right = [frozenset(sets_of_goal[goal]) for goal in ids]
    train_sets_by_goal = [frozenset(train_sets.get(goal, ())) for goal in ids]
    knowledge = scorer.knowledge
    has_part = knowledge.amounts > 0
    seen_parts = {has_part[goal].tobytes() for goal in knowledge.goal_ids}
    seen_sets = set().union(*_sets_of_goals(graph.entities, knowledge.recipes).values())
    columns = {ALL: np.ones(len(ids), dtype=bool)}
    if knowledge.has_parts:
        is_new = [has_part[goal].tobytes() not in seen_parts for goal in ids]
        columns[NEW_PARTS] = np.array(is_new)
    columns[NEW_SETS] = np.array([not sets & seen_sets for sets in right])
    columns = {
        column: is_in_column for column, is_in_column in columns.items() if is_in_column.any()
    }
    labels = [graph.entities[goal] for goal in ids]
    all_sets = _sets_of_goals(graph.entities, rows_of_sets(graph, slice(None))).values()
    has_repeats = any(
        len(set(ingredients)) < len(ingredients) for sets in all_sets for ingredients in sets
    )
    return _Goals(ids, labels, right, train_sets_by_goal, columns, has_repeats)


def _sets_of_goals(entities: Sequence[str], rows: Ids) -> dict[int, set[Set]]:
    """Return the sets that make each goal, from rows (ingredients, padding -1, goal)."""
    sets_of_goal: dict[int, set[Set]] = {}
    for row in rows.tolist():
        members = (entities[entity] for entity in row[:-1] if entity != NO_INGREDIENT)
        sets_of_goal.setdefault(row[-1], set()).add(tuple(sorted(members)))
    return sets_of_goal


def _baselines(scorer: SetScorer, goals: _Goals) -> dict[str, Predictions]:
    """Return predictions that any outsider makes: frequent sets, parts' statistics, nearest goal.

    The last two know parts; without, they are frequent ingredients and the words' nearest goal.
    """
    knowledge = scorer.knowledge
    lists = knowledge.lists
    frequent = np.argsort(-knowledge.set_counts, kind="stable")
    predictions: dict[str, dict[str, list[list[str]]]] = {name: {} for name in _BASELINES}
    by_frequency, by_parts, by_nearest = predictions.values()
    for entity, label, train_sets in zip(goals.ids, goals.labels, goals.taken, strict=True):
        num_sets = _LISTED + len(train_sets)
        by_frequency[label] = [
            _labels(scorer, lists.sets[number]) for number in frequent[:num_sets]
        ]
        evidence = scorer.evidence(entity)
        near = np.argsort(-evidence.set_votes[2], kind="stable")[:num_sets]
        by_nearest[label] = [_labels(scorer, lists.sets[number]) for number in near]
        sets = knowledge.sets_by_frequency(evidence)[:num_sets]
        by_parts[label] = [_labels(scorer, row) for row in sets]
    return dict(predictions)


def _labels(scorer: SetScorer, row: Ids) -> list[str]:
    """Return the labels of a set by numbers of ingredients."""
    return [scorer.entities[entity] for entity in scorer.knowledge.ingredient_ids[row[row >= 0]]]


def _num_answered(goals: _Goals, predictions: Predictions) -> int:
    """Return the number of test goals for which predictions have a set."""
    return sum(bool(predictions.get(label)) for label in goals.labels)


def _hits(goals: _Goals, predictions: Predictions) -> np.ndarray[Any, Any]:
    """Return whether a right set is among the first k of a goal, shape (goals, len(TOP)), bool."""
    hits = np.zeros((len(goals.ids), len(TOP)), dtype=bool)
    for row, (label, right) in enumerate(zip(goals.labels, goals.right, strict=True)):
        ranked = goals.answers(row, predictions.get(label, ()))
        for column, k in enumerate(TOP):
            hits[row, column] = not right.isdisjoint(ranked[:k])
    return hits


def _top_shares(hits: np.ndarray[Any, Any]) -> TopShares:
    shares = dict(zip(TOP, hits.mean(0).tolist(), strict=True))
    intervals = {
        k: wilson_interval(float(count), len(hits))
        for k, count in zip(TOP, hits.sum(0).tolist(), strict=True)
    }
    return TopShares(len(hits), shares, intervals)


def _calibration_error(chances: np.ndarray[Any, Any], is_right: np.ndarray[Any, Any]) -> float:
    """Return the expected calibration error of probabilities in bins of equal width."""
    bins = np.minimum((chances * _BINS).astype(int), _BINS - 1)
    distances = np.bincount(bins, chances - is_right, _BINS)
    return float(np.abs(distances).sum() / max(len(chances), 1))
