"""A study's plan: the tasks that make its graphs, scorers and agent runs, and their outcomes.

Equal tasks are planned once. A task has a folder, named after inputs and settings.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.agents.agent_config import (
    PAPER,
    AgentConfig,
    ImpalaConfig,
    TaskConfig,
)
from wordcraft_kg.base import (
    ConfigError,
    FeatureSpec,
    SplitError,
    nearest,
    refuse,
    sha256_of,
    whole,
)
from wordcraft_kg.base.settings import SHUFFLED, VECTORS
from wordcraft_kg.graphs import (
    SPLITS,
    RecipeGraph,
    SplitConfig,
    default_split,
    make_split,
    open_book,
)
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.recipes.recipe_config import RecipeScorerConfig
from wordcraft_kg.models.scorers.features import ENCODED, named
from wordcraft_kg.studies.study import (
    OF_AGENT,
    OF_GRAPH,
    PARTS_OF_AGENT,
    PLAYER,
    PLAYERS_WITH_SCORER,
    SCORER,
    SCORER_SETTINGS,
    TRAINED_SCORERS,
    Study,
    StudyCell,
    Value,
    cells_of,
)

Kind = Literal["graphs", "scorers", "runs"]
"""Kind of result that a task makes, and subfolder in the results folder."""


def hash_of(values: Any) -> str:
    """Return the SHA-256 of JSON values."""
    # Sorted, so that the order of keys in an edited but equal file does not matter.
    text = json.dumps(values, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class Task:
    """A task in a study: a graph folder, a model folder or an agent's run folder to make.

    Attributes:
        kind: kind of result.
        settings: everything that decides the result, as plain JSON values; inputs by their
            addresses.
        title: the task in a line for people; not a part of the address.
        needs: addresses of the inputs: none, the graph, or the graph and the scorer.
        threads: CPU threads.
        device: torch device.
        book: recipe book of a graph, as the study names it.
    """

    kind: Kind
    settings: dict[str, Any]
    title: str
    needs: tuple[str, ...] = ()
    threads: int = 1
    device: str = "cpu"
    book: str = ""

    @cached_property
    def address(self) -> str:
        """Folder relative to the results folder: kind and settings hash."""
        return f"{self.kind}/{hash_of(self.settings)[:16]}"

    def folder(self, root: Path) -> Path:
        """Return the folder for the output of this training in the results folder ``root``."""
        return root / self.address


@dataclass(frozen=True)
class Outcome:
    """How a task ended.

    Attributes:
        address: address of the task.
        termination: done, failed, or interrupted with a checkpoint.
        error: the error in a line; empty without an error.
    """

    address: str
    termination: Literal["done", "failed", "interrupted"]
    error: str = ""


VERSIONS: dict[Kind, int] = {"graphs": 1, "scorers": 1, "runs": 3}
"""Versions of code and default settings that decide the results of graphs, scorers and agents.

A part of every address: raise the number when results change, so that earlier results no longer
count. A test repeats some trainings and compares their results to the bit. Runs 2: training knows
train recipes alone. Runs 3: all tables have the same number of entities, and a share of the deeper
tasks uses an entity twice.
"""
SCORER_VERSIONS = {RecipeScorerConfig.command: 9}
"""Versions of scorers by command, in place of that in :data:`VERSIONS`.

2: recipe scorers compute features by neighbour lists, before by tables of all pairs. 4: gradients
of rankers are rounded in another order, which changes the third digit of success. 5: scores are
rounded in another order, so that an agent's seed may learn something else. 6 to 8: rankers
have other features. 9: beyond 2,000 train recipes, models of folds learn from queries
of the main model, which is that of 8 to the bit.
"""
NOISE_VERSION = 2
"""Version of wrong results, where a scorer learns from some: wrong by train recipes alone."""
BOOK = "everyday"
_CURVE_POINTS = 20
"""Points in a learning curve; each takes about as long as 10,000 steps."""
_IN_STUDIES: dict[type, dict[str, Any]] = {
    RecipeScorerConfig: {"features": "glove"},
    PolicyConfig: {
        name: PAPER[name] for name in ("policy", "scale", "sees_attempts", "mixing", "weigh_plans")
    },
    ImpalaConfig: {"preset": "paper", "scorer_cost": 0.0},
}
"""Values that addresses leave out where the command's default is another value.

So earlier results keep their addresses: without a preset, a study trains with the paper's.
"""


def defaults_of(kind: type) -> dict[str, Any]:
    """Return a dataclass's settings that addresses leave out."""
    # Of an object and not of the class: a configuration may store a default in another form.
    default = kind(**_IN_STUDIES.get(kind, {}))
    return {field.name: getattr(default, field.name) for field in fields(kind)}


def scorer_config(command: str, settings: Mapping[str, Any]) -> Any:
    """Return a scorer's configuration from settings of an address, without `_IN_STUDIES`.

    Args:
        command: command that trains the scorer, a key of :data:`TRAINED_SCORERS`.
        settings: the settings that are not at their default.

    Raises:
        ConfigError: if a setting is out of range, or does not fit another.
    """
    kind = TRAINED_SCORERS[command]
    return kind(**{**_IN_STUDIES.get(kind, {}), **settings})


_KINDS: Mapping[str, tuple[Any, str]] = {
    **dict.fromkeys(("book", "use", "device", "model"), (str, "text, in quotes")),
    **dict.fromkeys(
        ("train_ratio", "valid_ratio", "split_seed"), (int | float, "a number, without quotes")
    ),
}
"""Kinds of values, also in words, of settings whose configuration class checks ranges alone."""


@dataclass(frozen=True)
class Plan:
    """All that a study consists of.

    Attributes:
        name: name of the study in its results folder.
        study: the study.
        cells: its trainings, by grid point, variant and seed.
        runs: address of each cell's run; equal trainings share one.
        tasks: all tasks by address, each after its inputs, first seeds first.
    """

    name: str
    study: Study
    cells: tuple[StudyCell, ...]
    runs: tuple[str, ...]
    tasks: Mapping[str, Task]

    @property
    def threads(self) -> int:
        """Most CPU threads per task."""
        return max(task.threads for task in self.tasks.values())


def make_plan(study: Study, name: str) -> Plan:
    """Plan a study's tasks: reads recipe books and makes splits, but trains nothing.

    Args:
        study: a checked study.
        name: name in the results folder, which is a file name.

    Raises:
        ConfigError: if ``name`` is no file name, a setting is out of range or does not fit another
            (the variant is named), or two variants are the same trainings.
        RecipeFileError: if a recipe book is missing.
    """
    if name in ("", "..") or Path(name).name != name:
        raise ConfigError(
            f"a study cannot be called '{name}', because its name is a file name. Choose a name "
            "without folders."
        )
    planner = _Planner(study)
    cells = tuple(cells_of(study))
    # First seeds for all variants first: an interrupted study has results for each variant.
    order = sorted(range(len(cells)), key=lambda number: cells[number].seed)
    runs = {number: planner.run(cells[number]) for number in order}
    _refuse_equal(study, cells, runs)
    return Plan(
        name=name,
        study=study,
        cells=cells,
        runs=tuple(runs[number] for number in range(len(cells))),
        tasks=planner.tasks,
    )


def _refuse_equal(study: Study, cells: Sequence[StudyCell], runs: Mapping[int, str]) -> None:
    """Refuse variants that say the same in other words, such as a default.

    All their differences would be 0.
    """
    names: dict[tuple[str, ...], str] = {}
    for name in study.variants:
        addresses = (runs[number] for number, cell in enumerate(cells) if cell.variant == name)
        twin = names.setdefault(tuple(addresses), name)
        if twin != name:
            raise ConfigError(
                f"variants '{twin}' and '{name}' are the same trainings; remove the duplicate."
            )


class _Planner:
    def __init__(self, study: Study):
        self.study = study
        self.tasks: dict[str, Task] = {}
        # All cells of a study usually share a graph, and making one takes seconds.
        self._graph = cache(self._make_graph)
        # Books and files of vectors are large, and many cells share them.
        self._book_graph = cache(_book_graph)
        self._content = cache(content_of)

    def run(self, cell: StudyCell) -> str:
        try:
            _check_kinds(cell.settings)
            given = {name: cell.settings[name] for name in OF_GRAPH if name in cell.settings}
            graph = self._graph(**given)
            return self._agent(cell, graph, self._scorer(cell, graph))
        except (ConfigError, SplitError) as error:
            raise ConfigError(f"variant '{cell.variant}'{_values(cell.values)}: {error}") from None

    def _add(self, kind: Kind, described: dict[str, Any], title: str, **others: Any) -> str:
        # The address covers the version, see VERSIONS, and the content of a file of vectors.
        content = self._content(described.get("settings", {}).get("features"))
        settings = {"version": VERSIONS[kind], **described, **content}
        task = Task(kind, settings, title, **others)
        self.tasks.setdefault(task.address, task)
        return task.address

    def _make_graph(self, *, book: str = BOOK, **split_settings: Value) -> str:
        """Return the address of a new graph, by the study's graph settings."""
        graph = self._book_graph(book)
        # An impossible split fails here; a book too small for the default split has none.
        settings: dict[str, Any] = {OF_GRAPH[name]: split_settings[name] for name in split_settings}
        split = make_split(graph, SplitConfig(**settings)) if settings else default_split(graph)
        if split.config.kind == "none":
            raise ConfigError(
                f"the split of '{book}' has no test tasks to compare agents on. Use a `split` such "
                "as by-recipe, and a large enough book."
            )
        described = {"graph": graph.hash, "name": graph.name, "split": asdict(split.config)}
        # Such splits also depend on kinds of entities, which neither hash nor settings cover.
        if SPLITS[split.config.kind].uses_kinds:
            described["split_hash"] = split.hash
        described |= _recorded(SPLITS.plugins(split.config.kind))
        title = f"graph {graph.name}, {split.config.kind}, seed {split.config.seed}"
        return self._add("graphs", described, title, book=book)

    def _scorer(self, cell: StudyCell, graph: str) -> str | None:
        """Return the address of a cell's scorer; None without one."""
        name = cell.settings.get(SCORER)
        if name is None:
            return None
        prefix = f"{SCORER}."
        settings = self.study.scorers[str(name)] | {
            key.removeprefix(prefix): value
            for key, value in cell.settings.items()
            if key.startswith(prefix)
        }
        command = str(settings.pop("command"))
        unknown = settings.keys() - SCORER_SETTINGS[command]
        if unknown:
            wrong = min(unknown)
            raise ConfigError(
                f"{command} has no setting "
                f"'{SCORER}.{wrong}'.{nearest(wrong, SCORER_SETTINGS[command])}"
            )
        kind = TRAINED_SCORERS[command]
        _check_kinds(settings)
        # Each agent gets a scorer of its own seed, so intervals cover both trainings.
        settings.setdefault("seed", cell.seed)
        if command == RecipeScorerConfig.command:
            # The default vectors depend on the book's language, so the address names them.
            labels = self._book_graph(self.tasks[graph].book).entities
            settings.setdefault("features", named(RecipeScorerConfig.features, labels))
        config = scorer_config(command, settings)
        settings = _not_default(settings, kind)
        described: dict[str, Any] = {"graph": graph, "command": command, "settings": settings}
        if command in SCORER_VERSIONS:
            described["version"] = SCORER_VERSIONS[command]
        if settings.get("label_noise"):
            described["noise"] = NOISE_VERSION
        title = f"{command}{_values(settings)} on {self.tasks[graph].title}"
        return self._add(
            "scorers",
            described,
            title,
            needs=(graph,),
            threads=config.threads,
            device=config.device,
        )

    def _agent(self, cell: StudyCell, graph: str, scorer: str | None) -> str:
        """Return the address of a cell's run."""
        if PLAYER in cell.settings:
            return self._player(cell, graph, scorer)
        agent_settings: dict[str, Any] = {
            name: value for name, value in cell.settings.items() if name in OF_AGENT
        }
        agent_settings["seed"] = cell.seed
        # Curves of all lengths have as many points, so that their files stay small.
        if "eval_every" not in agent_settings:
            steps = whole("steps", agent_settings.get("steps", ImpalaConfig.steps), 1)
            agent_settings["eval_every"] = max(steps // _CURVE_POINTS, 1)
        # The folders of graph and scorer do not exist yet; only the settings are checked.
        config = agent_config(agent_settings, graph, scorer)
        # Addresses know sources by letter alone, however the study spells them.
        if "use" in agent_settings:
            agent_settings["use"] = config.policy.use
        # Where the cost changes nothing it must not change the address either.
        has_cost = ImpalaConfig.has_scorer_cost(config.policy.sources, config.tasks.depth)
        cost = agent_settings.get("scorer_cost", ImpalaConfig.scorer_cost)
        agent_settings["scorer_cost"] = cost if has_cost else 0.0
        settings: dict[str, Any] = {}
        # Without defaults: a study that names one has the address of a study that does not.
        for kind in PARTS_OF_AGENT.values():
            settings |= _not_default(agent_settings, kind)
        if config.trainer.preset != "paper":
            # The paper's values, left out above, are not those of another preset.
            settings |= {name: agent_settings[name] for name in PAPER if name in agent_settings}
        described = {"graph": graph, "scorer": scorer, "settings": settings}
        described |= _recorded(config.plugins)
        title = f"{cell.variant}{_values(cell.values)}, seed {cell.seed}"
        trainer = config.trainer
        return self._add(
            "runs",
            described,
            title,
            needs=tuple(filter(None, (graph, scorer))),
            threads=trainer.threads,
            device=trainer.device,
        )

    def _player(self, cell: StudyCell, graph: str, scorer: str | None) -> str:
        """Return the address of the games of a player without training.

        They have no seed: their tables and the player's choices are those of each evaluation.

        Raises:
            ConfigError: for a player that lacks the scorer to play by.
        """
        names = [PLAYER, "features", *(field.name for field in fields(TaskConfig))]
        settings = {name: cell.settings[name] for name in names if name in cell.settings}
        player = settings[PLAYER]
        if player in PLAYERS_WITH_SCORER:
            command = None if scorer is None else self.tasks[scorer].settings["command"]
            has_pairs_only = self._book_graph(self.tasks[graph].book).has_pairs_only
            if command != RecipeScorerConfig.command or not has_pairs_only:
                raise ConfigError(
                    f"player '{player}' plays a book of pairs by a recipe scorer; give it a scorer "
                    f"with command '{RecipeScorerConfig.command}'."
                )
        described = {"graph": graph, "scorer": scorer, "settings": settings}
        title = f"{cell.variant}{_values(cell.values)}, {self.tasks[graph].title}"
        return self._add("runs", described, title, needs=tuple(filter(None, (graph, scorer))))


def _book_graph(book: str) -> RecipeGraph:
    return RecipeGraph.from_book(open_book(book))


def _recorded(plugins: dict[str, str]) -> dict[str, Any]:
    """Return the hashes of plugin files for an address; another content is another training."""
    return {"plugins": sorted(plugins.values())} if plugins else {}


def content_of(features: Value | None) -> dict[str, str]:
    """Return hashes of a file of vectors for an address; none without a file.

    Another content is another training.

    Args:
        features: the setting ``features``; None for its default.

    Raises:
        ConfigError: if the file is missing.
    """
    spec = FeatureSpec.parse("glove" if features is None else str(features))
    if not spec.is_path:
        return {}
    path = Path(spec.source)
    if not path.exists():
        expected = f"a file or folder, or one of {', '.join(VECTORS)}, perhaps after '{SHUFFLED}'"
        raise refuse("features", features, expected, nearest(spec.source, VECTORS))
    path = path / ENCODED if path.is_dir() else path
    files = [path]
    # An array has its labels in a file beside it.
    if path.suffix.lower() == ".npy":
        files.append(path.with_suffix(".labels.txt"))
    hashes = [sha256_of(file) for file in files if file.is_file()]
    return {"content": " ".join(hashes)}


def agent_config(settings: Mapping[str, Any], graph: str, scorer: str | None) -> AgentConfig:
    """Return an agent's configuration from settings of an address, which leave defaults out.

    Args:
        settings: settings of tasks, policy and trainer by option name.
        graph: graph folder, or its address.
        scorer: model folder or its address; None for an agent without a scorer.

    Raises:
        ConfigError: if a setting is out of range, or does not fit another.
    """
    settings = {**_IN_STUDIES[ImpalaConfig], **settings}
    if settings["preset"] == "paper":
        settings = {**_IN_STUDIES[PolicyConfig], **settings}
    parts: dict[str, Any] = {}
    for part, kind in PARTS_OF_AGENT.items():
        names = [field.name for field in fields(kind) if field.name in settings]
        parts[part] = kind(**{name: settings[name] for name in names})
    return replace(AgentConfig(graph, scorer), **parts)


def _check_kinds(settings: Mapping[str, Any]) -> None:
    for name in sorted(settings.keys() & _KINDS.keys()):
        kind, expected = _KINDS[name]
        if not isinstance(settings[name], kind):
            raise refuse(name, settings[name], expected)


def _not_default(settings: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """Return the settings that are not at their default, in the order of the class."""
    return {
        name: settings[name]
        for name, default in defaults_of(kind).items()
        if name in settings and settings[name] != default
    }


def _values(values: Mapping[str, Any]) -> str:
    return "".join(f", {name} {value}" for name, value in values.items())
