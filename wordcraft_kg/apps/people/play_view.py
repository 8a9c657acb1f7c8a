"""What somebody did who played by hand."""

from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs.tasks import TaskPart


class TasksPlayed(Record):
    """Tasks that were played to their end.

    Attributes:
        attempts: attempts in an episode.
        seed: seed of the tasks and tables.
        episodes: tasks played to their end.
        successes: those whose goal was made.
    """

    graph: str
    depth: Count
    distractors: Count
    part: TaskPart
    attempts: Count
    seed: Count
    episodes: Count
    successes: Count


class WorldPlayed(Record, omit_defaults=True):
    """A game in the open-ended world.

    Attributes:
        base: entities known at the start.
        reachable: entities that can ever be known, the base included.
        known: entities known at the end.
        attempts: attempts of a whole game.
        attempted: attempts made.
        fruitless: those that made nothing new, repeated ones included.
        repeated: those whose pair had been tried before.
        hints: hints asked for.
        discovered: what was made, in this order.
        out: file of the game, if it was saved.
    """

    graph: str
    hash: Hash
    base: tuple[str, ...]
    reachable: Count
    known: Count
    attempts: Count
    attempted: Count
    fruitless: Count
    repeated: Count
    hints: Count
    discovered: tuple[str, ...]
    out: str | None = None
