"""A study, an experiment as data.

It has variants (named agent settings), a grid with further settings, and seeds.

A study is a TOML file; ``builtin/`` has the package's studies, including the paper's figures. Every
setting is an option in ``build-graph`` (``book``, ``split``, ``split_seed``, ``train_ratio``,
``valid_ratio``), ``train-agent`` or a training command for scorers.
"""

import math
import tomllib
from collections.abc import Collection, Iterable
from dataclasses import fields
from importlib.resources import files
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from wordcraft_kg.agents.agent_config import ImpalaConfig, TaskConfig
from wordcraft_kg.base import (
    ConfigError,
    Record,
    nearest,
    one_of,
    read_small_file,
    refuse,
    whole,
)
from wordcraft_kg.models.links.link_config import CONFIGS
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.recipes.recipe_config import RecipeScorerConfig

Value = str | int | float | bool
Values = dict[str, Value]
"""The picture to draw: success by training step, or each variant's final success."""

Expected = Literal["more", "less", "comparable", "varies"]
Measure = Literal["success", "early", "steps", "same_twice"]

BUILT_IN = files("wordcraft_kg.studies") / "builtin"
OF_GRAPH = {
    "book": "book",
    "split": "kind",
    "split_seed": "seed",
    "train_ratio": "train_ratio",
    "valid_ratio": "valid_ratio",
}
"""Graph settings by option: ``book``, and :class:`SplitConfig` fields."""
PARTS_OF_AGENT = {"tasks": TaskConfig, "policy": PolicyConfig, "trainer": ImpalaConfig}
"""Configuration classes by part of an agent's settings."""
OF_AGENT = frozenset(field.name for kind in PARTS_OF_AGENT.values() for field in fields(kind))
"""Options of an agent."""
SCORER = "scorer"
"""The setting that names a scorer in the study; ``scorer.epochs`` is a setting for that scorer."""
TRAINED_SCORERS = {**CONFIGS, RecipeScorerConfig.command: RecipeScorerConfig}
"""Configuration class by command that trains a scorer."""
SCORER_SETTINGS: dict[str, frozenset[str]] = {}
"""Allowed settings of a scorer by its command."""
for _command, _kind in TRAINED_SCORERS.items():
    _names = {field.name for field in fields(_kind)}
    # A study keeps finished scorers only, so the distance of checkpoints changes nothing.
    SCORER_SETTINGS[_command] = frozenset(_names - {"checkpoint_every"})
PLAYER = "player"
"""The setting of a variant that names a player without training, in place of an agent."""
PLAYERS = ("random pair", "nearest words", "best pair", "planner")
"""Players without training: chance, words, and a recipe scorer alone, without or with plans."""
PLAYERS_WITH_SCORER = PLAYERS[2:]
NO_SETTINGS = ("seed", "checkpoint_every")
"""Options that are set by the study or change no result."""


class Claim(Record, frozen=True, omit_defaults=True):
    """A testable claim that compares two variants, or a variant and a value.

    Attributes:
        text: the claim in a sentence.
        left: name of the first variant.
        right: name of the second variant, or empty.
        expected: ``left`` has more or less than ``right``; comparable (difference below ``by``); or
            varies (``left`` is better for some grid settings, ``right`` for different settings).
        than: the value that ``left`` is compared with instead of a variant; None with ``right``.
        by: least difference for more and less, greatest difference for comparable, in the measure's
            unit.
        measure: success: final success on test tasks; early: success after a tenth of the steps;
            steps: environment steps until the learning curve reaches 95 % of the final success of
            ``right``, as a share of all steps; same_twice: share of test episodes that end with an
            entity paired with itself without making the goal.
        at: grid settings for which the claim holds, with values; empty for the whole grid.
        right_at: grid settings in which ``right`` differs from ``left``, with values.
        source: publication and place of the claim.
        note: known reason for a deviation, shown if the results contradict the claim.
    """

    text: str
    left: str
    right: str = ""
    than: float | None = None
    expected: Expected = "more"
    by: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    measure: Measure = "success"
    at: Values = msgspec.field(default_factory=dict)
    right_at: Values = msgspec.field(default_factory=dict)
    source: str = ""
    note: str = ""


class Range(Record, frozen=True):
    """Values to search: between two numbers, whole ones if both are.

    Attributes:
        low, high: the ends, which belong to it.
        log: whether small numbers are tried as densely as large ones.
    """

    low: int | float
    high: int | float
    log: bool = False

    def __post_init__(self) -> None:
        is_finite = -math.inf < self.low < self.high < math.inf
        if not is_finite or (self.log and self.low <= 0):
            raise ValueError(f"a range from {self.low} to {self.high} has no values to search")


class Study(Record, omit_defaults=True):
    """A study file's content.

    It has variants (named agent settings), each trained for all grid settings and seeds.

    Attributes:
        title: what is compared, in a line.
        variants: training settings by variant name.
        about: question of the study, and how to read its results.
        source: publication and place of the comparison, such as a figure of the paper.
        seeds: trainings per variant and grid point, with seeds from 0; scorers without a seed use
            the agent's seed.
        vary_split: whether each training also has its own split, with the training's seed as
            ``split_seed``, so that means and intervals are about splits of the book.
        drawing: kind of picture.
        reference: the variant that all variants are compared with. Default: the first.
        settings: settings of all trainings; variants and the grid override them.
        grid: values by setting; each combination of values is a grid point.
        scorers: settings by scorer name, with ``command``: train-complex, train-links or
            train-recipes.
        claims: expected results, compared with the results in the report.
        search: settings to search over, for ``reproduce --search``: a list of values or a
            :class:`Range` each.
        trials: trials of a search.

    Example:
        >>> variants = {"attention": {}, "mlp": {"policy": "mlp"}}
        >>> study = Study("Two policies", variants, grid={"distractors": [1, 8]})
        >>> len(study.variants) * len(study.grid["distractors"]) * study.seeds
        20
    """

    title: str
    variants: dict[str, Values]
    about: str = ""
    source: str = ""
    seeds: int = 5
    vary_split: bool = False
    drawing: Literal["curves", "bars"] = "curves"
    reference: str = ""
    settings: Values = msgspec.field(default_factory=dict)
    grid: dict[str, list[Value]] = msgspec.field(default_factory=dict)
    scorers: dict[str, Values] = msgspec.field(default_factory=dict)
    claims: list[Claim] = msgspec.field(default_factory=list)
    search: dict[str, list[Value] | Range] = msgspec.field(default_factory=dict)
    trials: int = 20


class StudyCell(Record, frozen=True):
    """One training in a study.

    Attributes:
        variant: name of the variant.
        values: grid settings.
        seed: seed of the agent, and of its scorer unless the scorer's settings name one.
        settings: all settings given in the study file; those of the grid override the study's, and
            those of the variant both.
    """

    variant: str
    values: Values
    seed: int
    settings: Values


def built_in() -> list[str]:
    """Return the built-in studies' names."""
    names = [path.name for path in BUILT_IN.iterdir()]
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def read_study(source: str | Path) -> Study:
    """Read a study from a TOML file, or a built-in study by name.

    Everything is checked except the recipe books.

    Raises:
        ConfigError: if there is no such study, its file is not TOML in UTF-8, or a setting is
            unknown, wrong or contradictory.
        ArtefactError: if the file is too large for a study.

    Example:
        >>> read_study("knowledge").drawing
        'curves'
    """
    if str(source) in built_in():
        return parse_study((BUILT_IN / f"{source}.toml").read_text(encoding="utf-8"), str(source))
    path = Path(source)
    if not path.is_file():
        raise ConfigError(
            f"'{source}': no such file or built-in study; expected {', '.join(built_in())}."
            f"{nearest(str(source), built_in())}"
        )
    try:
        return parse_study(read_small_file(path).decode(), str(source))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{source}: not UTF-8 ({error.reason}).") from None


def parse_study(text: str, source: str) -> Study:
    """Parse and check the TOML text of a study.

    Args:
        text: the TOML text.
        source: name of the text, for errors.

    Raises:
        ConfigError: if the text is not TOML, or a setting is unknown, wrong or contradictory.
    """
    try:
        values = tomllib.loads(text)
        _check_names("", values, Study.__struct_fields__)
        study = msgspec.convert(values, Study)
        check_study(study)
    except (tomllib.TOMLDecodeError, RecursionError) as error:  # the latter for deep nesting
        raise ConfigError(f"{source}: not a TOML file ({error}).") from None
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {str(error).replace('`', chr(39))}.") from None
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None
    return study


def adapted(
    study: Study,
    *,
    book: str | None = None,
    steps: int | None = None,
    seeds: int | None = None,
) -> Study:
    """Return a study with another book, steps or seeds.

    Args:
        study: the study, which stays as it is.
        book: recipe book; None keeps the study's.
        steps: environment steps of each training; None keeps the study's. Variants with fewer steps
            of their own keep these.
        seeds: trainings per variant and grid point; None keeps the study's.

    Raises:
        ConfigError: if the study itself varies the setting, or a value is out of range.
    """
    given: dict[str, Value | None] = {"book": book, "steps": steps}
    changes = {name: value for name, value in given.items() if value is not None}
    for name in changes:
        # Variants with steps of their own are shortened below.
        variants_with = [] if name == "steps" else study.variants.values()
        if name in study.grid or any(name in settings for settings in variants_with):
            raise ConfigError(f"`{name}`: the study varies this setting; change the study file.")
    variants = dict(study.variants)
    for name, table in study.variants.items():
        variant_steps = table.get("steps")
        if steps is not None and isinstance(variant_steps, int):
            variants[name] = {**table, "steps": min(variant_steps, steps)}
    adapted_study = msgspec.structs.replace(
        study,
        variants=variants,
        settings={**study.settings, **changes},
        seeds=study.seeds if seeds is None else seeds,
    )
    check_study(adapted_study)
    return adapted_study


def check_study(study: Study) -> None:
    """Check the names and settings in a study.

    Raises:
        ConfigError: for the first wrong or contradictory name or setting.
    """
    whole("seeds", study.seeds, 1, 1_000)
    whole("trials", study.trials, 1, 1_000)
    if not study.variants:
        raise ConfigError('no variants; expected at least one table [variants."a name"].')
    if study.reference:
        one_of("reference", study.reference, list(study.variants))
    tables: list[dict[str, Any]] = [study.settings, study.grid, *study.variants.values()]
    if study.vary_split and any("split_seed" in table for table in tables):
        raise ConfigError(
            "'split_seed' is set, but with 'vary_split' it is each training's seed; remove one of "
            "the two."
        )
    for name, scorer in study.scorers.items():
        command = scorer.get("command")
        one_of(f"scorers.{name}.command", command, list(SCORER_SETTINGS))
        _check_names(f"scorers.{name}.", scorer, {"command", *SCORER_SETTINGS[str(command)]})
    _check_settings(study)
    for name, values in study.grid.items():
        # Equal points would be counted twice in every mean and correction.
        if not values or any(value in values[:place] for place, value in enumerate(values)):
            raise refuse(f"grid.{name}", values, "at least one value, and none twice")
    # The grid may name scorers, too, so they are checked cell by cell.
    for cell in cells_of(study):
        if SCORER in cell.settings:
            # A study without scorers has no name to expect.
            names = list(study.scorers) or ["the tables [scorers.NAME], of which there is none"]
            one_of(f"variants.{cell.variant}.{SCORER}", cell.settings[SCORER], names)
    for claim in study.claims:
        _check_claim(study, claim)


def _check_settings(study: Study) -> None:
    # Which scorer a variant names is not known here, so a setting of any scorer passes.
    scorer_settings = {f"{SCORER}.{name}" for name in chain.from_iterable(SCORER_SETTINGS.values())}
    allowed_settings = {SCORER, *OF_GRAPH, *OF_AGENT, *scorer_settings} - set(NO_SETTINGS)
    _check_names("settings.", study.settings, allowed_settings)
    _check_names("grid.", study.grid, allowed_settings)
    _check_names("search.", study.search, allowed_settings)
    of_training = {field.name for kind in (PolicyConfig, ImpalaConfig) for field in fields(kind)}
    for variant, settings in study.variants.items():
        prefix = f"variants.{variant}."
        _check_names(prefix, settings, {PLAYER, *allowed_settings})
        if PLAYER in settings:
            one_of(f"{prefix}{PLAYER}", settings[PLAYER], PLAYERS)
            for name in sorted(settings.keys() & of_training - {"features"}):
                raise ConfigError(
                    f"{prefix}{name} is for an agent that is trained, not for a player; remove the "
                    f"setting or '{PLAYER}'."
                )
        for name in sorted(settings.keys() & (study.grid.keys() | study.search.keys())):
            raise ConfigError(
                f"{prefix}{name} is also in the grid or search; remove the setting from the "
                "variant."
            )


def _check_claim(study: Study, claim: Claim) -> None:
    prefix = f"claim {claim.text!r}"
    if (claim.than is None) == (not claim.right):
        raise ConfigError(f"{prefix} needs either 'right', a variant, or 'than', a value.")
    for variant in filter(None, (claim.left, claim.right)):
        one_of(f"{prefix}: variant", variant, list(study.variants))
    # Without a size, any interval that excludes 0 by a hair would contradict the claim.
    if claim.expected == "comparable" and not claim.by:
        raise ConfigError(f"{prefix} needs 'by': how close is comparable?")
    if claim.measure == "steps" and not claim.right:
        raise ConfigError(
            f"{prefix}: steps are counted until the curve of a variant is reached; give 'right'."
        )
    for values in (claim.at, {**claim.at, **claim.right_at}):
        if not points_at(study, values):
            raise ConfigError(f"{prefix} is about {values}, which is not a grid point.")


def points_of(study: Study) -> list[Values]:
    """Return a study's grid points: all combinations of values for the settings in ``grid``."""
    combinations = product(*study.grid.values())
    return [dict(zip(study.grid, values, strict=True)) for values in combinations]


def title_of(values: Values) -> str:
    """Describe grid settings in words, such as ``8 distractors, split by-goal``."""
    words = []
    for name, value in values.items():
        if name == "distractors":
            words.append(f"{value} distractor" if value == 1 else f"{value} distractors")
        elif name == "book":
            words.append(str(value))
        else:
            # As in the study's file, where truth values are written in small letters.
            words.append(f"{name} {str(value).lower() if isinstance(value, bool) else value}")
    return ", ".join(words)


def points_at(study: Study, values: Values) -> list[Values]:
    """Return the grid points that have the given values for the given settings."""
    return [point for point in points_of(study) if values.items() <= point.items()]


def _check_names(where: str, table: Iterable[str], allowed: Collection[str]) -> None:
    for name in table:
        if name not in allowed:
            raise ConfigError(f"unknown setting '{where}{name}'.{nearest(str(name), allowed)}")


def cells_of(study: Study) -> list[StudyCell]:
    """Return cells by grid point, variant and seed.

    A cell without a scorer omits settings ``scorer.NAME``: for all their values it is the same
    training.
    """
    cells: list[StudyCell] = []
    prefix = f"{SCORER}."
    for values in points_of(study):
        for name, settings in study.variants.items():
            merged = {**study.settings, **values, **settings}
            if SCORER not in merged:
                merged = {key: merged[key] for key in merged if not key.startswith(prefix)}
            for seed in range(study.seeds):
                split = {"split_seed": seed} if study.vary_split else {}
                cells.append(StudyCell(name, values, seed, {**merged, **split}))
    return cells
