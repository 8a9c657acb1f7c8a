"""Settings of recipe scorers: every setting, default and allowed value; imports no torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, get_args

from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record
from wordcraft_kg.base.settings import MAX_THREADS, one_of, refuse, require, whole
from wordcraft_kg.graphs.doses import check_dose
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.runs.config_file import read_config, write_config


@dataclass(frozen=True)
class RecipesConfig:
    """Settings of a recipe scorer.

    Attributes:
        kg: recipes to learn from: partial (the train recipes) or full (all of them, test recipes included).
        share: share of the train recipes to learn from, drawn with `seed`; those of a smaller share are among those of
            a larger one.
        noise: share of these recipes that get a wrong result, that of another one.
        folds: folds that the recipes are cut into: rankers learn on what each fold's recipes look like to the others,
            and on the partial graph there is a scorer for each fold that has not seen it.
        features: vectors of the entities' words: glove, a file of vectors as for agents, or one-hot for none.
        allow_missing: use zeros for entities without a vector, however many there are.
        seed: root seed of the rankers and of what `share` and `noise` draw.
        threads: CPU threads of each fit.

    Example:
        >>> RecipesConfig(folds=10).features
        'glove'
    """

    command: ClassVar[str] = "train-recipes"
    device: ClassVar[str] = "cpu"

    kg: KG = "partial"
    share: float = 1.0
    noise: float = 0.0
    folds: int = 5
    features: str = "glove"
    allow_missing: bool = False
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        one_of("kg", self.kg, get_args(KG))
        check_dose(self.kg, self.share, self.noise)
        if isinstance(self.folds, bool) or not isinstance(self.folds, int) or self.folds < 2:
            raise refuse("folds", self.folds, "a whole number, 2 or more: the rankers learn on what is held out")
        require(self, "allow_missing", isinstance(self.allow_missing, bool), "true or false")
        whole("seed", self.seed, 0)
        whole("threads", self.threads, 1, MAX_THREADS)


@dataclass(frozen=True)
class RecipeScorerConfig:
    """All settings of a recipe scorer, as ``config.toml`` holds them.

    Attributes:
        graph: graph folder, recipe book's file or known book's name.
        settings: how it is fitted.

    Example:
        >>> RecipeScorerConfig("kitchen", RecipesConfig(folds=3)).command
        'train-recipes'
    """

    graph: str
    settings: RecipesConfig = RecipesConfig()

    @property
    def command(self) -> str:
        """The command that fits with these settings."""
        return self.settings.command

    def default_folder(self, graph_name: str) -> Path:
        """Return where the model goes by default."""
        return Path("models") / f"{graph_name}-recipes{'' if self.settings.kg == 'partial' else '-full'}"

    def values(self) -> dict[str, Any]:
        """Return the settings by option name."""
        return {"graph": self.graph, **vars(self.settings)}

    def write(self, folder: Path) -> None:
        """Write ``config.toml``; the graph's path becomes relative to the folder, so both can be moved."""
        write_config(folder, self.command, self.values())

    @classmethod
    def read(cls, folder: Path) -> "RecipeScorerConfig":
        """Read ``config.toml``.

        Raises:
            ArtefactError: if it is missing or damaged.
        """
        table = read_config(folder)
        if table.command != RecipesConfig.command:
            raise ArtefactError(
                f"{table.path} is damaged: expected [{RecipesConfig.command}], found [{table.command}]."
            )
        inputs, settings = table.take(_Inputs), table.take(RecipesConfig)
        table.close()
        return cls(inputs.graph, settings)


class _Inputs(Record, frozen=True):
    graph: str
