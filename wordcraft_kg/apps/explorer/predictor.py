"""Queries to a model: scores, ranks and reasons."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.evaluation.scores import Known, ScoringModel
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, is_in
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.link_evidence import LinkEvidence, LinkReason
from wordcraft_kg.models.scorers.recipes import RecipeScores
from wordcraft_kg.models.scorers.roles import Side

NEW = len(PARTS)
"""Part of a triple that no recipe of the book gives."""
KNOWN: tuple[Known, ...] = ("train", "valid", "test", "new")
"""Names of the parts by their numbers."""
Status = Literal["learned", "held out", "not learned", "not in the book", "itself"]
"""``learned`` links are in the model's training data; other links are ``held out``, ``not learned`` (outside the
train sample), ``not in the book``, or ``itself`` (not in the book, head and tail are equal)."""


class PlacedRecipe(Record):
    """A recipe and its split part, such as test."""

    ingredient_a: str
    ingredient_b: str
    result: str
    part: Part

    def partner(self, entity: str) -> str:
        """Return the other ingredient, which may be the same entity."""
        return self.ingredient_b if self.ingredient_a == entity else self.ingredient_a


class ScoredLink(Record):
    """A model's score for a link; ``known`` is its first recipe's part or new; training links have no probability."""

    score: float
    status: Status
    known: Known
    probability: Share | None


class PredictedEntity(ScoredLink):
    """A predicted answer to a query; the position in the page's list is 0 for unlisted entities, ties share ranks."""

    entity: str
    position: Count
    rank: float
    reason: LinkReason | None


class PredictedSlot(Record):
    """The answers to a query, a triple with an unknown head or tail (None).

    ``best`` has the highest scores; ``truth`` lists the book's answers outside the training data by rank.
    ``true_unlearned`` and ``true_learned`` count the book's answers outside and inside the training data.
    """

    head: str | None
    relation: Relation
    tail: str | None
    with_learned: bool
    best: tuple[PredictedEntity, ...]
    truth: tuple[PredictedEntity, ...]
    true_unlearned: Count
    true_learned: Count


class FilteredRank(Record):
    """A link's rank among ``candidates``: all answers to a query except other true ones; ties get the mean rank."""

    rank: float
    candidates: Count


class RankedLink(ScoredLink):
    """A scored link with the rank among all entities."""

    rank: FilteredRank


@dataclass(frozen=True)
class Slot:
    """All E entities as answers to a query, a triple with an open head or tail (``side``); arrays have shape (E,).

    ``part`` is the split part of the triple's first recipe, an index in :data:`KNOWN`; ``learned`` marks
    training triples.
    """

    entity: int
    relation: int
    side: Side
    scores: NDArray[np.float64]
    part: NDArray[np.int64]
    learned: NDArray[np.bool_]

    def triples(self, entities: Ids) -> Ids:
        """Return the triples with these entities as answers, shape (n, 3)."""
        given, relation = np.full(len(entities), self.entity), np.full(len(entities), self.relation)
        return np.column_stack(
            [entities, relation, given] if self.side == "head" else [given, relation, entities]
        )

    def ranks(self, entities: Ids) -> NDArray[np.float64]:
        """Return filtered, realistic ranks, shape (n,), as by ``rank_triples``."""
        others = np.sort(self.scores[self.part == NEW])
        of = self.scores[entities]
        above = len(others) - np.searchsorted(others, of, "right")
        equal = np.searchsorted(others, of, "right") - np.searchsorted(others, of, "left")
        # An entity with an untrue link is also a competitor.
        return np.asarray(above + 1 + (equal - (self.part[entities] == NEW)) / 2)

    def rank(self, entity: int) -> FilteredRank:
        """Return an entity's filtered rank."""
        candidates = int((self.part == NEW).sum()) + int(self.part[entity] != NEW)
        return FilteredRank(float(self.ranks(np.array([entity]))[0]), candidates)


@dataclass(frozen=True)
class LinkPredictor:
    """A link prediction model that answers queries with ranks and reasons."""

    name: str
    folder: Path
    model: Model

    @cached_property
    def scoring(self) -> ScoringModel:
        """The model as evaluation uses it: scores, probabilities and known triples."""
        has_outside = self.model.settings.get("with")
        outside = (
            OutsideEvidenceFinder.open(self.folder, self.model.opened) if has_outside else None
        )
        return ScoringModel(self.model.scorer, self.split, self.model.kg, outside=outside)

    @cached_property
    def evidence(self) -> LinkEvidence:
        """Supporting training links; too many entities are a ConfigError."""
        return LinkEvidence(whole_of(self.model.scorer), self.model.train_sample.recipes)

    @property
    def split(self) -> Split:
        """The training split."""
        return self.model.opened.split

    @property
    def graph(self) -> RecipeGraph:
        """The training graph."""
        return self.model.opened.graph

    @property
    def scores_recipes(self) -> bool:
        """Whether the model scores recipes, not only links (triples)."""
        return isinstance(whole_of(self.model.scorer), RecipeScores)

    @property
    def has_seen_the_test_recipes(self) -> bool:
        """Whether the model was trained on all recipes."""
        return self.model.kg == "full"

    def learned(self, triples: Ids) -> NDArray[np.bool_]:
        """Return a mask of training triples, shape (T, 3) -> (T,)."""
        return is_in(triples, self.model.triples, self.graph.num_entities)

    def slot(self, entity: int, relation: int, side: Side) -> Slot:
        """Score all entities as head or tail (``side``) of a triple with the other entity and relation given."""
        size = self.graph.num_entities
        # Two dimensions, as in rankings: factors and embeddings use one matrix product.
        everything, one = torch.arange(size)[None], torch.tensor([[entity]])
        ids = (everything, relation, one) if side == "head" else (one, relation, everything)
        with torch.no_grad():
            scores = self.model.scorer.score(*ids)[0].cpu().numpy().astype(np.float64)
        part = np.full(size, NEW)
        triples, (given, answer) = self.graph.triples, (2, 0) if side == "head" else (0, 2)
        true = triples[(triples[:, 1] == relation) & (triples[:, given] == entity)]
        part[true[:, answer]] = self.split.part_of(true)
        learned = np.zeros(size, dtype=bool)
        learned[self.evidence.ends(entity, relation, side)] = True
        return Slot(entity, relation, side, scores, part, learned)

    def ranked(self, slot: Slot, entity: int) -> RankedLink:
        """Return score and rank for the link with an entity in an open slot."""
        (link,) = self._predicted(
            slot, np.array([entity]), np.zeros(len(slot.scores), dtype=np.int64), 0
        )
        return RankedLink(link.score, link.status, link.known, link.probability, slot.rank(entity))

    def best(
        self,
        slot: Slot,
        *,
        with_learned: bool = False,
        top: int = 10,
        witnesses: int = 1,
        truth: int = 5,
    ) -> PredictedSlot:
        """List the ``top`` entities in an open slot (with ``witnesses`` each), and the best ``truth`` true entities."""
        order = np.argsort(-slot.scores, kind="stable")
        listed = order if with_learned else order[~slot.learned[order]]
        positions = np.zeros(len(order), dtype=np.int64)
        positions[listed] = np.arange(1, len(listed) + 1)
        unlearned = np.flatnonzero((slot.part != NEW) & ~slot.learned)
        nearest = unlearned[np.argsort(slot.ranks(unlearned), kind="stable")]
        given = self.graph.entities[slot.entity]
        return PredictedSlot(
            head=None if slot.side == "head" else given,
            relation=RELATIONS[slot.relation],
            tail=None if slot.side == "tail" else given,
            with_learned=with_learned,
            best=tuple(self._predicted(slot, listed[:top], positions, witnesses)),
            truth=tuple(self._predicted(slot, nearest[:truth], positions, 0)),
            true_unlearned=len(unlearned),
            true_learned=int((slot.learned & (slot.part != NEW)).sum()),
        )

    def _predicted(
        self, slot: Slot, entities: Ids, positions: Ids, witnesses: int
    ) -> Iterator[PredictedEntity]:
        triples, ranks = slot.triples(entities), slot.ranks(entities)
        known = [KNOWN[part] for part in slot.part[entities].tolist()]
        chances = self.scoring.probabilities(triples, known)
        for row, (entity, rank, part, chance) in enumerate(
            zip(entities.tolist(), ranks, known, chances, strict=True)
        ):
            learned = bool(slot.learned[entity])
            head, relation, tail = triples[row].tolist()
            yield PredictedEntity(
                position=int(positions[entity]),
                rank=float(rank),
                entity=self.graph.entities[entity],
                score=float(slot.scores[entity]),
                status=status_of(part, learned, is_itself=entity == slot.entity),
                known=part,
                probability=None if learned else chance,
                reason=self.evidence.reason(head, relation, tail, witnesses) if witnesses else None,
            )


def recipes_giving(graph: RecipeGraph, head: int, relation: int, tail: int) -> Ids:
    """Return ascending recipe rows that give a link."""
    if relation != COMBINES_WITH:
        return np.intersect1d(graph.uses_of(head), graph.recipes_of(tail))
    rows = graph.uses_of(head)
    pairs = graph.recipes[rows, :2]
    return rows[(pairs == sorted((head, tail))).all(axis=1)]


def placed_recipes(split: Split, rows: Ids) -> tuple[PlacedRecipe, ...]:
    """Return recipes by row, with their parts."""
    recipes = split.graph.recipe_labels(split.graph.recipes[rows])
    parts = (PARTS[part] for part in split.parts[rows].tolist())
    return tuple(PlacedRecipe(*recipe, part) for recipe, part in zip(recipes, parts, strict=True))  # type: ignore[arg-type]


def status_of(known: Known, learned: bool, *, is_itself: bool = False) -> Status:
    """Return a link's status from its part, whether it is a training link, and whether its ends are equal."""
    if learned:
        return "learned"
    if known == "new":
        return "itself" if is_itself else "not in the book"
    return "not learned" if known == "train" else "held out"
