"""Triple scores, also for words outside the graph, and best entities for a query's open slot."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch

from wordcraft_kg.base.errors import ArtefactError, QueryFileError, UnknownEntityError
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.evaluation.queries import Query, RecipeQuery
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.chains import is_half_product, mark_half_products
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.splits import PARTS, Split
from wordcraft_kg.graphs.triples import COMPONENT_OF, RELATIONS
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.recipes.inductive import with_words
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence, OutsideEvidenceFinder
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.scorer import Scorer

Known = Literal["train", "valid", "test", "new"]
"""The split part with a recipe that gives a triple (train takes precedence), or ``new``."""


class ScoredTriple(Record):
    """A triple with its score.

    A raw score means little by itself; the unfiltered ranks among all tails and all heads say more.

    Attributes:
        head: the head.
        relation: the relation.
        tail: the tail.
        score: higher is more plausible, on the scorer's own scale.
        known: split part with the triple, see :data:`Known`; None without the graph.
        rank_as_tail, rank_as_head: rank of tail and head among all entities, from 1.
        trained_on: training graph of the scorer, `full` or `partial`; None if not recorded.
        probability: calibrated probability; None for a train triple and without a calibration.
        by_words: entities outside the graph, scored by their words alone.
        outside: evidence from outside the train recipes.
    """

    head: str
    relation: str
    tail: str
    score: float
    known: Known | None
    rank_as_tail: int
    rank_as_head: int
    trained_on: TrainedOn | None
    probability: Share | None = None
    by_words: tuple[str, ...] = ()
    outside: tuple[OutsideEvidence, ...] = ()


class ScoredEntity(Record):
    """A candidate entity for a query's open slot.

    Attributes:
        entity: the entity.
        score: score of the completed triple.
        known: split part with this triple, see :data:`Known`; None without the graph.
        probability: calibrated probability; None for a train triple and without a calibration.
        outside: evidence from outside the train recipes for this triple.
    """

    entity: str
    score: float
    known: Known | None
    probability: Share | None = None
    outside: tuple[OutsideEvidence, ...] = ()


class OpenSlot(Record):
    """The best entities for a query's open slot.

    Attributes:
        head: the head; None if open.
        relation: the relation.
        tail: the tail; None if open.
        top: the entities, best first.
        trained_on: training graph of the scorer, `full` or `partial`; None if not recorded.
        by_words: entities outside the graph, scored by their words alone.
    """

    head: str | None
    relation: str
    tail: str | None
    top: tuple[ScoredEntity, ...]
    trained_on: TrainedOn | None
    by_words: tuple[str, ...]


class ScoredRow(Record):
    """A row in a file of triple scores.

    Attributes:
        line: line of the query in the queries' file, from 1; 0 for a query from arguments.
        head: the head.
        relation: the relation.
        tail: the tail.
        score: higher is more plausible, on the scorer's own scale.
        rank: rank in the list for an open slot, from 1; None for a full triple.
        known: split part with the triple, see :data:`Known`; None without the graph.
        probability: calibrated probability; None for a train triple and without a calibration.
    """

    line: int
    head: str
    relation: str
    tail: str
    score: float
    rank: int | None
    known: Known | None
    probability: Share | None = None


class ScoredFile(Record, omit_defaults=True):
    """Scores for all queries in a file.

    Attributes:
        queries: number of queries.
        scored: number of rows.
        trained_on: training graph of the scorer, `full` or `partial`; None if not recorded.
        by_words: entities outside the graph, scored by their words alone.
        rows: the scores; empty if they were written to a file.
        out: the written file; None without one.
    """

    queries: Count
    scored: Count
    trained_on: TrainedOn | None
    by_words: tuple[str, ...] = ()
    rows: tuple[Record, ...] = ()
    out: str | None = None


@dataclass(frozen=True)
class ScoringModel:
    """A scorer and, if the scorer's graph is available, the recipe split.

    Attributes:
        scorer: the scorer.
        split: split of the scorer's graph; None without the graph.
        kg: recipes that the scorer was trained on, ``full`` or ``partial``; None if not recorded.
        missing: why the graph is not available, or empty.
        by_words: labels for entities outside the graph, the scorer's last entities, see
            :func:`with_new_words`.
        outside: finder for evidence from outside the train recipes; None without such knowledge or
            without the graph.
    """

    scorer: Scorer
    split: Split | None
    kg: TrainedOn | None
    missing: str = ""
    by_words: tuple[str, ...] = ()
    outside: OutsideEvidenceFinder | None = None

    @classmethod
    def open(
        cls, folder: Path, graph: str | None = None, *, needs_graph: bool = False
    ) -> "ScoringModel":
        """Open a model folder, without its graph if that is missing and not needed.

        Args:
            folder: the model folder.
            graph: the graph, if it has moved; None for the recorded one.
            needs_graph: whether a missing graph is an error.

        Returns:
            The scorer, with the split if the graph is available.

        Raises:
            ArtefactError: if there is no scorer, or if the graph is missing and ``graph`` or
                ``needs_graph`` is given.
        """
        try:
            model = open_model(folder, graph)
        except ArtefactError as error:
            if graph is not None or needs_graph:
                raise
            # Scores need no graph; only parts of the split are missing then.
            return cls(load_scorer(folder), None, None, str(error))
        # Only a model that was trained with outside knowledge has evidence from there.
        outside = OutsideEvidenceFinder.open(folder, model.opened)
        return cls(model.scorer, model.opened.split, model.kg, outside=outside)

    @property
    def proposes_self_results(self) -> bool:
        """Whether an entity may be proposed for itself: if the graph has such a recipe."""
        return self.split is not None and self.split.graph.has_self_results

    def known(self, triples: Ids) -> list[Known | None]:
        """Return the split part of each triple, ids of shape (T, 3), see :data:`Known`.

        Without the graph, all parts are None.
        """
        if self.split is None:
            return [None] * len(triples)
        # In the order of the split's part numbers.
        names: tuple[Known, ...] = (*PARTS, "new")  # type: ignore[assignment]
        # New entities are in no recipe: index -1 is "new".
        is_in_graph = (triples < self.split.graph.num_entities).all(axis=1)
        part = np.full(len(triples), -1)
        part[is_in_graph] = self.split.part_of(triples[is_in_graph])
        return [names[number] for number in part.tolist()]

    def probabilities(self, triples: Ids, known: Sequence[Known | None]) -> list[float | None]:
        """Return calibrated probabilities for triples, ids of shape (T, 3).

        A triple that is ``known`` from train has None: it is true, and calibration is for new ones.
        All are None without a calibration.
        """
        folds = folds_of(self.scorer)
        if folds is None or folds.probabilities is None:
            return [None] * len(triples)
        values = folds.probability(*torch.from_numpy(triples.copy()).T).tolist()
        pairs = zip(values, known, strict=True)
        return [None if part == "train" else value for value, part in pairs]

    def answers(self, query: Query, top: int, *, new_only: bool = False) -> list[ScoredEntity]:
        """List the best entities for a query's open slot.

        Args:
            query: a query with an open slot.
            top: most entities to list.
            new_only: omit known triples; only with a graph, as without one no triple counts as new
                and the list is empty.

        Returns:
            The entities, best first; equal scores in id order.

        Raises:
            UnknownEntityError: for an entity that the scorer does not know.
        """
        everything = torch.arange(len(self.scorer.entities))
        head = everything if query.head is None else query.head
        tail = everything if query.tail is None else query.tail
        scores = self.scorer.score(head, query.relation, tail).cpu()
        order = torch.sort(scores, descending=True, stable=True).indices.numpy()
        # Half-products of chains are no things of the game, and no answers.
        order = order[~mark_half_products(self.scorer.entities)[order]]
        if query.relation == RELATIONS[COMPONENT_OF] and not self.proposes_self_results:
            (named,) = (label for label in (query.head, query.tail) if label is not None)
            order = order[order != int(self.scorer.entity_ids(named))]
        # Without a filter the first ones are the answer, and parts of all others need no look-up.
        if not new_only:
            order = order[:top]
        heads = order if query.head is None else int(self.scorer.entity_ids(query.head))
        tails = order if query.tail is None else int(self.scorer.entity_ids(query.tail))
        triples = _triples(heads, RELATIONS.index(query.relation), tails)
        parts = self.known(triples)
        chances = self.probabilities(triples, parts)
        places = [i for i in range(len(order)) if not new_only or parts[i] == "new"]
        best = []
        for i in places[:top]:
            entity = int(order[i])
            candidate = ScoredEntity(
                entity=self.scorer.entities[entity],
                score=float(scores[entity]),
                known=parts[i],
                probability=chances[i],
            )
            best.append(candidate)
        return best


def _triples(heads: Ids | int, relation: int | Ids, tails: Ids | int) -> Ids:
    columns = np.broadcast_arrays(np.atleast_1d(heads), relation, tails)
    return np.stack(columns, axis=1).astype(np.int64)


def view_triple(model: ScoringModel, query: Query) -> ScoredTriple:
    """Score a triple, and rank its head and its tail among all entities.

    Raises:
        UnknownEntityError: for an entity that the scorer does not know.
    """
    scorer = model.scorer
    head, relation, tail = _labels(query)
    ((_, part, probability),) = _scores(model, [(head, relation, tail)])
    # Whole lists: the rank is the place, known triples included.
    tails = _ranked_names(scorer.top(head, relation, None, limit=None), tail)
    heads = _ranked_names(scorer.top(None, relation, tail, limit=None), head)
    return ScoredTriple(
        head=head,
        relation=relation,
        tail=tail,
        score=float(scorer.score(head, relation, tail)),
        known=part,
        rank_as_tail=1 + tails.index(tail),
        rank_as_head=1 + heads.index(head),
        trained_on=model.kg,
        probability=probability,
        by_words=model.by_words,
        outside=model.outside.of_link(head, relation, tail) if model.outside else (),
    )


def _ranked_names(answers: Sequence[tuple[str, float]], given: str) -> list[str]:
    """Return the names of answers without half-products, but for a given one."""
    return [name for name, _ in answers if name == given or not is_half_product(name)]


def view_open_slot(
    model: ScoringModel, query: Query, top: int, *, new_only: bool = False
) -> OpenSlot:
    """List the best entities for a query's open slot, with evidence from outside the train recipes.

    Args:
        model: the model.
        query: a query with an open slot.
        top: most entities to list.
        new_only: omit known triples.

    Returns:
        The entities, best first.

    Raises:
        UnknownEntityError: for an entity that the scorer does not know.
    """
    best = model.answers(query, top, new_only=new_only)
    # Evidence only for the listed entities: looking it up is slow beside scoring.
    if model.outside:
        for i, entity in enumerate(best):
            head = query.head or entity.entity
            tail = query.tail or entity.entity
            outside = model.outside.of_link(head, query.relation, tail)
            best[i] = msgspec.structs.replace(entity, outside=outside)
    return OpenSlot(query.head, query.relation, query.tail, tuple(best), model.kg, model.by_words)


def score_queries(
    model: ScoringModel, queries: Sequence[Query], top: int, *, new_only: bool = False
) -> Iterator[ScoredRow]:
    """Score queries in their order.

    Args:
        model: the model.
        queries: triples with or without an open slot.
        top: most rows for a query with an open slot.
        new_only: omit known triples.

    Yields:
        A row for a full triple, up to ``top`` rows for a query with an open slot.

    Raises:
        UnknownEntityError: for an entity that the scorer does not know.
    """
    # Full triples are scored in one batch, which is much faster than one by one.
    scores = iter(_scores(model, [_labels(query) for query in queries if not query.is_open]))
    for query in queries:
        line = query.line or 0
        if not query.is_open:
            score, part, chance = next(scores)
            if not new_only or part == "new":
                head, relation, tail = _labels(query)
                yield ScoredRow(line, head, relation, tail, score, None, part, chance)
            continue
        for rank, best in enumerate(model.answers(query, top, new_only=new_only), start=1):
            yield ScoredRow(
                line=line,
                head=query.head or best.entity,
                relation=query.relation,
                tail=query.tail or best.entity,
                score=best.score,
                rank=rank,
                known=best.known,
                probability=best.probability,
            )


def _scores(
    model: ScoringModel, triples: Sequence[tuple[str, str, str]]
) -> list[tuple[float, Known | None, float | None]]:
    if not triples:
        return []
    head, relation, tail = zip(*triples, strict=True)
    heads = model.scorer.entity_ids(head)
    tails = model.scorer.entity_ids(tail)
    relations = torch.tensor([RELATIONS.index(label) for label in relation])
    ids = _triples(heads.cpu().numpy(), relations.numpy(), tails.cpu().numpy())
    parts = model.known(ids)
    chances = model.probabilities(ids, parts)
    scores = model.scorer.score(heads, relations, tails).tolist()
    return list(zip(scores, parts, chances, strict=True))


def view_file(
    model: ScoringModel,
    queries: Sequence[Query | RecipeQuery],
    rows: Sequence[Record],
    out: Path | None = None,
) -> ScoredFile:
    """Return the scores for a file of queries as a record.

    Args:
        model: the model.
        queries: the queries.
        rows: the scores.
        out: the file with the scores, named in place of the rows; None to return the rows.

    Returns:
        The record to show.
    """
    # Recipe scores always use words.
    by_words = model.by_words if any(isinstance(query, Query) for query in queries) else ()
    view = ScoredFile(len(queries), len(rows), model.kg, by_words, tuple(rows))
    return view if out is None else msgspec.structs.replace(view, rows=(), out=str(out))


def _labels(query: Query) -> tuple[str, str, str]:
    assert query.head is not None
    assert query.tail is not None
    return query.head, query.relation, query.tail


def with_new_words(
    model: ScoringModel,
    folder: Path,
    queries: Sequence[Query | RecipeQuery],
    file: Path | None = None,
) -> ScoringModel:
    """Extend a model by the queries' entities that its graph lacks, described by their words alone.

    Args:
        model: the model.
        folder: the model folder.
        queries: the queries.
        file: file of the queries; None for arguments.

    Returns:
        The extended model, or ``model`` itself if the graph has all entities.

    Raises:
        UnknownEntityError: if no word of an entity has a vector, or the model uses no words.
        QueryFileError: the same for queries of a file, with the line of the first such entity.
        ArtefactError: if the folder is damaged, or the word vectors have changed.
    """
    # In the order of the queries, with the line where each new entity first stands.
    lines: dict[str, int | None] = {}
    entities = frozenset(model.scorer.entities)
    for query in queries:
        for label in query.labels:
            if label not in entities:
                lines.setdefault(label, query.line)
    if not lines:
        return model

    def where(label: str) -> str:
        return "" if file is None else f"{file}, line {lines[label]}: "

    try:
        scorer = with_words(folder, model.scorer, tuple(lines), where=where)
    except UnknownEntityError as error:
        # An error in a file is an error of the file, with its line.
        if file is None:
            raise
        raise QueryFileError(str(error)) from None
    return replace(model, scorer=scorer, by_words=tuple(lines))


# A file of queries may name thousands of new entities; a few show what happened.
_LISTED = 5


def note_of_words(model: ScoringModel) -> list[str]:
    """Return a note on new entities in queries, scored by their words; empty without any."""
    words = model.by_words
    if not words:
        return []
    # A single new entity may be a misspelling that has a vector, too: the nearest label helps then.
    if len(words) == 1:
        entities = model.scorer.entities[: -len(words)]
        return [
            f"'{words[0]}' is not in the graph: scored by its words alone."
            f"{nearest(words[0], entities)}"
        ]
    listed = ", ".join(f"'{label}'" for label in words[:_LISTED])
    rest = f" and {len(words) - _LISTED:,} more" if len(words) > _LISTED else ""
    return [f"{listed}{rest} are not in the graph: scored by their words alone."]
