"""``wordcraft-kg play --open-ended``: the open-ended world by hand, with a file to continue a game."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.apps.people.session_file import append_record, check_equal, drop_torn_line
from wordcraft_kg.apps.people.terminal import Terminal, cells
from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Hash, Record, as_lines, as_values, parse_lines, parse_record
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Output
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import combined

ATTEMPTS = 100
HELP = """Combine two things that you know, or one with itself; what they make is known
for good, and nothing is used up. Type the number of a thing, its word, or the
word's beginning. u puts the first pick back, l lists what is known, ? shows
this, q quits."""


class _GameHeader(Record):
    """The first line in a game's file."""

    format: Literal["wordcraft-kg open-ended game 1"]
    graph: str
    graph_hash: Hash
    base: tuple[str, ...]
    attempts: Count


class _GameMove(Record):
    """A further line: an attempt."""

    actions: tuple[str, str]


def play_open_world(
    terminal: Terminal, graph: str, base: Sequence[str] | None, attempts: int | None, out: Path | None, output: Output
) -> None:
    """Play until the attempts are used up, and show the tally; Ctrl-C raises KeyboardInterrupt with the tally."""
    attempts = whole("attempts", ATTEMPTS if attempts is None else attempts, 1)
    env = OpenEndedEnv(graph, base=base, max_attempts=attempts)
    game = _Game(terminal, env, out)
    if out is not None:
        names = env.graph.labels(env.discovery.base)
        header = _GameHeader("wordcraft-kg open-ended game 1", env.graph.name, env.graph.hash, names, attempts)
        game.go_back_to(_open_game(out, header), out)
    with terminal.until_quit(lambda: "; ".join(game.tally())):
        game.play()
    output.result(game.values(), game.tally())


def _open_game(path: Path, header: _GameHeader) -> list[_GameMove]:
    """Begin a game's file, or read the existing file; a torn last line is dropped."""
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
    """The environment, and the counts in the tally."""

    def __init__(self, terminal: Terminal, env: OpenEndedEnv, out: Path | None):
        env.reset()
        self.terminal, self.env, self.out = terminal, env, out
        self.attempted = self.fruitless = self.repeated = 0
        self.is_over = False

    @property
    def known(self) -> tuple[str, ...]:
        return self.env.graph.labels(self.env.discovery.known)

    def combine(self, one: str, other: str) -> tuple[tuple[str, ...], bool]:
        """Make an attempt; return the new entities, and whether the pair had been tried before."""
        _, _, self.is_over, _, info = self.env.step([*map(self.env.graph.id_of, (one, other))])
        self.attempted += 1
        self.fruitless += not info["new_entities"]
        self.repeated += info["repeated"]
        return self.env.graph.labels(info["new_entities"]), info["repeated"]

    def go_back_to(self, moves: Sequence[_GameMove], path: Path) -> None:
        for line, move in enumerate(moves, start=2):
            if self.is_over or not set(move.actions) <= set(self.known):
                raise ArtefactError(f"{path}, line {line} is damaged: {' + '.join(move.actions)} was impossible then.")
            self.combine(*move.actions)
        if self.is_over:
            self.terminal.say(f"{path} is finished; nothing was changed.")
        elif moves:
            self.terminal.say(f"Continuing after {self.attempted} attempts.")

    def play(self) -> None:
        if self.is_over:
            return
        answers = {"?": lambda: [HELP], "l": lambda: cells(self.known)}
        self.terminal.say(HELP, "", *cells(self.known))
        while not self.is_over:
            known = self.known
            left = self.env.max_attempts - self.attempted
            prompt = f"known: {len(known)}   attempts left: {left}   hand: {{}} > "
            one, other = (known[place] for place in self.terminal.pick_two(prompt, known, answers))
            new, repeated = self.combine(one, other)
            if self.out is not None:
                append_record(self.out, _GameMove((one, other)))
            line = combined((one, other), new, "nothing new")
            self.terminal.say(line if new else line + " (tried before)" * repeated)

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
            f"known: {known} of {self.env.discovery.reachable}, {discovered} of them discovered, "
            f"after {self.attempted} of {self.env.max_attempts} attempts",
            f"attempts with nothing new: {self.fruitless}, pairs tried before: {self.repeated}",
        ]
        if self.out is not None and not self.is_over:
            lines.append(f"the same command goes on with {self.out}")
        return lines
