"""Recipe scorer settings: defaults and allowed values; imports no torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, get_args

from wordcraft_kg.base.settings import MAX_THREADS, one_of, require, whole
from wordcraft_kg.graphs.graph_folder import TrainedOn
from wordcraft_kg.graphs.train_samples import check_train_sample
from wordcraft_kg.runs.config_file import RunConfig

ENCODER_FROM = 20_000
"""Training recipes from which a scorer has a pair encoder.

Infinite Craft gains .020 with 8 distractors from as few as 10,000 of its recipes; built-in books
have at most 6,510, and keep their results.
"""
ENCODER_UP_TO = 1_000_000
"""Most training recipes with which a scorer has a pair encoder.

An encoder takes some nine CPU minutes for a million recipes, and five folds need six encoders.
"""


@dataclass(frozen=True)
class RecipeScorerConfig:
    """Settings for a recipe scorer, as options of the command ``train-recipes``.

    Fits use no other device than the CPU, but for the pair encoder.

    Attributes:
        kg: training recipes: partial (the train recipes), full (all recipes, test recipes
            included), or none (only outside knowledge: zero-shot from other books, or tables
            alone).
        train_fraction: fraction of the train recipes for training, sampled with `seed`; nested for
            equal seeds.
        label_noise: fraction of these recipes with the result replaced by another recipe's result.
        folds: number of folds: the rankers learn to predict each fold from the remaining folds, and
            on the partial graph a scorer without each fold gives out-of-sample scores.
        features: vectors of entity labels: minilm (a sentence encoder's, for the labels of built-in
            books), glove, auto (minilm if all labels have such a vector, else glove), a vector file
            as for agents, a folder from encode, or one-hot to use no words.
        allow_missing: use zeros for any number of entities without a vector.
        with_: knowledge from outside the train recipes: knowledge folders (elicit,
            import-knowledge), and other books or graph folders of any size.
            For graphs with at most 5,792 entities.
        without: books or graph folders whose recipes are left out of the training, so that the
            scorer can be tested on these books; needs `kg` full, and no `with`.
        seed: root seed for rankers, pair encoder, `train_fraction` and `label_noise`.
        threads: CPU threads per fit.
        device: torch device for the pair encoder of large books, such as cpu or cuda.
        parts: parts of entities, for a model of sets: a table with the columns label, part and
            amount, formulas to read chemical formulas, or none. A book of larger sets than pairs
            trains such a model also without; it needs no words if there are parts.

    Raises:
        ConfigError: for a value out of range, or settings that contradict each other.

    Example:
        >>> RecipeScorerConfig(folds=10).features
        'auto'
    """

    command: ClassVar[str] = "train-recipes"

    kg: TrainedOn = "partial"
    train_fraction: float = 1.0
    label_noise: float = 0.0
    folds: int = 5
    features: str = "auto"
    allow_missing: bool = False
    with_: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    seed: int = 0
    threads: int = 1
    device: str = "cpu"
    parts: str | None = None

    def __post_init__(self) -> None:
        one_of("kg", self.kg, get_args(TrainedOn))
        check_train_sample(self.kg, self.train_fraction, self.label_noise)
        # The rankers learn on held-out folds.
        whole("folds", self.folds, 2)
        require(self, "allow_missing", isinstance(self.allow_missing, bool), "true or false")
        is_apart = not self.without or (self.kg == "full" and not self.with_)
        require(self, "without", is_apart, "empty unless `kg` is full and `with` is empty")
        whole("seed", self.seed, 0)
        whole("threads", self.threads, 1, MAX_THREADS)

    def has_encoder(self, num_recipes: int) -> bool:
        """Return whether a scorer of so many training recipes has a pair encoder."""
        # Outside knowledge is tables of all pairs: the two are for books of other sizes.
        return ENCODER_FROM <= num_recipes <= ENCODER_UP_TO and not self.with_ and self.kg != "none"

    def has_encoder_of_others(self, num_recipes: int) -> bool:
        """Return whether other books of so many recipes give a scorer a pair encoder."""
        return self.kg != "none" and num_recipes >= ENCODER_FROM


@dataclass(frozen=True)
class RecipesConfig(RunConfig):
    """All settings for ``train-recipes``.

    Attributes:
        commands: the training command.
        settings: recipe scorer settings.

    Example:
        >>> RecipesConfig("kitchen", RecipeScorerConfig(folds=3)).command
        'train-recipes'
    """

    commands: ClassVar[tuple[str, ...]] = (RecipeScorerConfig.command,)

    settings: RecipeScorerConfig = RecipeScorerConfig()

    def default_folder(self, graph_name: str) -> Path:  # noqa: D102 - inherited
        kg = self.settings.kg
        # Models of the partial graph are the usual case.
        suffix = "" if kg == "partial" else f"-{kg}"
        return Path("models") / f"{graph_name}-recipes{suffix}"
