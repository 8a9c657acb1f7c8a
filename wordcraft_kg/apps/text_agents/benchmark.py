"""The benchmark: tracks of frozen tasks with a name and a version, independent of any random generator.

The manifest lists each task with its plans and its table as ids of a book, whose content hash guards the ids.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from wordcraft_kg.apps.text_agents.conversation import Play
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
from wordcraft_kg.apps.text_agents.knowledge import PartialGraphKnowledge
from wordcraft_kg.apps.text_agents.records import PlayedSettings
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, LookUps
from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Count, Hash, Record, parse_record
from wordcraft_kg.base.settings import nearest, one_of
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import padded
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.graphs.tasks import Rows, TaskSet

MANIFEST = Path(__file__).parent / "data" / "everyday-v2.json"
LITE_TASKS, LITE_ATTEMPTS = 100, 100
_GRAMMAR_OF_SCORING = {1: 1}
"""Version of the answer grammar by version of the scoring: a published track reads answers as on its first day."""
_NAME = re.compile(r"(.+?)(-lite)?(-made-up)?")


class FrozenBook(Record, frozen=True):
    """Content hashes of a book's graph, and of its splits by kind."""

    hash: Hash
    splits: dict[str, Hash]


class FrozenTask(Record, frozen=True, array_like=True):
    """A task: plans as rows in ``graph.recipes``, each plan ending in the goal, and the ids on the table in order."""

    plans: tuple[Rows, ...]
    table: tuple[Count, ...]


class FrozenTrack(Record, frozen=True, omit_defaults=True):
    """A track: tasks of a split's test part, or open-ended games with the base (ids) in order for each game."""

    about: str
    split: str
    attempts: Count
    depth: Count = 0
    distractors: Count = 0
    tasks: tuple[FrozenTask, ...] = ()
    orders: tuple[tuple[Count, ...], ...] = ()


class Manifest(Record, frozen=True, kw_only=True):
    """The benchmark's manifest: version of the rules, canary, tracks, prompt hashes by interface, and both books."""

    format: Literal["wordcraft-kg benchmark 1"] = "wordcraft-kg benchmark 1"
    name: str
    date: str
    scoring: Count
    licence: str
    canary: str
    prompts: dict[str, Hash]
    books: dict[str, FrozenBook]
    tracks: dict[str, FrozenTrack]

    @property
    def names(self) -> list[str]:
        """Names of all tracks, with the shorter tracks (``-lite``) and those with made-up words."""
        return [
            track + lite + words
            for track in self.tracks
            for lite in ("", "-lite")
            for words in ("", "-made-up")
        ]


@cache
def read_manifest(path: Path = MANIFEST) -> tuple[Manifest, str]:
    """Return the manifest and the SHA-256 of its file; a damaged file is an ArtefactError."""
    data = read_small_file(path)
    return parse_record(data, Manifest, path), hashlib.sha256(data).hexdigest()


@dataclass(frozen=True)
class Track:
    """A track ready for play: the graph with the track's split, and the games, numbered from 0."""

    name: str
    benchmark: str
    book: str
    frozen: FrozenTrack
    opened: OpenedGraph

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are open-ended, without tasks."""
        return not self.frozen.tasks

    @property
    def full_name(self) -> str:
        """Name with the benchmark's name and version, as in recorded games."""
        return f"{self.benchmark}/{self.name}"

    def __len__(self) -> int:
        return len(self.frozen.tasks or self.frozen.orders)

    @cached_property
    def world(self) -> World:
        """The world of the tasks; ConfigError in an open-ended track."""
        if self.is_open_ended:
            raise ConfigError(
                f"track {self.name} is open-ended and has no tasks; choose another player."
            )
        frozen = self.frozen
        config = WordCraftConfig(
            "test", frozen.depth, frozen.distractors, max_attempts=frozen.attempts
        )
        return World(self.opened, config, task_set(self.opened.graph, frozen.depth, frozen.tasks))

    def play(self, look_ups: str = "none", **rules: Any) -> Play:
        """Return the games as conversations; ``rules`` replace settings. ConfigError for other look-ups."""
        one_of("knowledge", look_ups, get_args(LookUps))
        games: TaskGames | DiscoveryGames
        if self.is_open_ended:
            games = DiscoveryGames(
                self.opened, attempts=self.frozen.attempts, orders=self.frozen.orders
            )
        else:
            games = TaskGames(self.world, lambda task, _: [*self.frozen.tasks[task].table])
        own: dict[str, Any] = {
            "track": self.full_name,
            "max_invalid": MAX_INVALID,
            "look_ups": LOOK_UPS,
            "answer_grammar": _GRAMMAR_OF_SCORING[read_manifest()[0].scoring],
        }
        if self.is_open_ended:
            own["distractor_seeds"] = len(self)
        settings = PlayedSettings.of(
            games.env if isinstance(games, DiscoveryGames) else games.world,
            self.opened.split,
            **{"knowledge": look_ups, **own, **rules},
        )
        return Play(
            games,
            settings,
            PartialGraphKnowledge(self.opened.split) if look_ups == "partial" else None,
        )


@cache
def open_track(name: str) -> Track:
    """Open a track such as ``craft-8-lite-made-up``; ConfigError for a wrong name, GraphMismatchError for the book."""
    manifest, _ = read_manifest()
    if name not in manifest.names:
        raise ConfigError(
            f"unknown track '{name[:100]}'; expected one of {', '.join(manifest.tracks)}, with -lite or -made-up."
            f"{nearest(name, manifest.names)}"
        )
    match = _NAME.fullmatch(name)
    assert match is not None
    frozen, (own, made_up) = manifest.tracks[match[1]], manifest.books
    book = made_up if match[3] else own
    opened = _book_with_split(book, frozen.split)
    return Track(name, manifest.name, book, _shortened(frozen) if match[2] else frozen, opened)


def _book_with_split(book: str, kind: str) -> OpenedGraph:
    manifest, _ = read_manifest()
    graph = open_graph(book).graph
    split = make_split(graph, SplitConfig(kind))
    for what, has, expected in (
        ("the book", graph.hash, manifest.books[book].hash),
        ("the split of", split.hash, manifest.books[book].splits[kind]),
    ):
        if has != expected:
            raise GraphMismatchError(
                f"{what} '{book}' has the hash {has[:12]}, and {manifest.name} was made for {expected[:12]}. Install "
                "the version of wordcraft-kg that has this book."
            )
    return OpenedGraph(graph, split, book)


def _shortened(frozen: FrozenTrack) -> FrozenTrack:
    if not frozen.tasks:
        return msgspec.structs.replace(frozen, attempts=LITE_ATTEMPTS)
    places = np.arange(LITE_TASKS) * len(frozen.tasks) // LITE_TASKS
    return msgspec.structs.replace(frozen, tasks=tuple(frozen.tasks[place] for place in places))


def task_set(graph: RecipeGraph, depth: int, tasks: Sequence[FrozenTask]) -> TaskSet:
    """Return a track's tasks as a task set; starts are the ingredients that a plan does not make."""
    recipes = graph.recipes.tolist()

    def needed(plan: Rows) -> set[int]:
        return {entity for row in plan for entity in recipes[row][:2]} - {
            recipes[row][2] for row in plan
        }

    starts = [sorted(set[int]().union(*map(needed, task.plans))) for task in tasks]
    goals = np.array([recipes[task.plans[0][-1]][2] for task in tasks])
    table, plans = (
        padded(starts, graph.num_entities, depth + 1),
        tuple(task.plans for task in tasks),
    )
    return TaskSet(graph, depth, "test", goals, table, plans, False, 0)
