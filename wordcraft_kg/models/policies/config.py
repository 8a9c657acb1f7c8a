"""Settings of policies; imports no torch."""

from dataclasses import dataclass
from typing import Literal, get_args

from wordcraft_kg.base.settings import MAX_DIM, nearest, one_of, refuse, require, whole
from wordcraft_kg.models.policies.sources import source_names
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.features import Pooling

PolicyKind = Literal["attention", "mlp"]
Mixing = Literal["softmax", "free"]
_ValueReadout = Literal["softmax", "logits"]


@dataclass(frozen=True)
class PolicyConfig:
    """Settings of a policy and of the knowledge that it uses.

    Attributes:
        policy: attention (self-attention over the table, the paper's) or mlp (one hidden layer on everything on the
            table in its order, the paper's baseline; for one size of table only).
        features: entity vectors: glove, one-hot, random, learned, shuffled:<any but learned>, or a file of vectors.
        pooling: how a label of several words gets its vector: mean or max over the words.
        allow_missing: use zeros for entities without a vector, however many there are.
        key_size: dimensions of queries and keys; 300 is the paper's.
        value_size: dimensions of the encodings for the value and for λ; 300 is the paper's.
        hidden_size: hidden units of the mlp; 300 is the paper's.
        embedding_size: dimensions of learned features; by default as many as GloVe has.
        use: sources of knowledge to mix in, comma-separated: u (the scorer's combinesWith with the held entity), v (its
            componentOf with the goal), w (its score of the recipe with the held entity, or the best on the table; of
            scorers of train-recipes and elicit).
        kg_only: mix only the sources' scores, without the attention's own logits.
        mixing: range of λ: free, or softmax (positive, sum 1) as in the paper's released code. This and the next three
            were chosen on validation tasks, see docs/agents.md.
        scale: brings scores to one scale before mixing: standardise, ranks, log-softmax or none.
        self_edges: an entity's combinesWith score with itself: keep it (the paper), keep only those observed in the
            scorer's training triples, or drop it; a dropped score becomes the mean of all pairs.
        in_sample: score train tasks by the model that has been trained on them, as the paper does, even if the scorer
            has one that has not.
        value_readout: weights of the slots in the encodings of value and λ: softmax of α, or the raw logits α, as in
            the paper's released code.

    Example:
        >>> PolicyConfig(use="v").sources
        ('v',)
    """

    policy: PolicyKind = "attention"
    features: str = "glove"
    pooling: Pooling = "mean"
    allow_missing: bool = False
    key_size: int = 300
    value_size: int = 300
    hidden_size: int = 300
    embedding_size: int = 50
    use: str = "u,v"
    kg_only: bool = False
    mixing: Mixing = "free"
    scale: Scale = "ranks"
    self_edges: SelfEdges = "observed"
    in_sample: bool = False
    value_readout: _ValueReadout = "softmax"

    def __post_init__(self) -> None:
        for name in ("policy", "pooling", "mixing", "scale", "self_edges", "value_readout"):
            one_of(name, getattr(self, name), get_args(PolicyConfig.__annotations__[name]))
        for name in ("key_size", "value_size", "hidden_size", "embedding_size"):
            whole(name, getattr(self, name), 1, MAX_DIM)
        for name in ("allow_missing", "kg_only", "in_sample"):
            require(self, name, isinstance(getattr(self, name), bool), "true or false")
        _ = self.sources

    @property
    def sources(self) -> tuple[str, ...]:
        """Sources in use, in mixing order."""
        asked = [source.strip() for source in self.use.split(",")]
        known = source_names()
        unknown = [source for source in asked if source not in known]
        if unknown:
            hint = nearest(unknown[0], known)
            raise refuse("use", self.use, f"one or more of {', '.join(known)}, comma-separated", hint)
        return tuple(source for source in known if source in asked)
