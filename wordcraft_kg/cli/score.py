"""``wordcraft-kg score``."""

from pathlib import Path
from typing import Any

from wordcraft_kg.cli.console import Output
from wordcraft_kg.errors import ConfigError

EXAMPLES = (
    'wordcraft-kg score models/everyday "flour" combinesWith "water"',
    'wordcraft-kg score models/everyday "?" componentOf "bread" --top 5',
)
OPEN = "?"


def score(model: Path, head: str, relation: str, tail: str = OPEN, *, top: int = 10, output: Output = Output()) -> None:
    """Score a triple, or list the best entities for an open slot.

    Args:
        model: model folder.
        head: entity, or ? for an open slot.
        relation: combinesWith or componentOf.
        tail: entity, or ? for an open slot.
        top: how many entities to list for an open slot.
    """
    from wordcraft_kg.models.scorers.folder import load_scorer

    if top < 1:
        raise ConfigError(f"--top {top}: expected 1 or more.")
    scorer = load_scorer(model)
    values: dict[str, Any] = {"head": head, "relation": relation, "tail": tail}
    if OPEN not in (head, tail):
        values["score"] = float(scorer.score(head, relation, tail))
        # A raw score means little by itself: its place among all tails and all heads says more.
        tails, heads = (scorer.top(head, relation, None, limit=None), scorer.top(None, relation, tail, limit=None))
        values["rank_as_tail"] = 1 + [name for name, _ in tails].index(tail)
        values["rank_as_head"] = 1 + [name for name, _ in heads].index(head)
        size = len(scorer.entities)
        text = [
            f"{values['score']:.4f}  {head} {relation} {tail}",
            f"place among all {size:,} entities, unfiltered: "
            f"tail {values['rank_as_tail']:,}, head {values['rank_as_head']:,}",
        ]
    elif head == tail:
        raise ConfigError("both slots are open; name the head or the tail.")
    else:
        best = scorer.top(None if head == OPEN else head, relation, None if tail == OPEN else tail, limit=top)
        values["top"] = [{"entity": name, "score": value} for name, value in best]
        text = [
            f"{value:9.4f}  {name if head == OPEN else head} {relation} {name if tail == OPEN else tail}"
            for name, value in best
        ]
    output.result(values, text)
