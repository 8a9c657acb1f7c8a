"""The score of a triple, or the best entities for an open slot."""

from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.records import Record


class ScoredTriple(Record):
    """A triple's score.

    A raw score means little by itself; its unfiltered rank among all tails and all heads says more.
    """

    head: str
    relation: str
    tail: str
    score: float
    rank_as_tail: int
    rank_as_head: int


class ScoredEntity(Record):
    """An entity in an open slot."""

    entity: str
    score: float


class OpenSlot(Record):
    """The best entities for an open slot, which is written as a question mark."""

    head: str
    relation: str
    tail: str
    top: tuple[ScoredEntity, ...]


OPEN = "?"


def view_triple(scorer: Scorer, head: str, relation: str, tail: str) -> ScoredTriple:
    """Score a triple."""
    tails, heads = (scorer.top(head, relation, None, limit=None), scorer.top(None, relation, tail, limit=None))
    return ScoredTriple(
        head=head,
        relation=relation,
        tail=tail,
        score=float(scorer.score(head, relation, tail)),
        rank_as_tail=1 + [name for name, _ in tails].index(tail),
        rank_as_head=1 + [name for name, _ in heads].index(head),
    )


def view_open_slot(scorer: Scorer, head: str, relation: str, tail: str, top: int) -> OpenSlot:
    """List the best entities for the slot that is :data:`OPEN`."""
    best = scorer.top(None if head == OPEN else head, relation, None if tail == OPEN else tail, limit=top)
    return OpenSlot(head, relation, tail, tuple(ScoredEntity(name, score) for name, score in best))
