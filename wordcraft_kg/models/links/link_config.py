"""Link predictor settings: defaults, units and allowed ranges; imports neither torch nor PyKEEN.

The fields' descriptions are the help of the command line as well. A default that a measurement
chose says where.

The page docs/link-prediction.md explains the choices under *Tuning*.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, Self

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import (
    LARGEST,
    MAX_DIM,
    MAX_SIZE,
    MAX_THREADS,
    check_choices,
    number_in,
    positive,
    require,
    whole,
)
from wordcraft_kg.graphs.graph_folder import KG
from wordcraft_kg.graphs.train_samples import check_train_sample
from wordcraft_kg.runs.config_file import RunConfig

PAPER_DIM = 128
"""Complex dimensions in the paper."""
MAX_SEED = 2**32 - 1
"""PyKEEN's largest seed."""
N3_PARTIAL = 0.1
"""For all but small books; tuned on validation parts, see docs/evidence/links.md#complex."""
FULL_SOFTMAX = 10_000
"""Largest number of entities with a full softmax for ComplEx by default."""
NEGATIVES = 512
"""Sampled entities per batch for larger graphs."""
FOLDS = 5
"""Default number of cross-fitting folds; all models for a split share the same folds."""


@dataclass(frozen=True)
class TrainingConfig:
    """Training settings shared by all link predictors; ``command`` names the training command.

    Attributes:
        kg: training triples: partial (from the train recipes) or full (from all recipes, test
            recipes included).
        train_fraction: fraction of the train recipes for training, sampled with `seed`; nested for
            equal seeds.
        label_noise: fraction of these recipes with the result replaced by another recipe's result.
        epochs: passes over the triples.
        batch_size: triples per step.
        checkpoint_every: epochs between checkpoints.
        folds: number of folds for cross-fitting: for each fold, another model is trained on all
            other train recipes, so that agents learn from out-of-sample scores; 0 disables
            cross-fitting. Default: 5 on the partial graph if large enough, 0 on the full graph.
        seed: root seed for initial parameters, batches, `train_fraction` and `label_noise`.
        device: torch device, such as cpu or cuda.
        threads: CPU threads; 1 is rarely slower for such small models, and much faster on a busy
            machine.

    Raises:
        ConfigError: for a value out of range, or settings that contradict each other.
    """

    command: ClassVar[str]

    kg: KG = "partial"
    train_fraction: float = 1.0
    label_noise: float = 0.0
    epochs: int = 50
    batch_size: int = 512
    checkpoint_every: int = 10
    folds: int | None = None
    seed: int = 0
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        check_choices(self)
        check_train_sample(self.kg, self.train_fraction, self.label_noise)
        # Upper limits keep a mistyped number from filling the memory or the machine.
        limits = {
            "epochs": (1, None),
            "checkpoint_every": (1, None),
            "batch_size": (1, MAX_SIZE),
            "threads": (1, MAX_THREADS),
            "seed": (0, MAX_SEED),
        }
        for name, (low, high) in limits.items():
            whole(name, getattr(self, name), low, high)
        if self.folds is not None:
            whole("folds", self.folds, 0, MAX_SIZE)
            # With a single fold, nothing would be left to train on.
            require(self, "folds", self.folds != 1, "0 to disable, or 2 or more")
        if self.kg == "full" and self.folds:
            raise ConfigError(
                f"`folds` {self.folds} needs `kg` partial: models trained on all recipes have no "
                "out-of-sample scores."
            )

    def for_size(self, num_entities: int) -> Self:
        """Return the settings with defaults that depend on the number of entities."""
        return self


@dataclass(frozen=True)
class ComplExConfig(TrainingConfig):
    """ComplEx with the paper's objective, trained by the ``command`` train-complex.

    Attributes:
        dim: complex dimensions; 128 as in the paper.
        learning_rate: Adagrad learning rate; 0.2 was tuned on validation parts, see
            docs/evidence/links.md#complex.
        n3: weight of the N3 regulariser. Default: 0 on the full graph; on the partial graph, chosen
            together with `popularity` for a small book (2,000 train recipes at most), otherwise
            0.1.
        popularity: weight of log(1 + number of training triples) for head and tail, added to the
            scores. Default: chosen if `n3` is not given and the book is small, or large
            (`negatives` above 0), else 0.
        init_scale: standard deviation of the initial embeddings; 0.001 as in the paper's released
            code.
        negatives: sampled entities per batch in place of all other entities in the softmax; 0 for
            the full softmax. Default: 0 up to 10,000 entities and outside nodes, 512 above, where
            the full softmax would take too long.
        with_: knowledge folders with triples (import-knowledge), for joint training on the graph's
            triples and these.
        outside_weight: weight of an outside triple in the loss, relative to a triple of the graph;
            chosen on validation parts; docs/evidence/outside.md#joint-training has the gain.

    Raises:
        ConfigError: for a value out of range, or settings that contradict each other.

    Example:
        >>> ComplExConfig(kg="full").n3
        0.0
    """

    command: ClassVar[str] = "train-complex"

    dim: int = PAPER_DIM
    learning_rate: float = 0.2
    n3: float | None = None
    popularity: float | None = None
    init_scale: float = 1e-3
    negatives: int | None = None
    with_: tuple[str, ...] = ()
    outside_weight: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("dim", self.dim, 1, MAX_DIM)
        for name in ("learning_rate", "init_scale", "outside_weight"):
            positive(name, getattr(self, name))
        # A given weight fixes the other one too: both are chosen together, or neither.
        if self.n3 is None and (self.kg == "full" or self.popularity is not None):
            object.__setattr__(self, "n3", N3_PARTIAL if self.kg == "partial" else 0.0)
        # The dataclass is frozen, hence object.__setattr__ for defaults that depend on other
        # fields.
        if self.popularity is None and self.n3 is not None:
            object.__setattr__(self, "popularity", 0.0)
        for name in ("n3", "popularity"):
            value = getattr(self, name)
            if value is not None:
                number_in(name, value, 0, LARGEST, "a number, 0 or more")
        if self.negatives is not None:
            whole("negatives", self.negatives, 0, MAX_SIZE)

    def fixed(self) -> Self:
        """Return the settings without a search: the default N3 weight in place of None."""
        return replace(self, n3=N3_PARTIAL) if self.n3 is None else self

    def for_size(self, num_entities: int) -> Self:  # noqa: D102 - inherited
        automatic = NEGATIVES if num_entities > FULL_SOFTMAX else 0
        return self if self.negatives is not None else replace(self, negatives=automatic)


@dataclass(frozen=True)
class LinkModelConfig(TrainingConfig):
    """Any other PyKEEN model, trained by the ``command`` train-links.

    The paper's method works with any link predictor.

    Attributes:
        model: PyKEEN name, such as rotate, transe, distmult, tucker, of a model that needs only
            triples.
        dim: embedding dimensions.
        learning_rate: Adam learning rate.
        loop: training objective: slcwa (sampled negatives) or symmetric (softmax over all heads and
            all tails, the paper's objective; slow for models with large score tensors).
        negatives: sampled negatives per triple, with slcwa.

    Raises:
        ConfigError: for a value out of range, or settings that contradict each other.

    Example:
        >>> LinkModelConfig(model="distmult", loop="symmetric").dim
        128
    """

    command: ClassVar[str] = "train-links"

    model: str = "rotate"
    dim: int = PAPER_DIM
    learning_rate: float = 0.01
    loop: Literal["slcwa", "symmetric"] = "slcwa"
    negatives: int = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, high in (("dim", MAX_DIM), ("negatives", MAX_SIZE)):
            whole(name, getattr(self, name), 1, high)
        positive("learning_rate", self.learning_rate)


LinkSettings = ComplExConfig | LinkModelConfig

CONFIGS: dict[str, type[ComplExConfig] | type[LinkModelConfig]] = {
    config.command: config for config in (ComplExConfig, LinkModelConfig)
}
"""Settings classes by command."""


@dataclass(frozen=True)
class LinksConfig(RunConfig):
    """All settings for a link predictor, as ``config.toml`` holds them.

    Attributes:
        commands: the training commands, by kind of model.
        settings: model and training settings.

    Example:
        >>> LinksConfig("kitchen", ComplExConfig(dim=8)).command
        'train-complex'
    """

    commands: ClassVar[tuple[str, ...]] = tuple(CONFIGS)

    settings: LinkSettings = ComplExConfig()

    @property
    def command(self) -> str:  # noqa: D102 - inherited
        return self.settings.command

    def default_folder(self, graph_name: str) -> Path:  # noqa: D102 - inherited
        parts = [graph_name, self.settings.kg]
        if isinstance(self.settings, LinkModelConfig):
            parts.insert(1, self.settings.model.lower())
        return Path("models") / "-".join(parts)
