"""Settings of recipe scorers: every setting, default and allowed value; imports no torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, get_args

from wordcraft_kg.base.settings import MAX_THREADS, one_of, refuse, require, whole
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.graphs.train_samples import check_train_sample
from wordcraft_kg.runs.config_file import RunConfig


@dataclass(frozen=True)
class RecipeScorerConfig:
    """Settings of a recipe scorer.

    Attributes:
        kg: recipes to learn from: partial (the train recipes) or full (all of them, test recipes included).
        train_fraction: fraction of the train recipes for training, sampled with `seed`; nested for one seed.
        label_noise: fraction of these recipes with the result replaced by the result of another recipe.
        folds: folds that the recipes are cut into: rankers learn on what each fold's recipes look like to the others,
            and on the partial graph there is a scorer for each fold that has not seen it.
        features: vectors of the entities' words: glove, a file of vectors as for agents, or one-hot for none.
        allow_missing: use zeros for entities without a vector, however many there are.
        seed: root seed of the rankers and of what `train_fraction` and `label_noise` draw.
        threads: CPU threads of each fit.

    Example:
        >>> RecipeScorerConfig(folds=10).features
        'glove'
    """

    command: ClassVar[str] = "train-recipes"
    device: ClassVar[str] = "cpu"

    kg: KG = "partial"
    train_fraction: float = 1.0
    label_noise: float = 0.0
    folds: int = 5
    features: str = "glove"
    allow_missing: bool = False
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        one_of("kg", self.kg, get_args(KG))
        check_train_sample(self.kg, self.train_fraction, self.label_noise)
        if isinstance(self.folds, bool) or not isinstance(self.folds, int) or self.folds < 2:
            raise refuse("folds", self.folds, "a whole number, 2 or more: the rankers learn on what is held out")
        require(self, "allow_missing", isinstance(self.allow_missing, bool), "true or false")
        whole("seed", self.seed, 0)
        whole("threads", self.threads, 1, MAX_THREADS)


@dataclass(frozen=True)
class RecipesConfig(RunConfig):
    """All settings of a run of ``train-recipes``.

    Attributes:
        settings: settings of the recipe scorer.

    Example:
        >>> RecipesConfig("kitchen", RecipeScorerConfig(folds=3)).command
        'train-recipes'
    """

    commands: ClassVar[tuple[str, ...]] = (RecipeScorerConfig.command,)

    settings: RecipeScorerConfig = RecipeScorerConfig()

    def default_folder(self, graph_name: str) -> Path:  # noqa: D102 - inherited
        return Path("models") / f"{graph_name}-recipes{'' if self.settings.kg == 'partial' else '-full'}"
