"""Scores of triples and of recipes, also for words outside the graph.

:func:`parse_query` and :func:`read_queries` read queries with at most one open entity, from
arguments or a file. :func:`scoring_of` returns the scoring of a query: :class:`LinkScoring` for
triples, :class:`RecipeScoring` for recipes. Both score whole queries, rank each entity in its slot,
and list the best entities for an open slot, as :class:`ScoredAnswer`.
"""

import csv
import io
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, cast

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.base import (
    ConfigError,
    Count,
    QueryFileError,
    Record,
    Share,
    UnknownEntityError,
    WordCraftKGError,
    nearest,
)
from wordcraft_kg.graphs import (
    COMPONENT_OF,
    RELATIONS,
    Ids,
    TrainedOn,
    are_among,
    recipe_keys,
)
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.recipes.inductive import with_words
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence, OutsideEvidenceFinder
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import LEAST_SHARE
from wordcraft_kg.models.scorers.neighbours.results import CANDIDATES
from wordcraft_kg.models.scorers.recipes import RecipeScorer, Witness
from wordcraft_kg.models.scorers.scorer import Scorer

OPEN = ("_", "?")
"""Spellings for an open slot; shells expand ``?``, but not ``_``."""
_PLUS = "+"
_MAKES = ("=", "->", "→")
"""Signs of a recipe query, ``a + b = c``; ``=`` and ``+`` need no quotes in a shell."""
_SIGNS = {_PLUS, *_MAKES}
_SIGN = re.compile(r"\s*(\+|=|->|→)\s*")


@dataclass(frozen=True)
class Query:
    """A query for a triple, as labels of which at most one may be open.

    Attributes:
        columns: names of the slots, the header of a file of such queries.
        entity_slots: places of the slots that hold an entity; a relation stands in the others.
        slots: a label for each column; None for the open slot.
        line: line of the file that the query was read from, from 1; None for arguments.
    """

    columns: ClassVar[tuple[str, str, str]] = ("head", "relation", "tail")
    entity_slots: ClassVar[tuple[int, ...]] = (0, 2)

    slots: tuple[str | None, ...]
    line: int | None = None

    @classmethod
    def of(
        cls, words: Sequence[str], entities: Collection[str], *, line: int | None = None
    ) -> Self:
        """Make a query from three typed words; an empty word and :data:`OPEN` leave a slot open.

        Args:
            words: a word for each column.
            entities: labels of the graph. An entity may have the label ``_``, which then means the
                entity.
            line: line of the file, from 1; None for arguments.

        Raises:
            UnknownEntityError: for an unknown relation; the error names the nearest.
            ConfigError: if several slots are open.
        """
        if 1 not in cls.entity_slots and words[1] not in RELATIONS:
            raise UnknownEntityError(
                f"no relation '{words[1]}'; expected {' or '.join(RELATIONS)}."
                f"{nearest(words[1], RELATIONS)}"
            )
        slots = tuple(
            None if word in ("", *OPEN) and word not in entities else word for word in words
        )
        if slots.count(None) > 1:
            raise ConfigError(
                f"'{' '.join(word or '_' for word in words)}' has several open slots; leave a "
                "single one open."
            )
        return cls(slots, line)

    @property
    def is_open(self) -> bool:
        """Whether a slot is open."""
        return None in self.slots

    @property
    def labels(self) -> list[str]:
        """The named entities."""
        labels = (self.slots[place] for place in self.entity_slots)
        return [label for label in labels if label is not None]


class RecipeQuery(Query):
    """A query for a recipe, see :class:`Query`."""

    columns = ("ingredient_a", "ingredient_b", "result")
    entity_slots = (0, 1, 2)


def parse_query(words: Sequence[str], entities: Collection[str]) -> Query:
    """Parse a triple or recipe query from command line arguments.

    A triple is ``head relation [tail]``; a query without tail ranks all tails. A recipe is ``a +
    b`` or ``a + b = c``, in any number of arguments; ``->`` and ``→`` mean ``=``. Arguments that
    are labels in ``entities`` are never split. A query may name other entities.

    Args:
        words: the arguments.
        entities: labels of the graph.

    Raises:
        UnknownEntityError: for an unknown relation; the error names the nearest.
        ConfigError: if the arguments are neither triple nor recipe, or several entities are open.
    """
    # With a relation, the arguments are a triple, even if a label contains a sign.
    is_triple = any(word in RELATIONS for word in words)
    pieces = [] if is_triple else list(_pieces(words, entities))
    if _SIGNS.isdisjoint(pieces):
        if len(words) not in (2, 3):
            raise _unreadable(
                words, "query", "a head, a relation and perhaps a tail, or a recipe such as a + b"
            )
        return Query.of([*words, ""][:3], entities)
    ingredients, result = pieces_of_recipe(words, entities)
    if len(ingredients) != 2:
        raise _unreadable(
            words, "recipe", "a + b for its results, a + b = c, or _ + b = c for its partners"
        )
    return RecipeQuery.of([*ingredients, result or ""], entities)


def is_recipe_query(words: Sequence[str]) -> bool:
    """Return whether the words of a query have a sign of a recipe."""
    return any(sign in word for word in words for sign in _SIGNS)


def pieces_of_recipe(
    words: Sequence[str], entities: Collection[str]
) -> tuple[tuple[str, ...], str | None]:
    """Return the ingredients and the result of a recipe of any size, ``a + b + c -> d``.

    Args:
        words: the arguments, as for :func:`parse_query`.
        entities: labels of the graph, which are never split.

    Returns:
        Labels of the ingredients, and of the result; None without a result.

    Raises:
        ConfigError: if the arguments are no recipe.
    """
    pieces = list(_pieces(words, entities))
    result = None
    if len(pieces) > 2 and pieces[-2] in _MAKES:
        result = pieces.pop()
        pieces.pop()
    labels, signs = pieces[::2], pieces[1::2]
    if not labels or len(labels) == len(signs) or set(signs) - {_PLUS} or _SIGNS & set(labels):
        raise _unreadable(words, "recipe", "a + b, a + b = c, or a + b + c -> d")
    return tuple(labels), result


def _pieces(words: Sequence[str], entities: Collection[str]) -> Iterator[str]:
    """Yield labels and signs; a word that is a label, such as ``a+b``, is not split."""
    for word in words:
        if word in entities:
            yield word
        else:
            yield from filter(None, _SIGN.split(word))


def _unreadable(words: Sequence[str], query: str, expected: str) -> ConfigError:
    return ConfigError(
        f"cannot parse {query} '{' '.join(words)}'; expected {expected}. Quote labels with several "
        "words."
    )


def read_queries(path: Path, entities: Collection[str]) -> list[Query]:
    """Read queries from a CSV or TSV file of triples or recipes.

    Recipes need the header ingredient_a, ingredient_b, result; triples need none. A tab in the
    first line means unquoted TSV, as in a graph folder's ``triples/``; otherwise the file is CSV.
    Blank lines are skipped.

    Args:
        path: the file.
        entities: labels of the graph.

    Raises:
        QueryFileError: if the file cannot be read, has no query, or has a wrong line, which the
            error names.
    """
    rows = list(_rows(path))
    header = tuple(rows[0][1]) if rows else ()
    kind = RecipeQuery if header == RecipeQuery.columns else Query
    # An entity may be called "head": only a whole row of these words is a header.
    if header == kind.columns:
        del rows[0]
    queries = []
    for line, cells in rows:
        if len(cells) != 3:
            shown = ",".join(cells)[:80]
            raise QueryFileError(
                f"{path}, line {line}: '{shown}' has {len(cells)} columns; expected "
                f"{', '.join(kind.columns)}."
            )
        try:
            queries.append(kind.of(cells, entities, line=line))
        except WordCraftKGError as error:
            raise QueryFileError(f"{path}, line {line}: {error}") from None
    if not queries:
        raise QueryFileError(f"{path} has no query; expected lines with {', '.join(kind.columns)}.")
    return queries


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line that is not blank, and the line where they end."""
    if not path.is_file():
        raise QueryFileError(
            f"'{path}' is not a file; expected a CSV or TSV file with {', '.join(Query.columns)}."
        )
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise QueryFileError(
            f"{path} is not UTF-8 (byte {error.start:,}). Save the file as UTF-8."
        ) from None
    lines = io.StringIO(text, newline="")
    is_tsv = "\t" in text.partition("\n")[0]
    reader = csv.reader(
        lines,
        delimiter="\t" if is_tsv else ",",
        quoting=csv.QUOTE_NONE if is_tsv else csv.QUOTE_MINIMAL,
        strict=True,
    )
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise QueryFileError(f"{path}, line {reader.line_num}: {error}.") from None


Known = Literal["train", "valid", "test", "new"]
"""The split part with a triple or recipe (train takes precedence), or ``new``."""
KNOWN: tuple[Known, ...] = ("train", "valid", "test", "new")
"""Names of the parts by their numbers; -1 is ``new``."""
# Supporting recipes are sorted by share; more would push the results off the screen.
_SUPPORT = 3


class ScoredAnswer(Record, omit_defaults=True):
    """A triple or a recipe with its score.

    A raw score means little by itself; the unfiltered ranks among all entities say more.

    Attributes:
        slots: labels by slot: head, relation and tail, or ingredient_a, ingredient_b and result.
        score: higher is more plausible, on the scorer's own scale.
        known: split part with the triple or recipe, see :data:`Known`.
        line: line of the query in the queries' file, from 1; None for a query from arguments.
        rank: rank in the list for an open slot, from 1; None for a whole query.
        ranks: rank of each entity in its slot among all entities, from 1, for a whole query from
            arguments; entities with equal scores share the best rank.
        probability: calibrated probability of a triple, None for a train triple; for the results of
            a pair from arguments, that of the result if the pair makes something. None without a
            calibration.
        in_sample: whether the scorer was trained on the recipe, so that its score says nothing
            about other recipes; False for triples.
        because: supporting train recipes; recipes that make the result itself come first.
        outside: evidence from outside the train recipes.
    """

    slots: dict[str, str]
    score: float
    known: Known
    line: Count | None = None
    rank: Count | None = None
    ranks: dict[str, Count] = msgspec.field(default_factory=dict)
    probability: Share | None = None
    in_sample: bool = False
    because: tuple[Witness, ...] = ()
    outside: tuple[OutsideEvidence, ...] = ()


class Scores(Record, omit_defaults=True):
    """Answers to a query, or to all queries in a file.

    Attributes:
        queries: number of queries.
        scored: number of answers.
        trained_on: training graph of the scorer, `full`, `partial` or `none`.
        by_words: entities outside the graph, scored by their words alone.
        answers: the answers, in the order of the queries, those for an open slot best first; empty
            if they were written to a file.
        out: the written file; None without one.
    """

    queries: Count
    scored: Count
    trained_on: TrainedOn
    by_words: tuple[str, ...] = ()
    answers: tuple[ScoredAnswer, ...] = ()
    out: str | None = None


def link_probabilities(scorer: Scorer, triples: Ids, known: Sequence[Known]) -> list[float | None]:
    """Return calibrated probabilities for triples.

    Args:
        scorer: scorer of a model.
        triples: ids of shape (T, 3).
        known: part of each triple's recipe; one of train has no probability, as it is true, and
            calibration is for new ones.

    Returns:
        T probabilities; all are None without a calibration.
    """
    folds = folds_of(scorer)
    if folds is None or folds.probabilities is None:
        return [None] * len(triples)
    values = folds.probability(*torch.from_numpy(triples.copy()).T).tolist()
    pairs = zip(values, known, strict=True)
    return [None if part == "train" else value for value, part in pairs]


@dataclass(frozen=True)
class Scoring(ABC):
    """Scores of queries of one kind; an answer is a row of three ids, a triple or a recipe.

    Attributes:
        model: the opened model; its scorer may know further entities, see :func:`with_new_words`.
        outside: finder for evidence from outside the train recipes; None without such knowledge.
    """

    model: Model
    outside: OutsideEvidenceFinder | None = None

    @abstractmethod
    def scores(self, rows: Ids) -> torch.Tensor:
        """Return scores, shape (n,), of rows of ids, shape (n, 3)."""

    @abstractmethod
    def part_numbers(self, rows: Ids) -> Ids:
        """Return the split part of each row, shape (n, 3) -> (n,); -1 if the book lacks it."""

    @abstractmethod
    def facts(
        self, query: Query, rows: Ids, known: Sequence[Known], *, is_explained: bool
    ) -> Iterator[dict[str, Any]]:
        """Yield the fields of each answer besides slots, score, part and ranks.

        Args:
            query: the query.
            rows: its answers, ids of shape (n, 3).
            known: the split part of each.
            is_explained: whether to look up evidence, which is slow beside scoring.
        """

    @abstractmethod
    def _repeats_result(self, rows: Ids) -> NDArray[np.bool_]:
        """Mark rows whose result is its own ingredient, shape (n, 3) -> (n,)."""

    def _ids(self, label: str, place: int) -> list[int]:
        """Return the id of the label in a slot, in a list."""
        ids: list[int] = self.model.scorer.entity_ids([label]).tolist()
        return ids

    @property
    def entities(self) -> Sequence[str]:
        """Labels of the entities, by id."""
        return self.model.scorer.entities

    def rows(self, query: Query) -> Ids:
        """Return a query's answers, shape (n, 3): one, or one for each entity in the open slot.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        candidates = np.arange(len(self.entities))
        ids = [
            candidates if label is None else self._ids(label, place)
            for place, label in enumerate(query.slots)
        ]
        # Named entities broadcast along the open slot.
        return np.stack(np.broadcast_arrays(*ids), axis=1).astype(np.int64)

    def labels(self, row: Ids) -> tuple[str, ...]:
        """Return the labels of a row, shape (3,)."""
        return tuple(self.entities[entity] for entity in row.tolist())

    def candidates(self, query: Query, top: int) -> tuple[Ids, torch.Tensor]:
        """Return rows for a query's open slot, shape (n, 3), and their scores.

        ``top`` is the number of answers that will be listed at most.
        """
        rows = self.rows(query)
        return rows, self.scores(rows)

    def best(self, query: Query, top: int, *, new_only: bool = False) -> tuple[Ids, list[float]]:
        """Return the best answers for a query's open slot, best first; equal scores in id order.

        Answers that make their own ingredient are omitted if the book has none, because recipe
        books drop such recipes by default.

        Args:
            query: a query with an open slot.
            top: most answers to return.
            new_only: omit known triples or recipes.

        Returns:
            Rows of ids, shape (n, 3), and their scores.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        rows, scores = self.candidates(query, top)
        # Stable: equal scores keep the order of ids on every device.
        order = torch.sort(scores, descending=True, stable=True).indices.numpy()
        if not self.model.opened.graph.has_self_results:
            order = order[~self._repeats_result(rows[order])]
        if new_only:
            order = order[self.part_numbers(rows[order]) < 0]
        order = order[:top].copy()
        return rows[order], scores[order].tolist()

    def rank(self, query: Query, place: int, row: Ids, score: float) -> int:
        """Return the rank of the entity in a slot of a whole query, among all entities.

        Known answers compete: the rank is unfiltered.

        Args:
            query: a whole query.
            place: place of the slot, 0 to 2.
            row: ids of the query, shape (1, 3).
            score: its score.

        Returns:
            The rank from 1; entities with equal scores share the best rank.
        """
        slots = tuple(None if i == place else label for i, label in enumerate(query.slots))
        rows = self.rows(replace(query, slots=slots))
        scores = self.scores(rows)
        # A score among others may differ in its last bits from the score alone, so that an entity
        # would be ranked behind itself.
        is_competitor = (rows != row).any(axis=1)
        among = score if is_competitor.all() else float(scores[~is_competitor].max())
        return 1 + int((scores[is_competitor] > among).sum())

    def answers(
        self,
        queries: Sequence[Query],
        top: int,
        *,
        new_only: bool = False,
        is_explained: bool = False,
    ) -> Iterator[ScoredAnswer]:
        """Score queries in their order.

        Args:
            queries: whole or open queries.
            top: most answers to a query with an open slot.
            new_only: omit known triples or recipes.
            is_explained: add evidence, and the ranks of a whole query's entities; both are slow
                beside scoring.

        Yields:
            An answer to a whole query, up to ``top`` answers to a query with an open slot.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        # Whole queries are scored in one batch, which is much faster than one by one.
        batch = [self.rows(query) for query in queries if not query.is_open]
        scores = iter(self.scores(np.concatenate(batch)).tolist() if batch else ())
        for query in queries:
            ranks: dict[str, int] = {}
            if query.is_open:
                rows, values = self.best(query, top, new_only=new_only)
            else:
                rows = self.rows(query)
                values = [next(scores)]
                if is_explained:
                    ranks = {
                        query.columns[place]: self.rank(query, place, rows, values[0])
                        for place in query.entity_slots
                    }
            parts = [KNOWN[part] for part in self.part_numbers(rows).tolist()]
            facts = self.facts(query, rows, parts, is_explained=is_explained)
            answers = zip(rows, values, parts, facts, strict=True)
            for place, (row, score, part, fields) in enumerate(answers):
                if new_only and part != "new":
                    continue
                yield ScoredAnswer(
                    slots=dict(zip(query.columns, self.labels(row), strict=True)),
                    score=score,
                    known=part,
                    line=query.line,
                    rank=place + 1 if query.is_open else None,
                    ranks=ranks,
                    **fields,
                )


class LinkScoring(Scoring):
    """Scores of triples: head, relation and tail."""

    def scores(self, rows: Ids) -> torch.Tensor:  # noqa: D102
        return self.model.scorer.score(*torch.from_numpy(rows.copy()).T).cpu()

    def part_numbers(self, rows: Ids) -> Ids:  # noqa: D102
        split = self.model.opened.split
        # New entities are in no recipe.
        is_in_graph = (rows < split.graph.num_entities).all(axis=1)
        parts = np.full(len(rows), -1)
        parts[is_in_graph] = split.part_of(rows[is_in_graph])
        return parts

    def facts(  # noqa: D102
        self, query: Query, rows: Ids, known: Sequence[Known], *, is_explained: bool
    ) -> Iterator[dict[str, Any]]:
        finder = self.outside if is_explained else None
        probabilities = link_probabilities(self.model.scorer, rows, known)
        for row, probability in zip(rows, probabilities, strict=True):
            outside = finder.of_link(*self.labels(row)) if finder else ()
            yield {"probability": probability, "outside": outside}

    def labels(self, row: Ids) -> tuple[str, ...]:  # noqa: D102
        head, relation, tail = row.tolist()
        return self.entities[head], RELATIONS[relation], self.entities[tail]

    def _ids(self, label: str, place: int) -> list[int]:
        return [RELATIONS.index(label)] if place == 1 else super()._ids(label, place)

    def _repeats_result(self, rows: Ids) -> NDArray[np.bool_]:
        return np.asarray((rows[:, 1] == COMPONENT_OF) & (rows[:, 0] == rows[:, 2]))


@dataclass(frozen=True)
class RecipeScoring(Scoring):
    """Scores of recipes: two ingredients and the result.

    Raises:
        ConfigError: if the model scores links (triples) or sets, not pairs.
    """

    def __post_init__(self) -> None:
        if not isinstance(self.scorer, RecipeScorer):
            raise ConfigError(
                f"{self.model.scorer.name} scores no recipes of pairs. Give a link, such as flour "
                "combinesWith water, or train a recipe scorer with `wordcraft-kg train-recipes`; "
                "a model of sets takes each recipe as an argument, a + b + c -> d."
            )

    @property
    def scorer(self) -> RecipeScorer:
        """The recipe scorer; of a cross-fitted one that of all train recipes.

        It answers because queries are about new recipes.
        """
        return cast(RecipeScorer, whole_of(self.model.scorer))

    @cached_property
    def book(self) -> pd.Index:
        """Keys of the book's recipes, in their order."""
        return pd.Index(self._keys(self.model.opened.graph.recipes))

    @cached_property
    def seen(self) -> Ids:
        """Keys of the recipes that the scorer was trained on, ascending."""
        return np.sort(self._keys(self.scorer.recipes.cpu().numpy().astype(np.int64)))

    def _keys(self, rows: Ids) -> Ids:
        """Return a number for each recipe, ids of shape (n, 3), by which recipes are looked up."""
        return recipe_keys(*rows.T, num_entities=len(self.entities))

    def scores(self, rows: Ids) -> torch.Tensor:  # noqa: D102
        return self.scorer.score_recipes(*torch.from_numpy(rows.copy()).T).cpu()

    def part_numbers(self, rows: Ids) -> Ids:  # noqa: D102
        # A key that the book lacks has the index -1.
        places = self.book.get_indexer(pd.Index(self._keys(rows)))
        return np.append(self.model.opened.split.parts, -1)[places]

    def facts(  # noqa: D102
        self, query: Query, rows: Ids, known: Sequence[Known], *, is_explained: bool
    ) -> Iterator[dict[str, Any]]:
        is_seen = are_among(self._keys(rows), self.seen).tolist()
        shares: list[float | None] = [None] * len(rows)
        folds = folds_of(self.model.scorer)
        # Calibrated for results of a pair only: partners of an ingredient compete in another way.
        is_asked = is_explained and query.slots[2] is None
        if is_asked and folds is not None and folds.probabilities is not None:
            shares = folds.result_probabilities(*query.labels)[rows[:, 2]].tolist()
        for row, in_sample, share in zip(rows, is_seen, shares, strict=True):
            fields = {"in_sample": in_sample, "probability": share}
            if is_explained:
                a, b, result = self.labels(row)
                support = self.scorer.supporting_recipes(a, b, result, limit=_SUPPORT)
                fields["because"] = tuple(support)
                fields["outside"] = self.outside.of_recipe(a, b, result) if self.outside else ()
            yield fields

    def candidates(self, query: Query, top: int) -> tuple[Ids, torch.Tensor]:
        """Return rows for a query's open slot, shape (n, 3), and their scores.

        A scorer with a pair encoder, or of a large book, proposes the results of a pair; elsewhere
        all entities are scored.
        """
        scorer = self.scorer
        is_pair = query.slots[2] is None
        if not (is_pair and scorer.proposes_results):
            return super().candidates(query, top)
        a, b = (scorer.entity_ids([label]) for label in query.labels)
        ids, scores = scorer.candidate_results(a, b, max(top, CANDIDATES))
        results = ids[0].cpu()
        # The id E stands for missing results.
        is_answer = results < len(self.entities)
        results = results[is_answer]
        pair = torch.cat([a, b]).cpu().expand(len(results), 2)
        return torch.cat([pair, results[:, None]], dim=1).numpy(), scores[0].cpu()[is_answer]

    def _repeats_result(self, rows: Ids) -> NDArray[np.bool_]:
        return np.asarray((rows[:, :2] == rows[:, 2:]).any(axis=1))


def scoring_of(model: Model, query: Query, outside: OutsideEvidenceFinder | None = None) -> Scoring:
    """Return the scoring for queries of a kind.

    Args:
        model: an opened model.
        query: any query of the kind.
        outside: finder of outside knowledge that supports an answer; None without any.

    Raises:
        ConfigError: if the query is a recipe, and the model scores links (triples) only.
    """
    kind = RecipeScoring if isinstance(query, RecipeQuery) else LinkScoring
    return kind(model, outside)


def with_new_words(
    model: Model, folder: Path, queries: Sequence[Query], file: Path | None = None
) -> Model:
    """Extend a model by the queries' entities that its graph lacks, described by their words alone.

    Args:
        model: the model.
        folder: the model folder.
        queries: the queries.
        file: the file of the queries; None for arguments.

    Returns:
        The extended model, or ``model`` itself if the graph has all entities.

    Raises:
        UnknownEntityError: if no word of an entity has a vector, or the model uses no words; the
            error names the line of a file.
        ArtefactError: if the folder is damaged, or the word vectors have changed.
    """
    entities = frozenset(model.scorer.entities)
    labels = chain.from_iterable(query.labels for query in queries)
    new = tuple(dict.fromkeys(label for label in labels if label not in entities))
    if not new:
        return model
    try:
        scorer = with_words(folder, model.scorer, new)
    except UnknownEntityError as error:
        for query in queries:
            is_meant = any(str(error).startswith(f"no entity '{name}'.") for name in query.labels)
            if is_meant and file is not None:
                raise UnknownEntityError(f"{file}, line {query.line}: {error}") from None
        raise
    return replace(model, scorer=scorer)


def main_support(witnesses: Sequence[Witness]) -> Sequence[Witness]:
    """Return the supporting recipes with at least 1 % weight share, or else the first recipe."""
    return [witness for witness in witnesses if witness.share >= LEAST_SHARE] or witnesses[:1]


def because(witnesses: Sequence[Witness]) -> str:
    """Format supporting recipes with their strengths, as ``river + wood -> driftwood 0.41``."""
    supporting = main_support(witnesses)
    return ", ".join(f"{witness.recipe} {strength(witness)}" for witness in supporting)


def strength(witness: Witness) -> str:
    """Format the evidence of a supporting recipe, relative to the strongest."""
    return "< 0.01" if witness.strength < 0.01 else format(witness.strength, ".2g")


BECAUSE = (
    "similar train recipes, one part of a score: those with the same result first, each by its "
    "strength (1: the strongest)"
)
"""What a list of supporting recipes covers, and its order."""
