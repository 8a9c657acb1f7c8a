"""Parser for recipes in a language model's answers, which are lines such as ``mud: water + earth``."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.prompts import Prompt
from wordcraft_kg.base.labels import LabelIndex

Why = Literal["no pair", "unknown item", "not requested", "goal as ingredient", "duplicate"]
"""Reason for an unparsed line; an unknown item is not in the graph, and "not requested" concerns the result."""
WHYS: tuple[Why, ...] = get_args(Why)
_MOST_LINES = 20_000
_LONGEST_LINE = 20_000
"""Longer answers and lines are not parsed, because parsing takes too long."""
_MARKS = re.compile(r"\*\*|__|`")
_THINKING = re.compile(r"<think(?:ing)?>.*?(?:</think(?:ing)?>|\Z)", re.DOTALL | re.IGNORECASE)
_END_OF_THINKING = re.compile(r"</think(?:ing)?>", re.IGNORECASE)
_BULLET = re.compile(r"^(?:[-*•·–>]+\s+|\(?\d{1,3}[.)]\s+)+")
_MAKES = re.compile(r"\s*(?:=>|->|→|⇒|=)\s*")
_GOAL = re.compile(r"\s*(?::|=>|->|→|⇒|=|<-|←|–|—)\s*")
_PLUS = re.compile(r"\s*(?:\+|＋|&)\s*")
_SEVERAL = re.compile(r"\s*[,;|]\s*(?:or\s+)?|\s+or\s+")


@dataclass(frozen=True)
class ElicitedRecipe:
    """A recipe that a language model named.

    Attributes:
        recipe: entity ids: both ingredients in ascending order, and the result.
        rank: position in the model's list of pairs for this result, from 1.
    """

    recipe: tuple[int, int, int]
    rank: int

    @property
    def weight(self) -> float:
        """Weight, ``(1 + 1 / rank) / 2``: being named is at least as informative as the position."""
        return (1 + 1 / self.rank) / 2


@dataclass(frozen=True)
class Unread:
    """A line in an answer that could not be parsed as a recipe, and the reason."""

    why: Why
    line: str


def read_elicited(
    prompts: Sequence[Prompt], answers: Sequence[Answer], entities: Sequence[str]
) -> tuple[list[ElicitedRecipe], list[Unread]]:
    """Parse the answers to prompts; return the elicited recipes and the unparsed lines.

    A line may have a bullet, a number, quotes or emphasis, the form ``first + second = item``, or several pairs;
    pairs may follow a heading. The rank of a recipe counts only the parsed pairs for its result.

    Args:
        prompts: the prompts, which list the requested goals.
        answers: the answers, in the order of the prompts.
        entities: the graph's labels in id order.
    """
    known = LabelIndex(entities)
    elicited: list[ElicitedRecipe] = []
    unread: list[Unread] = []
    for prompt, answer in zip(prompts, answers, strict=True):
        goals = {known.find(goal) for goal in prompt.goals}
        named: dict[int, dict[tuple[int, int], None]] = defaultdict(dict)
        why: Why
        for pair, goal, line in _pairs(answer.text, known, goals):
            if pair is None or goal is None:
                why = "unknown item" if _PLUS.search(line) else "no pair"
            elif goal not in goals:
                why = "not requested"
            elif goal in pair:
                why = "goal as ingredient"
            elif pair in named[goal]:
                why = "duplicate"
            else:
                named[goal][pair] = None
                continue
            unread.append(Unread(why, line))
        for goal, pairs in named.items():
            elicited += (ElicitedRecipe((*pair, goal), rank) for rank, pair in enumerate(pairs, 1))
    return elicited, unread


def _pairs(
    text: str, known: LabelIndex, goals: set[int | None]
) -> Iterator[tuple[tuple[int, int] | None, int | None, str]]:
    heading: int | None = None
    # With some servers, reasoning starts in the prompt and only ends in the answer.
    *_, visible = _END_OF_THINKING.split(_THINKING.sub("\n", text))
    for number, raw in enumerate(visible.splitlines()):
        if number >= _MOST_LINES or len(raw) > _LONGEST_LINE:
            yield None, None, " ".join(raw.split())[:_LONGEST_LINE]
            continue
        line = _plain(raw)
        if not line:
            continue
        title = known.find(line.rstrip(" :"))
        if title is not None and title in goals:
            heading = title
            continue
        goal, rest = _divided(line, known)
        if goal is None:
            alone = None if heading is None else _pair(line, known)
            yield alone, None if alone is None else heading, line
            continue
        parts = [rest] if _pair(rest, known) else [part for part in _SEVERAL.split(rest) if part]
        for part in parts or [rest]:
            yield _pair(part, known), goal, line


def _divided(line: str, known: LabelIndex) -> tuple[int | None, str]:
    # Of nested labels, the one before a pair counts.
    about: list[tuple[int, str]] = []
    for match in _GOAL.finditer(line):
        goal = known.find(line[: match.start()])
        if goal is not None:
            about.append((goal, line[match.end() :]))
    for goal, rest in about:
        if len(about) == 1 or any(_pair(part, known) for part in (rest, *_SEVERAL.split(rest))):
            return goal, rest
    if about:
        return about[0]
    for match in _MAKES.finditer(line):
        goal = known.find(line[match.end() :])
        if goal is not None and _PLUS.search(line[: match.start()]):
            return goal, line[: match.start()]
    return None, line


def _pair(text: str, known: LabelIndex) -> tuple[int, int] | None:
    for match in _PLUS.finditer(text):
        one, other = known.find(text[: match.start()]), known.find(text[match.end() :])
        if one is not None and other is not None:
            return min(one, other), max(one, other)
    return None


def _plain(line: str) -> str:
    line = _BULLET.sub("", " ".join(line.split()))
    line = _MARKS.sub("", line).strip()
    return "" if re.fullmatch(r"[-=*#~ ]*", line) or line.startswith("```") else line.rstrip(".,; ")
