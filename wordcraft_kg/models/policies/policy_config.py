"""Policy settings: names, defaults and allowed values.

Imports no torch, so that commands show these settings in ``--help`` at once. The class docstring is
the help text of each option.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

from wordcraft_kg.base import (
    MAX_DIM,
    ConfigError,
    NotRegisteredError,
    check_choices,
    nearest,
    number_in,
    whole,
)
from wordcraft_kg.base.registry import REMEDY, Registry
from wordcraft_kg.models.policies.sources import (
    BUILT_IN,
    SOURCES,
    SPELLED,
    short_name,
    source_names,
    with_letters,
)
from wordcraft_kg.models.scorers.features import Pooling
from wordcraft_kg.models.scorers.score_limits import Scale, SelfEdges

BUILT_IN_POLICIES = ("pairs", "attention", "mlp")
POLICIES: Registry[Callable[[int], Any]] = Registry(
    "wordcraft_kg.policies", reserved=BUILT_IN_POLICIES
)
"""Own networks by name: what makes one for entity vectors of a length, see ``network``."""
Mixing = Literal["softmax", "free", "residual"]


@dataclass(frozen=True)
class PolicyConfig:
    """Settings for a policy and the knowledge mixed in.

    Attributes:
        policy: pairs (a network that scores pairs of items for the goal), attention (self-attention
            over the table, as in the paper), mlp (a hidden layer on the ordered table, the
            paper's baseline; for a fixed table size), or a plugin's. Default: pairs; attention in
            the paper's preset, with ``kg_only`` or another mixing, and for ``make_policy``.
        features: entity vectors: glove, minilm, auto, one-hot (for pairs and attention), random,
            shuffled:<any>, a vector file, or a folder from encode.
        pooling: combines word vectors for labels with several words: mean or max.
        allow_missing: use zeros for entities without a vector, without a limit on the number.
        key_size: query and key dimensions; 300 in the paper.
        value_size: encoding dimensions for the value and for λ; 300 in the paper.
        hidden_size: hidden units in the mlp; 300 in the paper.
        pair_size: hidden units for a pair.
        dropout: share of a pair's hidden units that training drops, the same in all pairs of a
            table; 0.99 at most.
        vector_noise: length of the noise that training adds to entity vectors of length 1, for
            pairs; not to one-hot vectors.
        use: knowledge sources to mix in, comma-separated, by name or by letter: combines or u
            (combinesWith score with the selection), component or v (componentOf score with the
            goal), recipe or w (recipe score with the selection, or without a selection with the
            best partner on the table), plan or p (log-probability of the most probable plan that
            begins with the slot); recipe and plan need a scorer from train-recipes.
        plan_width: most intermediates in the search of the source plan (p); 0 for the default, see
            docs/explanation/planning.md.
        weigh_plans: before training, learn from play on train tasks which plans succeed, and let
            the source plan (p) follow these weights instead of the most probable plan. Default:
            at depth 2, with plan and two attempts, except in the paper's preset; see
            docs/evidence/planning.md#plan-weights.
        kg_only: mix only the sources' scores, without attention logits.
        mixing: range of λ: residual (scores times a learned number each are added to the network's
            logits), free (λ depend on the table, as in the paper), or softmax (positive, sum 1) as
            in the paper's released code. Default: residual for pairs, and for attention with one
            attempt and without recipe and plan, else free, as in the paper's preset. This default
            and those of `scale`, `self_edges` and `value_readout` were chosen on validation tasks.
        scale: common scale for scores before mixing: standardise, ranks, log-softmax or none.
            Default: none where the policy sees attempts, else ranks.
        self_edges: combinesWith scores of self edges: keep (as in the paper), keep only edges
            observed in the scorer's training triples, or drop; a dropped score becomes the mean
            over all pairs.
        in_sample: score train tasks with the model trained on their recipes, as in the paper, even
            if the scorer has out-of-sample models.
        value_readout: slot weights in the encodings for value and λ: softmax of α, or the raw
            logits α, as in the paper's released code.
        sees_attempts: let scores, the value and λ depend on the number of attempts left; not for
            mlp. Default: with several attempts, except in the paper's preset.

    Raises:
        ConfigError: for a value out of range, an unknown source, or settings that need another one.

    Example:
        >>> PolicyConfig(use="component,plan").sources
        ('v', 'p')
    """

    policy: str | None = None
    features: str = "glove"
    pooling: Pooling = "mean"
    allow_missing: bool = False
    key_size: int = 300
    value_size: int = 300
    hidden_size: int = 300
    pair_size: int = 128
    dropout: float = 0.3
    vector_noise: float = 0.5
    use: str = "combines,component"
    plan_width: int = 0
    weigh_plans: bool | None = None
    kg_only: bool = False
    mixing: Mixing | None = None
    scale: Scale | None = None
    self_edges: SelfEdges = "observed"
    in_sample: bool = False
    value_readout: Literal["softmax", "logits"] = "softmax"
    sees_attempts: bool | None = None

    def __post_init__(self) -> None:
        check_choices(self)
        if self.policy is not None:
            POLICIES.check("policy", self.policy)
        for name in ("key_size", "value_size", "hidden_size", "pair_size"):
            whole(name, getattr(self, name), 1, MAX_DIM)
        number_in("vector_noise", self.vector_noise, 0, 100, "0 to 100")
        number_in("dropout", self.dropout, 0, 0.99, "0 to 0.99")
        whole("plan_width", self.plan_width, 0, MAX_DIM)
        if self.sees_attempts and self.policy not in (None, "pairs", "attention"):
            raise ConfigError("`sees_attempts` needs `policy` pairs or attention.")
        # Files of runs and addresses of studies know the short names alone.
        short = ",".join(map(short_name, self._named))
        if short != ",".join(self._named):
            object.__setattr__(self, "use", short)
        # Read whatever `weigh_plans` is: it raises ConfigError for an unknown name.
        sources = self.sources
        if self.weigh_plans and "p" not in sources:
            raise ConfigError("`weigh_plans` needs the source plan (p) in `use`.")

    def closed(
        self,
        *,
        policy: str = "attention",
        sees_attempts: bool = False,
        has_scorer: bool = True,
        mixing: Mixing = "free",
        weigh_plans: bool = False,
    ) -> "PolicyConfig":
        """Return the settings with a value for each that was left open.

        Args:
            policy: value of ``policy`` if it was left open.
            sees_attempts: value of ``sees_attempts`` if it was left open.
            has_scorer: whether there are scores; without, the scale changes nothing.
            mixing: value of ``mixing`` if it was left open, but for pairs and plugins' networks,
                which have residual.
            weigh_plans: value of ``weigh_plans`` if it was left open.
        """
        kind = self.policy or policy
        sees = sees_attempts if self.sees_attempts is None else self.sees_attempts
        form = self.mixing or ("residual" if kind == "pairs" else mixing)
        if kind not in BUILT_IN_POLICIES:
            # A plugin's network has one form, whatever a study sets for all its variants.
            form = "residual"
        return replace(
            self,
            policy=kind,
            sees_attempts=sees,
            scale=self.scale or ("none" if sees and has_scorer else "ranks"),
            mixing=form,
            weigh_plans=weigh_plans if self.weigh_plans is None else self.weigh_plans,
        )

    @property
    def plugins(self) -> dict[str, str]:
        """Hashes of the plugin files that the policy needs, by file name."""
        return POLICIES.plugins(self.policy or "") | SOURCES.plugins(*self.sources)

    @property
    def _named(self) -> list[str]:
        """Names in ``use``, as given."""
        return [source.strip() for source in self.use.split(",")]

    @property
    def sources(self) -> tuple[str, ...]:
        """Short names of the knowledge sources, in mixing order, whatever the order in ``use``.

        Raises:
            ConfigError: for an unknown name, with the nearest known name.
        """
        # The order of λ is fixed, so that "v,u" and "u,v" name the same policy.
        names = self._named
        unknown = [name for name in names if name not in BUILT_IN and name not in SOURCES]
        if unknown:
            labels = source_names()
            hint = nearest(unknown[0], (*SPELLED, *labels))
            raise NotRegisteredError(
                f"`use` {self.use!r}: expected names among {with_letters(labels)}, "
                f"comma-separated; the source '{unknown[0]}' is not registered.{hint} {REMEDY}"
            )
        built_in = [name for name in BUILT_IN if name in names]
        return (*built_in, *sorted({*names} - BUILT_IN.keys()))
