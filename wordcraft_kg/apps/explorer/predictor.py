"""Queries to a model: scores, ranks and reasons.

A link is a triple; a slot is a query, a triple whose head or tail is open. A link is *true* if a
recipe of the book gives it, in any part of the split, and *learned* if the model was trained on it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.evaluation.scores import KNOWN, Known, link_probabilities
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    PARTS,
    RELATIONS,
    Ids,
    Part,
    Recipe,
    RecipeGraph,
    Relation,
    Split,
)
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.link_evidence import LinkEvidence, LinkReason, Side

NEW = len(PARTS)
"""Part of a triple that no recipe of the book gives."""
Status = Literal["learned", "held out", "not learned", "not in the book", "itself"]
"""``learned`` links are in the model's training data; other links are ``held out``, ``not learned``
(outside the train sample), ``not in the book``, or ``itself`` (not in the book, head and tail are
equal)."""


class PlacedRecipe(Record):
    """A recipe and its split part.

    Attributes:
        recipe: recipe by labels.
        part: split part, such as test.
    """

    recipe: Recipe
    part: Part


class PredictedEntity(Record):
    """An answer to a query, with a model's score for the link that it makes.

    Attributes:
        entity: label of the answer.
        score: higher is more plausible, on the model's own scale.
        status: whether the model was trained on the link, and otherwise whether the link is true.
        known: part of the first recipe that gives the link, or ``new``.
        probability: probability that the link is true; None for training links, since it would be
            that of a link outside the training data, and for models without calibration.
        rank: filtered, realistic rank: other true answers do not compete, and ties share their mean
            rank.
        reason: training links that support the answer; None if they are not computed.
    """

    entity: str
    score: float
    status: Status
    known: Known
    probability: Share | None
    rank: float
    reason: LinkReason | None


class PredictedSlot(Record):
    """The answers to a query, a triple with an unknown head or tail.

    Attributes:
        head: label of the head; None if it is unknown.
        relation: name of the relation.
        tail: label of the tail; None if it is unknown.
        best: answers outside the training data with the highest scores, best first.
        truth: some of the book's answers outside the training data, by rank.
        true_unlearned: number of the book's answers outside the training data.
        true_learned: number of the book's answers inside the training data.
    """

    head: str | None
    relation: Relation
    tail: str | None
    best: tuple[PredictedEntity, ...]
    truth: tuple[PredictedEntity, ...]
    true_unlearned: Count
    true_learned: Count


@dataclass(frozen=True)
class Slot:
    """All E entities as answers to a query, a triple with an open head or tail.

    Attributes:
        entity: id of the given entity.
        relation: id of the relation.
        side: the open side.
        scores: shape (E,), higher is more plausible.
        part: shape (E,), split part of the first recipe that gives the triple, an index in
            :data:`KNOWN`; :data:`NEW` if no recipe of the book gives it.
        learned: shape (E,), True where the model was trained on the triple.
    """

    entity: int
    relation: int
    side: Side
    scores: NDArray[np.float64]
    part: NDArray[np.int64]
    learned: NDArray[np.bool_]

    def triples(self, entities: Ids) -> Ids:
        """Return the triples with these entities as answers, shape (n, 3)."""
        given_ends = np.full(len(entities), self.entity)
        relation = np.full(len(entities), self.relation)
        if self.side == "head":
            return np.column_stack([entities, relation, given_ends])
        return np.column_stack([given_ends, relation, entities])

    def ranks(self, entities: Ids) -> NDArray[np.float64]:
        """Return filtered, realistic ranks, shape (n,) -> (n,), as by ``rank_triples``."""
        # Filtered: only entities without a true link compete. One sort serves all n ranks.
        competes = self.part == NEW
        competitors = np.sort(self.scores[competes])
        scores = self.scores[entities]
        up_to = np.searchsorted(competitors, scores, "right")
        below = np.searchsorted(competitors, scores, "left")
        above = len(competitors) - up_to
        equal = up_to - below
        # An entity without a true link is one of the competitors, and ties with itself: this is no
        # tie.
        is_competitor = competes[entities]
        # Realistic: the mean of the ranks before and after all ties.
        return np.asarray(above + 1 + (equal - is_competitor) / 2)


@dataclass(frozen=True)
class LinkPredictor:
    """A link prediction model that answers queries with ranks and reasons.

    Attributes:
        name: name on the pages.
        folder: folder of the model.
        model: the opened folder.
    """

    name: str
    folder: Path
    model: Model

    @cached_property
    def outside(self) -> OutsideEvidenceFinder | None:
        """Finder for evidence from outside the book; None for a model without such knowledge.

        Raises:
            ArtefactError: if the folder of a model with outside knowledge has been damaged since.
        """
        return OutsideEvidenceFinder.open(self.folder, self.model.opened)

    @cached_property
    def evidence(self) -> LinkEvidence:
        """Training links that support a link.

        Raises:
            ConfigError: if there are too many entities to compare them all.
        """
        # The whole scorer: a fold has not seen its own links, which may be the best reasons.
        return LinkEvidence(whole_of(self.model.scorer), self.model.train_sample.sets)

    @property
    def split(self) -> Split:
        """The training split."""
        return self.model.opened.split

    @property
    def graph(self) -> RecipeGraph:
        """The training graph."""
        return self.model.opened.graph

    @property
    def has_seen_the_test_recipes(self) -> bool:
        """Whether the model was trained on all recipes."""
        return self.model.kg == "full"

    def slot(self, entity: int, relation: int, side: Side) -> Slot:
        """Score all entities as answers to a query.

        Args:
            entity: id of the given entity.
            relation: id of the relation.
            side: the open side; the given entity is on the other one.

        Returns:
            scores of all E entities, with the truth of their triples.

        Raises:
            ConfigError: if there are too many entities to compare them all.
        """
        size = self.graph.num_entities
        # Two dimensions, as in rankings: factors and embeddings use one matrix product.
        everything = torch.arange(size)[None]
        entity_ids = torch.tensor([[entity]])
        ids = (
            (everything, relation, entity_ids)
            if side == "head"
            else (entity_ids, relation, everything)
        )
        with torch.no_grad():
            scores = self.model.scorer.score(*ids)[0].cpu().numpy()
        # Doubles hold the scores of all scorers exactly, whatever their precision.
        scores = scores.astype(np.float64)
        # Columns of a triple: 0 is the head, 2 the tail.
        given_column, answer = (2, 0) if side == "head" else (0, 2)
        triples = self.graph.triples
        is_true = (triples[:, 1] == relation) & (triples[:, given_column] == entity)
        true = triples[is_true]
        part = np.full(size, NEW)
        part[true[:, answer]] = self.split.part_of(true)
        learned = np.zeros(size, dtype=bool)
        learned[self.evidence.ends(entity, relation, side)] = True
        return Slot(entity, relation, side, scores, part, learned)

    def best(
        self,
        slot: Slot,
        *,
        top: int = 10,
        witnesses: int = 1,
        truth: int = 5,
    ) -> PredictedSlot:
        """List the best entities in an open slot outside training, and the best true ones.

        Args:
            slot: scores of all entities.
            top: most entities to list.
            witnesses: most supporting links for each listed entity; 0 computes no reasons.
            truth: most true entities to list.

        Returns:
            both lists; equal scores are in the order of ids.
        """
        order = np.argsort(-slot.scores, kind="stable")
        if slot.relation == COMPONENT_OF and not self.graph.has_self_results:
            # Books drop recipes that make their ingredient.
            order = order[order != slot.entity]
        listed = order[~slot.learned[order]][:top]
        unlearned = np.flatnonzero((slot.part != NEW) & ~slot.learned)
        nearest = unlearned[np.argsort(slot.ranks(unlearned), kind="stable")]
        given_label = self.graph.entities[slot.entity]
        return PredictedSlot(
            head=None if slot.side == "head" else given_label,
            relation=RELATIONS[slot.relation],
            tail=None if slot.side == "tail" else given_label,
            best=tuple(self.answers(slot, listed, witnesses)),
            truth=tuple(self.answers(slot, nearest[:truth], 0)),
            true_unlearned=len(unlearned),
            true_learned=int((slot.learned & (slot.part != NEW)).sum()),
        )

    def answers(self, slot: Slot, entities: Ids, witnesses: int) -> Iterator[PredictedEntity]:
        """Yield entities, ids of shape (n,), as answers in an open slot.

        Args:
            slot: scores of all entities.
            entities: ids of the answers.
            witnesses: most supporting links for each answer; 0 computes no reasons.
        """
        triples = slot.triples(entities)
        ranks = slot.ranks(entities)
        parts = [KNOWN[part] for part in slot.part[entities].tolist()]
        chances = link_probabilities(self.model.scorer, triples, parts)
        rows = zip(triples.tolist(), entities.tolist(), ranks, parts, chances, strict=True)
        for (head, relation, tail), entity, rank, part, chance in rows:
            learned = bool(slot.learned[entity])
            yield PredictedEntity(
                rank=float(rank),
                entity=self.graph.entities[entity],
                score=float(slot.scores[entity]),
                status=status_of(part, learned, is_itself=entity == slot.entity),
                known=part,
                # Calibrated on links outside the training data, so it says nothing about training
                # links.
                probability=None if learned else chance,
                reason=self.evidence.reason(head, relation, tail, witnesses) if witnesses else None,
            )


def recipes_giving(graph: RecipeGraph, head: int, relation: int, tail: int) -> Ids:
    """Return the recipes that give a link.

    Args:
        graph: graph with the recipes.
        head: id of the head.
        relation: id of the relation.
        tail: id of the tail.

    Returns:
        rows of ``graph.sets``, shape (n,), ascending; none for a link that is not in the book.
    """
    if relation != COMBINES_WITH:
        return np.intersect1d(graph.uses_of(head), graph.recipes_of(tail))
    rows = graph.uses_of(head)
    # An entity with itself stands twice in a recipe.
    least = 2 if head == tail else 1
    is_tail = graph.sets[rows, :-1] == tail
    return rows[is_tail.sum(axis=1) >= least]


def placed_recipes(split: Split, rows: Ids) -> tuple[PlacedRecipe, ...]:
    """Return recipes by their rows in the graph, shape (n,), with their parts."""
    recipes = split.graph.recipe_labels(split.graph.sets[rows])
    parts = (PARTS[part] for part in split.parts[rows].tolist())
    return tuple(map(PlacedRecipe, recipes, parts))  # type: ignore[arg-type]


def status_of(known: Known, learned: bool, *, is_itself: bool = False) -> Status:
    """Return a link's status.

    Args:
        known: part of the first recipe that gives the link, or ``new``.
        learned: whether the model was trained on the link.
        is_itself: whether head and tail are the same entity.

    Returns:
        the status. A train link that is not learned is outside the train sample of the model.
    """
    if learned:
        return "learned"
    if known == "new":
        return "itself" if is_itself else "not in the book"
    return "not learned" if known == "train" else "held out"
