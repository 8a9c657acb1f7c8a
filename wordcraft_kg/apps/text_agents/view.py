"""How a player that uses words did."""

from wordcraft_kg.apps.text_agents.records import WordsResult
from wordcraft_kg.base.records import Record


class WordsView(Record):
    """The result of ``evaluate-words``.

    Attributes:
        result: what was asked, and how the player did.
        out: folder of the games and the result.
    """

    result: WordsResult
    out: str
