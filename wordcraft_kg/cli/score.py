"""``wordcraft-kg score``."""

from pathlib import Path

from wordcraft_kg.cli.console import Output
from wordcraft_kg.errors import ConfigError
from wordcraft_kg.settings import whole

EXAMPLES = (
    'wordcraft-kg score models/everyday "flour" combinesWith "water"',
    'wordcraft-kg score models/everyday "?" componentOf "bread" --top 5',
)


def score(model: Path, head: str, relation: str, tail: str = "?", *, top: int = 10, output: Output = Output()) -> None:
    """Score a triple, or list the best entities for an open slot.

    Args:
        model: model folder.
        head: entity, or ? for an open slot.
        relation: combinesWith or componentOf.
        tail: entity, or ? for an open slot.
        top: number of entities to list for an open slot.
    """
    from wordcraft_kg.models.scorers.folder import load_scorer
    from wordcraft_kg.views.scores import OPEN, view_open_slot, view_triple

    whole("top", top, 1)
    scorer = load_scorer(model)
    if head == tail == OPEN:
        raise ConfigError("both slots are open: name the head or the tail.")
    if OPEN in (head, tail):
        slot = view_open_slot(scorer, head, relation, tail, top)
        found = (
            (best.score, best.entity if head == OPEN else head, best.entity if tail == OPEN else tail)
            for best in slot.top
        )
        output.result(slot, (f"{score:9.4f}  {one} {relation} {other}" for score, one, other in found))
    else:
        triple = view_triple(scorer, head, relation, tail)
        text = [
            f"{triple.score:.4f}  {head} {relation} {tail}",
            f"rank among all {len(scorer.entities):,} entities, unfiltered: "
            f"tail {triple.rank_as_tail:,}, head {triple.rank_as_head:,}",
        ]
        output.result(triple, text)
