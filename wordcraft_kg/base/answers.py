r"""The answer grammar: which two items a message of a player names.

Grammar 1 reads the last line of a message as a whole, see
:func:`~wordcraft_kg.base.labels.read_pair`. Grammar 2 reads the forms in which language models
write, and refuses a message that could mean several pairs. The first rule that applies decides:

1. JSON at the end of the message: ``["a", "b"]``, ``{"first": "a", "second": "b"}``, or
    ``{"answer": "a + b"}``.
2. The last line as a whole, as in grammar 1. If pairs also follow the result (``a + b = c, c + d =
   e``), the line is ambiguous.
3. A marked answer in the last line: ``Final answer: a and b``, or ``\boxed{a + b}``.
4. The only pair of known items in the last line (``I combine **a** + **b** now.``), without
    negation or alternative.

In all rules of grammar 2 an item may be written with its number, as prompts print it (``2 orchard +
3 doctor``), or with a 1 that counts it (``1 orchard + 1 doctor``), and a label that is a number has
priority over the place with this number.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import (
    ANSWER_GRAMMAR,
    WORDS,
    LabelIndex,
    index_of,
    last_line,
    places_named,
    read_pair,
)

Pair = tuple[int, int]
# Bounds on work: a message of a model may be long, and full of brackets.
_LONGEST = 1_000  # characters of a line or a JSON value that are searched
_MOST_STARTS = 50  # brackets at which a JSON value may begin
_ITEM_KEYS = (
    ("first", "second"),
    ("a", "b"),
    ("item1", "item2"),
    ("item_1", "item_2"),
    ("ingredient1", "ingredient2"),
    ("ingredient_1", "ingredient_2"),
    ("ingredient_a", "ingredient_b"),
)
_ANSWER_KEYS = ("answer", "final_answer", "pair", "items", "ingredients", "combination", "combine")
_MARKER = re.compile(r"\b(?:final\s+)?answer\b\s*(?:is\b|:|=)[\s:]*", re.IGNORECASE)
_BOXED = re.compile(r"\\boxed\s*\{")
_LATEX_TEXT = re.compile(r"\\(?:text|textbf|textit|mathrm|mathbf|mbox)\s*\{([^{}]*)\}")
_LATEX_MARK = re.compile(r"\\[()\[\], ]|\\q?quad\b|\$")
_LATEX_END = re.compile(r"^(?:\s|\\[\])]|\$)*$")  # lines that only close a formula
_AROUND = r"[\s*_`'\"“”‘’()\[\]]*"
_JOINER = re.compile(
    rf"{_AROUND}(?:(?P<sign>[+&])|[,;]|,?\s*\b(?:and|with|plus|then)\b){_AROUND}", re.IGNORECASE
)
_ALTERNATIVE = re.compile(rf"{_AROUND}(?:,?\s*\bor\b|/){_AROUND}", re.IGNORECASE)
_MADE = re.compile(r"(?:=>|->|=|→)[^+&]*$")
_NEGATION = re.compile(
    r"\b(?:no|not|never|neither|nor|cannot|without|except|avoid|instead\s+of|rather\s+than)\b"
    r"|n['’]t\b",
    re.IGNORECASE,
)
_LIST_NUMBER = re.compile(r"\d+[.)]\s*")
_NUMBER_BEFORE = re.compile(r"(?:^|\s)\(?#?\d+[.):]?\s*$")


def read_answer(message: str, labels: Sequence[str], *, grammar: int = ANSWER_GRAMMAR) -> Pair:
    r"""Return the places of the two items that a message names, in written order.

    Args:
        message: text with any number of lines.
        labels: distinct labels of the items on the table, in the order of their numbers.
        grammar: version of the rules, 1 or 2, see the module.

    Returns:
        Two indices in ``labels``, which may be equal.

    Raises:
        ActionError: if the message names no pair, or could name several.

    Example:
        >>> labels = ["number", "orchard", "doctor"]
        >>> read_answer("2 orchard + 3 doctor", labels)
        (1, 2)
        >>> read_answer(r"So: \boxed{number + doctor}", labels)
        (0, 2)
    """
    line = last_line(message)
    if grammar == 1:
        return read_pair(line, labels, grammar=1)
    written = _in_json(message)
    if written is not None:
        return _one_of([read_pair(text, labels) for text in written], labels)
    if "\\" in line or "$" in line:
        line = last_line(_without_formula_ends(message))
    try:
        pair = read_pair(line, labels)
    except ActionError as error:
        return _in_sentence(line, labels, error)
    # `a + b = c, c + d = e` reads as `a + b` if all behind the sign were ignored.
    mentioned = {one.pair for one in _mentions(line, labels).pairs if one.by_sign}
    mentioned.add(pair)
    return _one_of([pair, *mentioned], labels)


def _one_of(pairs: Sequence[Pair], labels: Sequence[str]) -> Pair:
    """Return the first pair.

    Raises:
        ActionError: if the pairs differ in more than order, which a recipe does not have.
    """
    different = {tuple(sorted(pair)): pair for pair in pairs}
    if len(different) > 1:
        ways = " or ".join(f"{labels[one]} + {labels[other]}" for one, other in different.values())
        raise ActionError(
            f"the answer could mean several pairs: {ways[:200]}. Write one pair in the last line."
        )
    return pairs[0]


def _in_sentence(line: str, labels: Sequence[str], unreadable: ActionError) -> Pair:
    """Return the marked pair in a line, or else its only pair.

    Raises:
        ActionError: ``unreadable`` if there is no pair, or another if there are several.
    """
    marked = list(_marked(line))
    pairs = []
    for text in marked or [line]:
        bare = _without_latex(text) if marked else text
        try:
            pairs.append(read_pair(bare, labels))
        except ActionError:
            pairs += _only_pair(bare, labels)
    if not pairs:
        raise unreadable
    return _one_of(pairs, labels)


def _marked(line: str) -> Iterator[str]:
    """Yield the texts that a line marks as the answer: in boxes, else behind the last marker."""
    boxed = list(_boxed(line))
    if boxed:
        yield from boxed
        return
    markers = list(_MARKER.finditer(line))
    if markers:
        yield line[markers[-1].end() :][:_LONGEST]


def _without_latex(text: str) -> str:
    r"""Return the text of a formula, such as ``a + b`` for ``\text{a} + \text{b}``."""
    return _LATEX_MARK.sub(" ", _LATEX_TEXT.sub(r" \1 ", text)).strip()


def _boxed(line: str) -> Iterator[str]:
    """Yield the contents of boxes; a regular expression cannot match nested braces."""
    for match in _BOXED.finditer(line):
        depth = 1
        for place in range(match.end(), min(len(line), match.end() + _LONGEST)):
            depth += {"{": 1, "}": -1}.get(line[place], 0)
            if depth == 0:
                yield line[match.end() : place]
                break


def _without_formula_ends(message: str) -> str:
    """Return a message without last lines that only close a formula."""
    lines = message.splitlines()
    while lines and _LATEX_END.match(lines[-1]):
        lines.pop()
    return "\n".join(lines)


@dataclass(frozen=True)
class _Item:
    """A known item in a line.

    Attributes:
        start: first character in the line.
        end: character behind the item.
        place: index on the table.
    """

    start: int
    end: int
    place: int


@dataclass(frozen=True)
class _Joined:
    """Two neighbouring items with a joiner between them.

    Attributes:
        pair: places on the table, in written order.
        by_sign: whether the joiner is ``+`` or ``&``, not a word or a comma.
    """

    pair: Pair
    by_sign: bool


@dataclass(frozen=True)
class _Mentions:
    """All pairs in a line.

    Attributes:
        pairs: the pairs, from left to right.
        is_clear: whether there is no negation, alternative or question, and no sign without a known
            item.
    """

    pairs: Sequence[_Joined]
    is_clear: bool


def _only_pair(line: str, labels: Sequence[str]) -> list[Pair]:
    """Return the only pair in a sentence, in a list; an empty list if there is none.

    Raises:
        ActionError: if there are several pairs, or the sentence may not mean its pair.
    """
    mentions = _mentions(line, labels)
    if not mentions.pairs:
        return []
    pair = _one_of([one.pair for one in mentions.pairs], labels)
    if not mentions.is_clear:
        raise ActionError(
            f"the answer mentions {labels[pair[0]]} + {labels[pair[1]]}, but with a negation, a "
            "question, an alternative, or other items. Write the pair alone in the last line."
        )
    return [pair]


def _mentions(line: str, labels: Sequence[str]) -> _Mentions:
    """Return the pairs of known items in a line.

    The text behind an arrow or equals sign is the result, and is left out.
    """
    text = _MADE.sub("", line[:_LONGEST])
    items = list(_items(text, index_of(tuple(labels))))
    pairs = []
    if not items:
        return _Mentions([], False)
    others = [text[: items[0].start]]  # text that joins no items
    is_clear = not text.rstrip().endswith("?")
    for one, other in pairwise(items):
        between = text[one.end : other.start]
        joiner = _JOINER.fullmatch(between)
        if joiner:
            pairs.append(_Joined((one.place, other.place), joiner["sign"] is not None))
        elif _ALTERNATIVE.fullmatch(between):
            is_clear = False
        else:
            others.append(between)
    others.append(text[items[-1].end :])
    for rest in others:
        is_clear &= not _NEGATION.search(rest) and "+" not in rest
    for item in items:
        before = _LIST_NUMBER.sub("", text[: item.start], count=1)
        is_clear &= not _NUMBER_BEFORE.search(before)  # the number of another item
    return _Mentions(pairs, is_clear)


def _items(text: str, index: LabelIndex) -> Iterator[_Item]:
    """Yield the known items in a text from left to right, the longest at each word."""
    words = list(WORDS.finditer(text))
    most = index.most_words + 2  # an article and the item's number
    start = 0
    while start < len(words):
        # The longest first: `fire brigade` is not the item `fire`.
        for end in range(min(start + most, len(words)), start, -1):
            first = words[start]
            last = words[end - 1]
            if first[0] in ",;" or last[0] in ",;":
                continue
            written = " ".join(text[first.start() : last.end()].split())
            named = places_named(written, index, by_number=True)
            is_bare_place = written.isdigit() and index.place_of(written) is None
            if len(named) == 1 and not is_bare_place:
                yield _Item(first.start(), last.end(), named[0])
                start = end
                break
        else:
            start += 1


def _in_json(message: str) -> list[str] | None:
    """Return the pairs in a JSON value at the end of a message, as texts; None without a value."""
    text = message.strip().removesuffix("```").rstrip()[-_LONGEST:]
    if not text.endswith(("}", "]")):
        return None
    # The earliest bracket at which the rest is JSON begins the outermost value.
    starts = [place for place, char in enumerate(text) if char in "{["][:_MOST_STARTS]
    for start in starts:
        try:
            value = json.loads(text[start:], object_pairs_hook=_Pairs)
        except (ValueError, RecursionError):
            continue
        return list(_pairs_in_value(value)) or None
    return None


class _Pairs(list[tuple[str, Any]]):
    """The members of a JSON object in order; a name may be repeated."""


def _pairs_in_value(value: Any) -> Iterator[str]:
    """Yield the pairs in a JSON value, as texts; names that are repeated give several pairs."""
    if isinstance(value, _Pairs):
        members = [(name.casefold().replace(" ", "_"), one) for name, one in value]
        for first, second in _ITEM_KEYS:
            ones = [one for name, one in members if name == first and _is_item(one)]
            others = [one for name, one in members if name == second and _is_item(one)]
            for one, other in product(ones, others):
                yield f"{one} + {other}"
        for name, one in members:
            if name not in _ANSWER_KEYS:
                continue
            if isinstance(one, str):
                yield one
            else:
                yield from _pairs_in_value(one)
    elif isinstance(value, list) and len(value) == 2 and all(map(_is_item, value)):
        yield f"{value[0]} + {value[1]}"


def _is_item(value: Any) -> bool:
    # A bool is an int in Python.
    return isinstance(value, str | int) and not isinstance(value, bool)
