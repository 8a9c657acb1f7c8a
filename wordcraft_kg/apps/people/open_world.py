"""``wordcraft-kg play --open-ended``: open-ended mode by hand, with a file to resume a game."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.apps.people.session_file import append_record, check_equal, drop_torn_line
from wordcraft_kg.apps.people.terminal import Terminal, numbered_columns
from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Hash, Record, as_lines, as_values, parse_lines, parse_record
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Output
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import combined

ATTEMPTS = 100
HELP = """Combine two known items, or one item with itself. Every item you make stays
available, and ingredients are not used up. Type an item's number, its name, or
the start of its name. u undoes the first selection, l lists the known items,
? shows this help, q quits."""


class _GameHeader(Record):
    format: Literal["wordcraft-kg open-ended game 1"]
    graph: str
    graph_hash: Hash
    base: tuple[str, ...]
    attempts: Count


class _GameMove(Record):
    actions: tuple[str, str]


def play_open_world(
    terminal: Terminal, graph: str, base: Sequence[str] | None, attempts: int | None, out: Path | None, output: Output
) -> None:
    """Play open-ended mode in a terminal, save each move in the file ``out``, and print the result to ``output``."""
    attempts = whole("attempts", ATTEMPTS if attempts is None else attempts, 1)
    env = OpenEndedEnv(graph, base=base, max_attempts=attempts)
    game = _Game(terminal, env, out)
    if out is not None:
        names = env.graph.labels(env.discovery.base)
        header = _GameHeader("wordcraft-kg open-ended game 1", env.graph.name, env.graph.hash, names, attempts)
        game.replay(_open_game(out, header), out)
    with terminal.until_quit(lambda: "; ".join(game.tally())):
        game.play()
    output.result(game.values(), game.tally())


def _open_game(path: Path, header: _GameHeader) -> list[_GameMove]:
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, as_lines([header]))
        return []
    data = read_small_file(path)
    sound = data[: data.rfind(b"\n") + 1]
    first, _, rest = sound.partition(b"\n")
    began = parse_record(first, _GameHeader, f"{path}, line 1,")
    check_equal(f"'{path}' has", as_values(began), "this command has", as_values(header))
    moves = parse_lines(rest, _GameMove, f"{path} (after line 1)")
    drop_torn_line(path, len(data) - len(sound))
    return moves


class _Game:
    def __init__(self, terminal: Terminal, env: OpenEndedEnv, out: Path | None):
        env.reset()
        self.terminal, self.env, self.out = terminal, env, out
        self.attempted = self.fruitless = self.repeated = 0
        self.is_over = False

    @property
    def known(self) -> tuple[str, ...]:
        return self.env.graph.labels(self.env.discovery.known)

    def combine(self, one: str, other: str) -> tuple[tuple[str, ...], bool]:
        _, _, self.is_over, _, info = self.env.step([*map(self.env.graph.id_of, (one, other))])
        self.attempted += 1
        self.fruitless += not info["new_entities"]
        self.repeated += info["repeated"]
        return self.env.graph.labels(info["new_entities"]), info["repeated"]

    def replay(self, moves: Sequence[_GameMove], path: Path) -> None:
        for line, move in enumerate(moves, start=2):
            if self.is_over or not set(move.actions) <= set(self.known):
                raise ArtefactError(
                    f"{path}, line {line} is damaged: {' + '.join(move.actions)} was impossible at that point."
                )
            self.combine(*move.actions)
        if self.is_over:
            self.terminal.say(f"{path} is complete; nothing was changed.")
        elif moves:
            self.terminal.say(f"Resuming after {self.attempted} attempts.")

    def play(self) -> None:
        if self.is_over:
            return
        commands = {"?": lambda: [HELP], "l": lambda: numbered_columns(self.known)}
        self.terminal.say(HELP, "", *numbered_columns(self.known))
        while not self.is_over:
            known = self.known
            left = self.env.max_attempts - self.attempted
            prompt = f"known items: {len(known)}   attempts left: {left}   first item: {{}} > "
            one, other = (known[place] for place in self.terminal.select_two(prompt, known, commands))
            new, repeated = self.combine(one, other)
            if self.out is not None:
                append_record(self.out, _GameMove((one, other)))
            line = combined((one, other), new, "nothing new")
            self.terminal.say(line if new else line + " (already tried)" * repeated)

    def values(self) -> dict[str, Any]:
        env, base = self.env, self.env.discovery.base
        values = {
            "graph": env.graph.name,
            "hash": env.graph.hash,
            "base": env.graph.labels(base),
            "reachable": env.discovery.reachable,
            "known": len(self.known),
            "attempts": env.max_attempts,
            "attempted": self.attempted,
            "fruitless": self.fruitless,
            "repeated": self.repeated,
            "discovered": self.known[len(base) :],
        }
        return values if self.out is None else values | {"out": str(self.out)}

    def tally(self) -> list[str]:
        known, discovered = len(self.known), len(self.known) - len(self.env.discovery.base)
        lines = [
            f"known items: {known} of {self.env.discovery.reachable} ({discovered} discovered) "
            f"after {self.attempted} of {self.env.max_attempts} attempts",
            f"attempts without a new item: {self.fruitless}, repeated pairs: {self.repeated}",
        ]
        if self.out is not None and not self.is_over:
            lines.append(f"repeat the command to resume {self.out}")
        return lines
