"""A second reading of recorded answers: the result of a frozen track under another answer grammar.

A track keeps the grammar of its publication. The second reading plays the same messages by the
present grammar, and says how much of a score is the form of the answers. Once the two grammars read
a message differently, the player would have received other prompts; its later messages say nothing
about that game.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from wordcraft_kg.apps.text_agents.benchmark import Track
from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.submission import (
    GameLine,
    Played,
    TrackMetrics,
    answers_text,
    game_of_track,
    metrics_of,
    metrics_text,
    replay,
)
from wordcraft_kg.base.labels import ANSWER_GRAMMAR


@dataclass(frozen=True)
class SecondReading:
    """Games under another answer grammar.

    Attributes:
        grammar: version of the grammar.
        figures: results of the track; None if the messages do not decide all games.
        lines: the games that are decided.
        open_games: number of games that the messages do not decide.
    """

    grammar: int
    figures: TrackMetrics | None
    lines: Sequence[GameLine]
    open_games: int

    @property
    def text(self) -> str:
        """The result with its interval and the share of invalid answers, or why there is none."""
        if self.figures is None:
            games = self.open_games + len(self.lines)
            return f"not known: {self.open_games} of {games} games would have gone on differently"
        return f"{metrics_text(self.figures)}, {answers_text(self.lines)}"


def read_again(
    track: Track, play: Play, answers: Sequence[Sequence[str]], grammar: int = ANSWER_GRAMMAR
) -> SecondReading:
    """Read the messages of all games of a track under another answer grammar.

    Args:
        track: the track that was played.
        play: the games with the settings under which they were played.
        answers: for each game, in the order of the track, the player's messages.
        grammar: version of the grammar.

    Returns:
        The result under this grammar, or the number of games that the messages do not decide.
    """
    decided = [_decided(play, number, messages, grammar) for number, messages in enumerate(answers)]
    lines = [
        replay(play, number, played) for number, played in enumerate(decided) if played is not None
    ]
    open_games = len(decided) - len(lines)
    figures = None if open_games else metrics_of(track, lines)
    return SecondReading(grammar, figures, lines, open_games)


def _decided(play: Play, number: int, messages: Sequence[str], grammar: int) -> Played | None:
    """Return the decisions in a game.

    None if the game was not over when its messages ended to fit.
    """
    task, seed = game_of_track(play, number)
    # The game as it was played, and the game under the other grammar, message by message.
    was = play.begin(task, seed)
    now = play.begin(task, seed)
    now.grammar = grammar
    is_same = True
    for message in messages:
        if now.is_over:
            break
        # The two games differ, so this message answers a prompt that the new game did not give.
        if not is_same:
            return None
        was.hear(message)
        now.hear(message)
        is_same = _progress(was) == _progress(now)
    if not now.is_over and not is_same:
        return None
    return Played(tuple(now.game.pairs), now.look_ups, now.invalid_actions)


def _progress(talk: Conversation) -> tuple[object, ...]:
    return (*talk.game.pairs, talk.look_ups, talk.invalid_actions)
