"""The benchmark: tracks of frozen tasks with a name and a version.

The tasks do not depend on any random generator. The manifest lists each task with its plans and its
table as ids of a book, whose content hash guards the ids.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, Play, TaskGames
from wordcraft_kg.base import (
    ConfigError,
    Count,
    GraphMismatchError,
    Hash,
    Record,
    nearest,
    parse_record,
    read_small_file,
)
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import (
    OpenedGraph,
    RecipeGraph,
    SplitConfig,
    TaskSet,
    open_graph,
    padded,
)
from wordcraft_kg.graphs.tasks import Rows

MANIFEST = Path(__file__).parent / "data" / "everyday-v3.json"
BOARD = MANIFEST.with_name("board.json")
"""Rows of the leaderboard, which `benchmarks/leaderboard_page.py` writes."""
# With 100 tasks a 95 % interval is at most 20 points wide, enough to tell clearly different players
# apart, at a price that a language model's user can pay.
LITE_TASKS = 100
LITE_ATTEMPTS = 100


class FrozenBook(Record, frozen=True):
    """The state of a book for which the tracks were made.

    Attributes:
        hash: content hash of the book's graph.
        splits: content hash of the split by kind of split.
    """

    hash: Hash
    splits: dict[str, Hash]


class FrozenTask(Record, frozen=True, array_like=True):
    """A task; an array in JSON.

    Attributes:
        plans: each plan as rows in ``graph.recipes``, in the order of crafting; the last row makes
            the goal.
        table: ids of the entities on the table at the start, in slot order.
    """

    plans: tuple[Rows, ...]
    table: tuple[Count, ...]


class FrozenTrack(Record, frozen=True, omit_defaults=True):
    """A track: tasks of a split's test part, or open-ended games.

    Attributes:
        about: description for `bench list`.
        split: kind of the split, such as ``by-goal``; look-ups know its train recipes.
        attempts: attempts in a game.
        depth: fewest attempts that solve a task; 0 in an open-ended track.
        distractors: entities on each table that no plan needs; 0 in an open-ended track.
        tasks: tasks in order; empty in an open-ended track.
        orders: for each open-ended game the base (ids) in the order in which players see it; empty
            in a track with tasks.
    """

    about: str
    split: str
    attempts: Count
    depth: Count = 0
    distractors: Count = 0
    tasks: tuple[FrozenTask, ...] = ()
    orders: tuple[tuple[Count, ...], ...] = ()


class Manifest(Record, frozen=True, kw_only=True):
    """The benchmark's manifest.

    Attributes:
        format: format of the file.
        name: name with version, such as in recorded games.
        date: day of publication.
        scoring: version of the rules of scoring, which include the answer grammar.
        licence: licence of the tasks.
        canary: a unique text, by which training data that contains the benchmark can be recognised.
        prompts: hash of the standard prompts by interface; other prompts are custom.
        books: the book of the tracks and the same book with made-up words, in this order.
        tracks: tracks by name, without the endings of shorter tracks and of made-up words.
    """

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
        endings = ("", "-made-up", "-lite", "-lite-made-up")
        return [track + ending for track, ending in product(self.tracks, endings)]


@cache
def read_manifest(path: Path = MANIFEST) -> tuple[Manifest, str]:
    """Return the manifest and the SHA-256 of its file; raises ArtefactError for a damaged file."""
    data = read_small_file(path)
    return parse_record(data, Manifest, path), hashlib.sha256(data).hexdigest()


def rank_text(track: str, success: float) -> str:
    """Return the rank of a result among the rows of the leaderboard; empty without rows.

    Args:
        track: name of the track with endings.
        success: the result: a mean success, or a mean number of known items.
    """
    rows = json.loads(read_small_file(BOARD)).get(track, [])
    if not rows:
        return ""
    better_rows = [row for row in rows if row["success"] > success]
    text = f"rank {len(better_rows) + 1} beside the {len(rows)} rows of the leaderboard"
    if better_rows:
        neighbour = better_rows[-1]
        text += f", below {neighbour['player']} ({neighbour['success']:.3f})"
    return text


@dataclass(frozen=True)
class Track:
    """A track ready for play; its games are numbered from 0, and ``len`` counts them.

    Attributes:
        name: name with endings, such as ``craft-8-lite``.
        benchmark: name and version of the benchmark.
        frozen: the tasks or open-ended games, already shortened for a ``-lite`` track.
        opened: the book's graph with the track's split.
    """

    name: str
    benchmark: str
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
        """The world of the tasks; raises ConfigError in an open-ended track."""
        if self.is_open_ended:
            raise ConfigError(
                f"track {self.name} is open-ended and has no tasks; choose another player."
            )
        frozen = self.frozen
        config = WordCraftConfig(
            "test", frozen.depth, frozen.distractors, max_attempts=frozen.attempts
        )
        return World(self.opened, config, task_set(self.opened.graph, frozen.depth, frozen.tasks))

    def play(self, knowledge: str = "none", **rules: Any) -> Play:
        """Return the games as conversations.

        Args:
            knowledge: source of look-ups: none, or partial (the train recipes).
            rules: fields of the played settings that replace the track's, such as ``prompt_hash``.

        Raises:
            ConfigError: for other look-ups.
        """
        frozen = self.frozen
        rules = {"track": self.full_name, "knowledge": knowledge, **rules}
        if self.is_open_ended:
            rules |= {"attempts": frozen.attempts, "orders": frozen.orders}
            return DiscoveryGames(self.opened, distractor_seeds=len(self), **rules)
        # The frozen table replaces the drawn one, so the distractor seed has no meaning.
        return TaskGames(self.world, table=lambda task, _: [*frozen.tasks[task].table], **rules)


@cache
def open_track(name: str) -> Track:
    """Open a track by its name, such as ``craft-8-lite-made-up``.

    Raises:
        ConfigError: if there is no such track.
        GraphMismatchError: if this version of the package has another state of the book.
    """
    manifest, _ = read_manifest()
    if name not in manifest.names:
        raise ConfigError(
            f"unknown track '{name[:100]}'; expected one of {', '.join(manifest.tracks)}, with "
            "-lite or -made-up."
            f"{nearest(name, manifest.names)}"
        )
    base_name = name.removesuffix("-made-up")
    frozen = manifest.tracks[base_name.removesuffix("-lite")]
    if base_name.endswith("-lite"):
        frozen = _shortened(frozen)
    plain, made_up = manifest.books
    book = made_up if name.endswith("-made-up") else plain
    opened = open_graph(book, SplitConfig(frozen.split))
    frozen_book = manifest.books[book]
    # The tasks are ids and rows: in another state of the book they would name other entities.
    for subject, has, expected in (
        ("the book", opened.graph.hash, frozen_book.hash),
        ("the split of", opened.split.hash, frozen_book.splits[frozen.split]),
    ):
        if has != expected:
            raise GraphMismatchError(
                f"{subject} '{book}' has the hash {has[:12]}, and {manifest.name} was made for "
                f"{expected[:12]}. Install "
                "the version of wordcraft-kg that has this book."
            )
    return Track(name, manifest.name, frozen, opened)


def _shortened(frozen: FrozenTrack) -> FrozenTrack:
    if not frozen.tasks:
        return msgspec.structs.replace(frozen, attempts=LITE_ATTEMPTS)
    # Evenly spaced: the tasks are in the graph's order, so the first ones would be no fair sample.
    places = np.arange(LITE_TASKS) * len(frozen.tasks) // LITE_TASKS
    return msgspec.structs.replace(frozen, tasks=tuple(frozen.tasks[place] for place in places))


def task_set(graph: RecipeGraph, depth: int, tasks: Sequence[FrozenTask]) -> TaskSet:
    """Return a track's tasks as a task set of the test part.

    Args:
        graph: graph whose recipe rows the plans name.
        depth: recipes in a plan; a plan needs at most ``depth + 1`` entities at the start.
        tasks: frozen tasks in order.
    """
    starts = []
    goals = []
    for task in tasks:
        start: set[int] = set()
        for plan in task.plans:
            recipes = graph.recipes[list(plan)]
            ingredients = set(recipes[:, :2].ravel().tolist())
            # What the plan does not make itself.
            start |= ingredients.difference(recipes[:, 2].tolist())
        starts.append(sorted(start))
        goals.append(graph.recipes[task.plans[0][-1], 2])
    # Padding is `num_entities`, the id of an empty slot.
    table = padded(starts, graph.num_entities, depth + 1)
    plans = tuple(task.plans for task in tasks)
    return TaskSet(graph, depth, "test", np.array(goals), table, plans, False, 0)
