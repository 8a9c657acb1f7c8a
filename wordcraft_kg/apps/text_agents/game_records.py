"""Records in the files of text agents: settings, games and results."""

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

import msgspec

from wordcraft_kg.agents.agent_records import TerminationReason
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, TaskGame
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, KnowledgeKind
from wordcraft_kg.base import (
    ConfigError,
    Count,
    GraphMismatchError,
    Hash,
    Record,
    as_lines,
    check_file,
    made_folder,
    parse_lines,
    parse_record,
    read_large_file,
)
from wordcraft_kg.base.wording import for_file
from wordcraft_kg.graphs import TaskPart, TrainedOn
from wordcraft_kg.runs.run_folder import locked

GamesFormat = Literal["wordcraft-kg text games 2"]
GAMES_FILE = "games.jsonl"


class PlayedSettings(Record, frozen=True, kw_only=True):
    """Game settings as recorded with games; results with equal settings are comparable.

    Attributes:
        graph: name of the graph.
        graph_hash: content hash of the graph.
        split_hash: content hash of the split.
        part: part of the tasks; None in the open-ended world.
        depth: fewest attempts that solve a task; None in the open-ended world.
        distractors: entities on each table that no plan needs; None in the open-ended world.
        attempts: attempts in a game.
        base: labels of the entities at the start of open-ended games; empty for tasks.
        distractor_seeds: distractor seeds per task, or number of open-ended games.
        tasks: number of tasks, evenly spaced over the part; None for all.
        knowledge: source of look-ups.
        scorer: hash of the weights of the scorer that answers look-ups; None without one.
        kg: training triples of this scorer (full or partial); None without one.
        look_ups: look-ups in a game; 0 without a source.
        max_invalid: consecutive invalid messages without cost.
        prompt_hash: hash of all prompt texts, see :func:`~wordcraft_kg.envs.words.prompt_hash`.
        track: name of a benchmark's track; None if the games are on no track.
        answer_grammar: version of the rules by which answers were read
            (``wordcraft_kg.base.answers``).
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    part: TaskPart | None
    depth: Count | None
    distractors: Count | None
    attempts: Count
    base: tuple[str, ...] = ()
    distractor_seeds: Count = 1
    tasks: Count | None = None
    knowledge: KnowledgeKind = "none"
    scorer: Hash | None = None
    kg: TrainedOn | None = None
    look_ups: Count = LOOK_UPS
    max_invalid: Count = MAX_INVALID
    prompt_hash: Hash
    track: str | None = None
    answer_grammar: Count

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are in the open-ended world."""
        return self.part is None


class GamesHeader(Record, frozen=True, kw_only=True):
    """The first line in a ``games.jsonl`` file, before the games.

    Attributes:
        format: format of the file.
        player: the player's name, such as a program's or a language model's.
        settings: settings of all games in the file.
    """

    format: GamesFormat = "wordcraft-kg text games 2"
    player: str
    settings: PlayedSettings


class GameRecord(Record, frozen=True, kw_only=True):
    """A finished game: a line in ``games.jsonl``.

    Attributes:
        task: index of the task in its part; 0 in the open-ended world.
        distractor_seed: seed of the distractors on the table, or number of the open-ended game.
        goal: label of the entity to make; None in the open-ended world.
        table: labels at the start, in slot order; empty in the open-ended world.
        success: whether the goal was made.
        by_plan: whether a plan's last pair made the goal.
        actions: number of actions (choices of an entity) in a task until the end.
        termination: how a game on a task ended, as agent evaluation says it.
        known_after: number of known entities after each attempt in the open-ended world.
        repeated: number of attempts there with a pair that had been tried before.
        invalid_actions: number of messages that were not understood.
        lost_attempts: number of attempts lost by them.
        look_ups: number of entities that were looked up.
        messages: all prompts and answers in turn; empty in Inspect's logs, which have their own.
        pairs: labels of all combined pairs or sets in turn, None for a lost attempt.
    """

    task: Count = 0
    distractor_seed: Count = 0
    goal: str | None = None
    table: tuple[str, ...] = ()
    success: bool = False
    by_plan: bool = False
    actions: Count = 0
    termination: TerminationReason | None = None
    known_after: tuple[Count, ...] = ()
    repeated: Count = 0
    invalid_actions: Count = 0
    lost_attempts: Count = 0
    look_ups: Count = 0
    messages: tuple[str, ...] = ()
    pairs: tuple[tuple[str, ...] | None, ...]


def read_games(path: Path) -> tuple[GamesHeader, Sequence[GameRecord], bytes]:
    """Read a games file without changing it.

    Returns:
        The header, the games, and the bytes of an incomplete last line (empty if complete), which
        is from a process that was killed.

    Raises:
        ArtefactError: if the file is missing, of another kind, or damaged.
    """
    lines, _, torn = read_large_file(path).rpartition(b"\n")
    header_line, _, records = lines.partition(b"\n")
    header = parse_record(header_line, GamesHeader, f"{path}, line 1,")
    return header, parse_lines(records, GameRecord, f"{path} (after line 1)"), torn


def open_games(path: Path, header: GamesHeader) -> list[GameRecord]:
    """Create a games file with this header, or return the games in an existing file.

    An incomplete last line is cut off. The file is unchanged on errors.

    Args:
        path: the file.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is of another kind or damaged.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if its games are of another player or other settings.
    """
    line = as_lines([header])[0].encode()
    if not path.exists():
        path.touch()
    with path.open("rb") as file:
        start = file.read(len(line))
    # A beginning of the header is an empty file, or one whose writer was killed meanwhile.
    is_unfinished_header = line.startswith(start) and start != line
    if not is_unfinished_header:
        stored_header, played, torn = read_games(path)
        # Without games, nothing is lost by new settings.
        if played or stored_header == header:
            _check_header(path, stored_header, header)
            if torn:
                text = "%s ended in a torn line, which was dropped; the game is played again"
                logging.getLogger(__name__).warning(text, path)
                os.truncate(path, path.stat().st_size - len(torn))
            return [*played]
    os.truncate(path, 0)
    try:
        append_game(path, header)
    except OSError:
        # Such as a full disk: a file without a game is as good as none.
        path.unlink()
        raise
    return []


def append_game(path: Path, played: Record) -> None:
    """Append the record of a game; it is on disk when this returns.

    Raises:
        OSError: if it cannot be written, such as on a full disk; the file is unchanged.
    """
    size = path.stat().st_size
    try:
        with path.open("ab") as file:
            file.write(as_lines([played])[0].encode())
            file.flush()
            # Survives a power failure, too.
            os.fsync(file.fileno())
    except OSError:
        # A part of the line may be there, and the next record would be glued to it.
        with suppress(OSError):
            os.truncate(path, size)
        raise


def _check_header(path: Path, stored: GamesHeader, header: GamesHeader) -> None:
    if stored.player != header.player:
        raise ConfigError(
            f"'{path}' holds games by '{stored.player}', and the player is '{header.player}'. "
            "Choose another `out`."
        )
    # Graph and split come first: another graph may also differ in settings.
    for field in msgspec.structs.fields(PlayedSettings):
        before = getattr(stored.settings, field.name)
        value = getattr(header.settings, field.name)
        if before != value:
            is_graph = field.name in ("graph", "graph_hash", "split_hash")
            kind = GraphMismatchError if is_graph else ConfigError
            raise kind(
                f"'{path}' holds games with `{field.name}` {before}, and this command has {value}. "
                "Choose another `out`, or use the same settings."
            )


def record_of(talk: Conversation, number: int = 0) -> GameRecord:
    """Return the record of the finished game in a conversation.

    Args:
        talk: the conversation.
        number: number of an open-ended game; a track's own number wins.
    """
    game = talk.game
    counts = {name: getattr(talk, name) for name in COUNTS}
    # A record is written whatever the player says: a game without one could be played again.
    messages = tuple(map(for_file, talk.messages))
    pairs = tuple(game.pairs)
    if isinstance(game, DiscoveryGame):
        return GameRecord(
            distractor_seed=number if game.number is None else game.number,
            known_after=tuple(game.known_after),
            repeated=game.repeated,
            messages=messages,
            pairs=pairs,
            **counts,
        )
    assert isinstance(game, TaskGame)
    return GameRecord(
        task=game.task,
        distractor_seed=game.distractor_seed,
        goal=game.goal,
        table=game.start,
        success=game.is_made,
        by_plan=game.by_plan,
        actions=game.actions,
        termination=_termination_of(game),
        messages=messages,
        pairs=pairs,
        **counts,
    )


def _termination_of(game: TaskGame) -> TerminationReason:
    """Return how a finished game ended, in the terms of agent evaluation."""
    if game.is_made:
        return "goal"
    # A lost attempt has no pair, so none that makes anything.
    if game.last is None:
        return "no_recipe"
    # The ingredients of each plan's last step, which makes the goal.
    parts: set[str] = set()
    for plan in game.tasks[game.task].plans:
        parts.update(plan[-1].ingredients)
    if len(set(game.last)) == 1 < len(game.last):
        return "same_twice"
    if parts.intersection(game.last):
        return "one_right_part"
    picks = tuple(sorted(map(game.graph.id_of, game.last)))
    return "no_right_part" if picks in game.world.outcomes else "no_recipe"


COUNTS = ("invalid_actions", "lost_attempts", "look_ups")


class GamesWriter:
    """A file to which a server appends finished games, in the order in which they end."""

    def __init__(self, path: Path, count: int):
        """Bind the file, which is locked and has ``count`` games."""
        self._path = path
        self._count = count
        self._waiting: list[GameRecord] = []

    def __call__(self, talk: Conversation) -> None:
        """Record a finished game, and save it; a further call only tries to save it again.

        Raises:
            OSError: as :meth:`save`.
        """
        if not talk.is_recorded:
            self._waiting.append(record_of(talk, self._count))
            self._count += 1
            talk.is_recorded = True
            talk.messages.clear()
        self.save()

    def save(self) -> None:
        """Write the games that could not be written before, such as on a full disk.

        They come before all later games, so a game that went wrong is never the second of its task.

        Raises:
            OSError: if a game cannot be written; it still waits.
        """
        while self._waiting:
            append_game(self._path, self._waiting[0])
            del self._waiting[0]


@contextmanager
def games_writer(path: Path, header: GamesHeader) -> Iterator[GamesWriter]:
    """Lock a games file, and yield a function that appends a finished game with its messages.

    Args:
        path: the file; it is created if it does not exist, and continued if it does.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is damaged, no plain file, or in use by another process.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if its games are of another player or other settings.
    """
    with made_folder(path.parent):
        if not path.exists():
            path.touch()  # the lock needs a file
        # No device, folder or broken link: records are appended for as long as the server runs.
        check_file(path)
        with locked(path, "written"):
            writer = GamesWriter(path, len(open_games(path, header)))
            try:
                yield writer
            finally:
                try:
                    writer.save()
                except OSError as error:
                    logging.getLogger(__name__).error("games were not saved: %s", error)
