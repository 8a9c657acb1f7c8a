"""``wordcraft-kg play --open-ended``: the open-ended world by hand."""

from collections.abc import Sequence
from pathlib import Path

from wordcraft_kg.apps.people.open_game import (
    GameHeader,
    GameMove,
    append_move,
    open_game,
    productive_pair,
)
from wordcraft_kg.apps.people.play_view import WorldPlayed
from wordcraft_kg.apps.people.terminal import Quit, Terminal, cells
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Output
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import combined

ATTEMPTS = 100
HELP = """Combine two things that you know, or one with itself; what they make is known
for good, and nothing is used up. Type the number of a thing, its word, or the
word's beginning. u puts the first pick back, l lists what is known, h gives a
hint, ? shows this, q quits."""


def play_open_world(
    terminal: Terminal, graph: str, base: Sequence[str] | None, attempts: int | None, out: Path | None, output: Output
) -> None:
    """Let somebody discover entities until the attempts are used up, and show the tally.

    Raises:
        KeyboardInterrupt: with the tally, for Ctrl-C.
    """
    whole("attempts", ATTEMPTS if attempts is None else attempts, 1)
    env = OpenEndedEnv(graph, base=base, max_attempts=ATTEMPTS if attempts is None else attempts)
    game = _Game(terminal, env, out)
    if out is not None:
        names = env.graph.labels(env.discovery.base)
        header = GameHeader("wordcraft-kg open-ended game 1", env.graph.name, env.graph.hash, names, env.max_attempts)
        game.go_back_to(open_game(out, header), out)
    try:
        game.play()
    except Quit:
        terminal.say("")
    except KeyboardInterrupt:
        terminal.say("")
        raise KeyboardInterrupt(f"interrupted; {'; '.join(game.tally())}") from None
    output.result(game.view(), game.tally())


class _Game:
    """A game: the environment, and what is counted for the tally."""

    def __init__(self, terminal: Terminal, env: OpenEndedEnv, out: Path | None):
        env.reset()
        self.terminal, self.env, self.out = terminal, env, out
        self.attempted = self.fruitless = self.repeated = self.hints = 0
        self.is_over = False
        self._hinted: tuple[int, int] | None = None

    @property
    def known(self) -> tuple[str, ...]:
        """What is known, in the order of discovery."""
        return self.env.graph.labels(self.env.discovery.known)

    def combine(self, one: int, other: int) -> tuple[tuple[str, ...], bool]:
        """Make an attempt; return what it made known, and whether the pair had been tried before."""
        _, _, self.is_over, _, info = self.env.step([one, other])
        self.attempted += 1
        self.fruitless += not info["new_entities"]
        self.repeated += info["repeated"]
        self._hinted = None
        return self.env.graph.labels(info["new_entities"]), info["repeated"]

    def go_back_to(self, moves: Sequence[GameMove], path: Path) -> None:
        """Make the moves of a file again."""
        for line, move in enumerate(moves, start=2):
            if self.is_over or not set(move.picks) <= set(self.known):
                raise ArtefactError(f"{path}, line {line} is damaged: {' + '.join(move.picks)} was impossible then.")
            if move.is_hint:
                self.hints += 1
            else:
                one, other = map(self.env.graph.id_of, move.picks)
                self.combine(one, other)
        if self.is_over:
            self.terminal.say(f"{path} is finished; nothing was changed.")
        elif moves:
            self.terminal.say(f"Continuing after {self.attempted} attempts.")

    def play(self) -> None:
        """Ask for attempts until the game is over."""
        if self.is_over:
            return
        answers = {"?": lambda: [HELP], "l": lambda: cells(self.known), "h": self._hint}
        self.terminal.say(HELP, "", *cells(self.known))
        while not self.is_over:
            known = self.known
            left = self.env.max_attempts - self.attempted
            prompt = f"known: {len(known)}   attempts left: {left}   hand: {{}} > "
            places = self.terminal.pick_two(prompt, known, answers)
            one, other = (known[place] for place in places)
            new, repeated = self.combine(*map(self.env.graph.id_of, (one, other)))
            self._save(GameMove((one, other)))
            line = combined((one, other), new, "nothing new")
            self.terminal.say(self.terminal.styled(line, "good") if new else line + " (tried before)" * repeated)

    def _hint(self) -> list[str]:
        """Name one of two things that make something new together; asked again, both."""
        pair = productive_pair(self.env.graph, self.env.discovery)
        if pair is None:
            return ["No pair of what you know makes anything new."]
        again, self._hinted = pair == self._hinted, pair
        one, other = self.env.graph.labels(pair)
        self.hints += 1
        self._save(GameMove((one, other), is_hint=True))
        return [f"{one} + {other} makes something new." if again else f"Something new can be made with {one}."]

    def _save(self, move: GameMove) -> None:
        if self.out is not None:
            append_move(self.out, move)

    def view(self) -> WorldPlayed:
        """Return the tally."""
        env, base = self.env, self.env.discovery.base
        return WorldPlayed(
            graph=env.graph.name,
            hash=env.graph.hash,
            base=env.graph.labels(base),
            reachable=env.discovery.reachable,
            known=len(self.known),
            attempts=env.max_attempts,
            attempted=self.attempted,
            fruitless=self.fruitless,
            repeated=self.repeated,
            hints=self.hints,
            discovered=self.known[len(base) :],
            out=None if self.out is None else str(self.out),
        )

    def tally(self) -> list[str]:
        """Return the tally in words."""
        view = self.view()
        lines = [
            f"known: {view.known} of {view.reachable}, {len(view.discovered)} of them discovered, "
            f"after {view.attempted} of {view.attempts} attempts",
            f"attempts with nothing new: {view.fruitless}, pairs tried before: {view.repeated}, hints: {view.hints}",
        ]
        if self.out is not None and not self.is_over:
            lines.append(f"the same command goes on with {self.out}")
        return lines
