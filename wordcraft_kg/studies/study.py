"""A study: an experiment as data, with variants of an agent, settings that are crossed with them, and seeds.

A study is a TOML file; the built-in ones, the paper's figures among them, lie in ``builtin/``. Every setting is an
option of a command: ``build-graph`` (``book``, ``split``, ``split_seed``, ``train_ratio``,
``valid_ratio``), ``train-agent``, and the training commands of scorers.
"""

import tomllib
from dataclasses import fields
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from wordcraft_kg.agents.config import ImpalaConfig, TaskConfig
from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Record
from wordcraft_kg.base.settings import nearest, whole
from wordcraft_kg.graphs.splits import SplitConfig
from wordcraft_kg.models.links.config import CONFIGS
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.recipes.config import RecipeScorerConfig

Value = str | int | float | bool
Values = dict[str, Value]
Drawing = Literal["curves", "bars", "dose"]
"""Success by step of training; final success of each variant; final success by the MRR of the scorer."""

Metric = Literal["success", "iqm", "by-plan", "train", "mrr", "steps"]
"""Figures that lines of text can show."""
Expected = Literal["more", "less", "comparable", "varies"]
Measure = Literal["success", "early", "steps", "same_twice"]

BUILT_IN = files("wordcraft_kg.studies") / "builtin"
"""Folder of the studies that come with the package."""
OF_GRAPH = {
    "book": "book",
    "split": "kind",
    "split_seed": "seed",
    "train_ratio": "train_ratio",
    "valid_ratio": "valid_ratio",
}
"""Settings of the graph by option: ``book``, and the field of :class:`SplitConfig`."""
OF_AGENT = {field.name: kind for kind in (TaskConfig, PolicyConfig, ImpalaConfig) for field in fields(kind)}
"""Settings of an agent, and which part of them each belongs to."""
SCORER = "scorer"
"""The setting that names a scorer of the study; ``scorer.epochs`` is a setting of the scorer itself."""
_PLAIN_SCORERS = ("facts", "neighbours", "kernel")
"""Scorers that are made of the train recipes without training; they have no settings but ``kg``."""
SCORER_SETTINGS: dict[str, frozenset[str]] = {
    **{name: frozenset({"kg"}) for name in _PLAIN_SCORERS},
    **{
        command: frozenset(field.name for field in fields(kind)) - {"checkpoint_every"}
        for command, kind in {**CONFIGS, RecipeScorerConfig.command: RecipeScorerConfig}.items()
    },
}
"""Settings of each kind of scorer that can change a figure."""
NO_SETTINGS = ("seed", "checkpoint_every")
"""Options that a study gives itself, or that change no figure."""


class Claim(Record, frozen=True, omit_defaults=True):
    """A claim about two variants that can be compared with results.

    Attributes:
        text: the claim, in a sentence.
        source: its author and place.
        note: the reason why it comes out otherwise, if known.
        left: a variant.
        right: the variant with which it is compared.
        than: a value with which it is compared instead of a variant.
        expected: more or less than the other; comparable (closer to it than ``by``); or varies: left is better at some
            points of the grid, right at others.
        by: least amount, for a claim such as "drastically", or the greatest distance of comparable, in the unit of the
            measure.
        measure: success at the end on test tasks; early: success after a tenth of the steps; steps: environment steps
            until a curve reaches 95 % of the end of the right one, as a share of all steps; same_twice: share of the
            test episodes that end with a pair of an entity with itself that does not make the goal.
        at: some values of the points that the claim is about; empty for all points.
        right_at: values in which the point of ``right`` differs from that of ``left``.
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


class Study(Record, omit_defaults=True):
    """A study as its file has it.

    Attributes:
        title: subject of the comparison, in a line.
        about: its question, and how to read it.
        source: origin of the comparison, such as a figure of the paper.
        seeds: number of trainings of each cell, with seeds from 0; scorers without a seed of their own take the same.
        drawing: kind of its figure.
        reference: the variant with which the others are compared. Default: the first.
        settings: settings of all trainings.
        grid: settings that are crossed: a list of values for each name.
        points: further conditions, each a table of the same settings; they are crossed with the grid.
        scorers: scorers by name: ``command`` (train-complex, train-links, train-recipes, facts, neighbours or kernel),
            and settings.
        variants: settings of each variant, by its name.
        claims: claims to compare with the results.

    Example:
        >>> study = Study("Two policies", {"attention": {}, "mlp": {"policy": "mlp"}}, grid={"distractors": [1, 8]})
        >>> len(study.variants) * len(study.grid["distractors"]) * study.seeds
        20
    """

    title: str
    variants: dict[str, Values]
    about: str = ""
    source: str = ""
    seeds: int = 5
    drawing: Drawing = "curves"
    reference: str = ""
    settings: Values = msgspec.field(default_factory=dict)
    grid: dict[str, list[Value]] = msgspec.field(default_factory=dict)
    points: list[Values] = msgspec.field(default_factory=list)
    scorers: dict[str, Values] = msgspec.field(default_factory=dict)
    claims: list[Claim] = msgspec.field(default_factory=list)


class Cell(Record, frozen=True):
    """A training of a study.

    Attributes:
        variant: name of the variant.
        values: the grid's values, by setting.
        seed: seed of the agent, and of its scorer unless that has one of its own.
        settings: all given settings: those of the study, of the grid and of the variant.
    """

    variant: str
    values: Values
    seed: int
    settings: Values


def built_in() -> list[str]:
    """Return the names of the studies that come with the package."""
    return sorted(path.name.removesuffix(".toml") for path in BUILT_IN.iterdir() if path.name.endswith(".toml"))


def read_study(source: str | Path) -> Study:
    """Read a study from a TOML file, or a built-in one by its name, and check it as far as possible without its books.

    Raises:
        ConfigError: if there is no such study, or naming the setting that is unknown, wrong or contradictory.

    Example:
        >>> read_study("knowledge").drawing
        'curves'
    """
    if str(source) in built_in():
        return parse_study((BUILT_IN / f"{source}.toml").read_text(encoding="utf-8"), str(source))
    path = Path(source)
    if not path.is_file():
        raise ConfigError(
            f"'{source}': no such file, and no study of that name; there are {', '.join(built_in())}."
            f"{nearest(str(source), built_in())}"
        )
    try:
        return parse_study(read_small_file(path).decode(), str(source))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{source}: not UTF-8 ({error.reason}).") from None


def parse_study(text: str, source: str) -> Study:
    """Read a study from the text of a TOML file; ``source`` is its name in errors.

    Raises:
        ConfigError: naming what is wrong.
    """
    try:
        values = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{source}: not a TOML file ({error}).") from None
    _known(source, "", values, Study.__struct_fields__)
    try:
        study = msgspec.convert(values, Study)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {str(error).replace('`', chr(39))}.") from None
    check_study(study, source)
    return study


def adapted(study: Study, *, book: str | None = None, steps: int | None = None, seeds: int | None = None) -> Study:
    """Return a study with another book, and other numbers of steps and seeds, where they are given.

    Raises:
        ConfigError: if what is given is varied by the study itself, or out of range.
    """
    given: Values = {name: value for name, value in (("book", book), ("steps", steps)) if value is not None}
    for name in given:
        tables: list[dict[str, Any]] = [study.grid, *study.points, *study.variants.values()]
        if any(name in table for table in tables):
            raise ConfigError(f"`{name}`: the study itself says which; change it there.")
    found = msgspec.structs.replace(
        study, settings={**study.settings, **given}, seeds=study.seeds if seeds is None else seeds
    )
    check_study(found)
    return found


def check_study(study: Study, source: str = "study") -> None:
    """Check a study's names and settings.

    Raises:
        ConfigError: naming the first that is unknown, wrong or contradictory.
    """
    whole("seeds", study.seeds, 1, 1_000)
    if not study.variants:
        raise ConfigError(f'{source}: no variants; expected at least one table [variants."a name"].')
    if study.reference and study.reference not in study.variants:
        raise ConfigError(
            f"{source}: reference '{study.reference}' is no variant; there are {', '.join(study.variants)}."
            f"{nearest(study.reference, study.variants)}"
        )
    _check_scorers(study, source)
    _check_settings(study, source)
    _check_grid(study, source)
    _check_points(study, source)
    for cell in cells_of(study):
        name = cell.settings.get(SCORER)
        if name is not None and name not in study.scorers:
            raise ConfigError(
                f"{source}: variant '{cell.variant}' names the scorer {name!r}; there are "
                f"{', '.join(study.scorers) or 'none'}.{nearest(str(name), study.scorers)}"
            )
    for claim in study.claims:
        _check_claim(study, claim, source)


def _check_scorers(study: Study, source: str) -> None:
    for name, scorer in study.scorers.items():
        command = scorer.get("command")
        if command not in SCORER_SETTINGS:
            hint = nearest(str(command), SCORER_SETTINGS)
            raise ConfigError(
                f"{source}: scorers.{name} has command {command!r}; expected one of {', '.join(SCORER_SETTINGS)}.{hint}"
            )
        _known(source, f"scorers.{name}.", scorer, {"command", *SCORER_SETTINGS[str(command)]})


def _check_settings(study: Study, source: str) -> None:
    tables: dict[str, dict[str, Any]] = {"settings.": study.settings, "grid.": study.grid}
    tables |= {f"points[{number}].": point for number, point in enumerate(study.points)}
    tables |= {f"variants.{name}.": settings for name, settings in study.variants.items()}
    of_scorers = {f"{SCORER}.{name}" for known in SCORER_SETTINGS.values() for name in known}
    known = {SCORER, *OF_GRAPH, *OF_AGENT, *of_scorers} - set(NO_SETTINGS)
    varied = {*study.grid, *(name for point in study.points for name in point)}
    for where, table in tables.items():
        _known(source, where, table, known)
        twice = [name for name in table if where.startswith("variants.") and name in varied]
        if twice:
            raise ConfigError(f"{source}: {where}{twice[0]} is also in the grid; a variant cannot fix what is varied.")


def _check_grid(study: Study, source: str) -> None:
    for name, values in study.grid.items():
        if not values:
            raise ConfigError(f"{source}: grid.{name} is empty; expected at least one value.")
        for value in values:
            if values.count(value) > 1:
                raise ConfigError(f"{source}: grid.{name} has {value!r} twice.")


def _check_points(study: Study, source: str) -> None:
    for number, point in enumerate(study.points):
        if point.keys() != study.points[0].keys():
            raise ConfigError(
                f"{source}: points[{number}] has {', '.join(point) or 'nothing'}, points[0] has "
                f"{', '.join(study.points[0]) or 'nothing'}; expected the same settings in all."
            )
        if point in study.points[:number]:
            raise ConfigError(f"{source}: points[{number}] is there twice.")
        for name in point:
            if name in study.grid:
                raise ConfigError(f"{source}: points[{number}].{name} is also in the grid; give it in one of them.")


def _check_claim(study: Study, claim: Claim, source: str) -> None:
    where = f"{source}: claim {claim.text!r}"
    if (claim.than is None) == (not claim.right):
        raise ConfigError(f"{where} needs either 'right', a variant, or 'than', a value.")
    for variant in (claim.left, claim.right):
        if variant and variant not in study.variants:
            hint = nearest(variant, study.variants)
            raise ConfigError(f"{where} names no variant: {variant!r}; there are {', '.join(study.variants)}.{hint}")
    if claim.expected == "comparable" and not claim.by:
        raise ConfigError(f"{where} needs 'by': how close is comparable?")
    if claim.measure == "steps" and not claim.right:
        raise ConfigError(f"{where}: steps are counted until the curve of a variant is reached; give 'right'.")
    for values in (claim.at, {**claim.at, **claim.right_at}):
        if not points_at(study, values):
            raise ConfigError(f"{where} is about {values}; there is no such point in the grid.")


def points_of(study: Study) -> list[Values]:
    """Return the points of a study's grid, in order: the conditions, each crossed with the values of the grid."""
    crossed = [dict(zip(study.grid, point, strict=True)) for point in product(*study.grid.values())]
    return [{**point, **values} for point in study.points or [{}] for values in crossed]


def points_at(study: Study, values: Values) -> list[Values]:
    """Return the points that have certain values."""
    return [point for point in points_of(study) if values.items() <= point.items()]


def _known(source: str, where: str, table: Any, known: Any) -> None:
    for name in table:
        if name not in known:
            raise ConfigError(f"{source}: unknown setting '{where}{name}'.{nearest(str(name), known)}")


def cells_of(study: Study) -> list[Cell]:
    """Return the trainings of a study: the grid, in each of its points all variants, and of each all seeds.

    Settings ``scorer.NAME`` of a cell without a scorer are left out: it is the same training for all their values.
    """
    found = []
    for values in points_of(study):
        for name, settings in study.variants.items():
            merged = {**study.settings, **values, **settings}
            if SCORER not in merged:
                merged = {key: value for key, value in merged.items() if not key.startswith(f"{SCORER}.")}
            found += [Cell(name, values, seed, merged) for seed in range(study.seeds)]
    return found


def split_of(settings: Values) -> SplitConfig:
    """Return how a cell's graph is split."""
    return SplitConfig(**{OF_GRAPH[name]: settings[name] for name in OF_GRAPH if name != "book" and name in settings})  # type: ignore[arg-type]
