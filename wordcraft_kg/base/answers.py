r"""The answer grammar: which two items a message of a player names.

The rules read the forms in which language models write, and refuse a message that could mean
several pairs. Reasoning in tags (``<think>``), marks of turns (``<|im_end|>``) and markup are left
out. Then the first rule that applies decides:

1. Elements, such as ``<answer>a + b</answer>``.
2. JSON at the end of the message: ``["a", "b"]``, ``{"first": "a", "second": "b"}``, ``{"answer":
    "a + b"}``, or a tool call with such arguments.
3. The last line as a whole, see :func:`~wordcraft_kg.base.labels.read_pair`. If pairs also follow
    the result (``a + b = c, c + d = e``), the line is ambiguous.
4. A marked answer in the last line: ``Final answer: a and b``, ``\boxed{a + b}`` or ``combine(a,
    b)``.
5. The only pair of known items in the last line (``I combine **a** + **b** now.``), without
    negation or alternative.
6. If the last line is no attempt at an answer, the same in the whole message: JSON or named values
    (``First: a``), else marked answers, else the only pair.

In all rules an item may be written with its number, as prompts print it (``2 orchard + 3 doctor``),
or with a 1 that counts it (``1 orchard + 1 doctor``). A label that is a number has priority over
the place with this number.
"""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from typing import Any

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import (
    WORDS,
    LabelIndex,
    index_of,
    last_line,
    places_named,
    read_label,
    read_pair,
)

Pair = tuple[int, int]
# Bounds on work: a message of a model may be long, and full of brackets.
_LONGEST = 1_000  # characters of a line that are searched
_LONGEST_MESSAGE = 4_000  # characters of a message in which a pair is searched beyond its last line
_MOST_STARTS = 50  # brackets at which a JSON value may begin
_ITEM_KEYS = (
    ("first", "second"),
    ("first_item", "second_item"),
    ("a", "b"),
    ("item1", "item2"),
    ("item_1", "item_2"),
    ("item_a", "item_b"),
    ("ingredient1", "ingredient2"),
    ("ingredient_1", "ingredient_2"),
    ("ingredient_a", "ingredient_b"),
)
_ANSWER_KEYS = (
    "answer",
    "final_answer",
    "pair",
    "items",
    "ingredients",
    "combination",
    "combine",
    "choice",
)
_LABEL_KEYS = ("name", "item", "label")
"""Keys of an item that is written as an object, such as ``{"name": "water"}``."""
_CALL_KEYS = ("arguments", "parameters", "args", "input")
"""Keys of a tool call's arguments, an object or its JSON text."""
_REASONING = re.compile(
    r"<(think|thinking|thought|thoughts|reasoning|scratchpad)>.*?(?:</\1>|\Z)",
    re.IGNORECASE | re.DOTALL,
)
# Some chat templates write the opening tag into the prompt, so the message has the end alone.
_END_OF_REASONING = re.compile(r"\A.*</(?:think|thinking|reasoning)>", re.IGNORECASE | re.DOTALL)
_TURN = re.compile(r"<[|｜][^<>\n]{1,60}[|｜]>|\[/?INST\]")
# With characters that show nothing.
_INLINE_TAG = re.compile(
    r"</?(?:b|i|u|em|strong|code|span|mark|kbd|tt)>|[\u200b\ufeff]", re.IGNORECASE
)
_ELEMENT = re.compile(r"<([A-Za-z_]\w{0,30})>([^<>]{0,1000})</\1>")
_TAG = re.compile(r"</?([A-Za-z_][\w:-]{0,40})(?:[=\s][^<>\n]{0,100})?/?>")
_PLUS = "\uff0b\ufe62\u2795"
"""The plus sign in full width, small, and as a picture."""
_NAME = r"(?:final\s+)?(?:answer|choice|pair|combination|solution|action)"
_MARKER = re.compile(rf"\b{_NAME}\b[\s*_]*(?:is\b|:|=)[\s:*_]*", re.IGNORECASE)
_CALL = re.compile(r"\b(?:combine|craft|mix|attempt)\w{0,20}\s*\(([^()\n]{1,500})\)", re.IGNORECASE)
_PARAMETER = re.compile(r"\b\w{1,30}\s*=(?!=)\s*")
_NAMED_LINE = re.compile(
    r"^[ \t*_>#-]*([A-Za-z][\w ]{0,20}?)[\s*_`]*[:=][\s*_`]*(\S.{0,300}?)[\s,]*$", re.M
)
_LINE_MARKS = " \t*•+-"
_VERB = re.compile(r"^(?:i\s+)?(?:combine|mix|try|answer)\b[\s:]*", re.IGNORECASE)
_SEPARATOR = re.compile(r"\s*[&,;]\s*(?:and\s+)?|\s+(?:and|with|plus|then)\s+", re.IGNORECASE)
_SIGN = re.compile(r"\s*\+\s*")
_BLANK = re.compile(r"\s+")
_NUMBERS = re.compile(r"\d+(?:\s+\d+)+", re.ASCII)
_BRACES = r"\{(?:[^{}]|\{[^{}]*+\})*+\}"
# A look ahead, so that a box in a box is one, too.
_BOXED = re.compile(rf"(?=\\boxed\s*\{{((?:[^{{}}]|{_BRACES})*+)\}})")
_LATEX_TEXT = re.compile(r"\\(?:text|textbf|textit|mathrm|mathbf|mbox)\s*\{([^{}]*)\}")
_LATEX_MARK = re.compile(r"\\[()\[\], ]|\\q?quad\b|\$")
_AROUND = r"[\s*_`'\"“”‘’«»()\[\]]*"
_JOINER = re.compile(
    rf"{_AROUND}(?:(?P<sign>[+&])|[,;]"
    rf"|,?\s*\b(?:and|(?:(?:together|combined)\s+)?with|plus|then)\b){_AROUND}",
    re.IGNORECASE,
)
_JOINED_BEFORE = re.compile(rf"(?:{_JOINER.pattern})\Z", re.IGNORECASE)
_ALTERNATIVE = re.compile(rf"{_AROUND}(?:,?\s*\bor\b|/){_AROUND}", re.IGNORECASE)
_MADE = re.compile(r"(?:=>|->|=|→)[^+&]*$")
_NEGATION = re.compile(
    r"\b(?:no|not|never|neither|nor|cannot|without|except|avoid|instead\s+of|rather\s+than)\b"
    r"|n['’]t\b",
    re.IGNORECASE,
)
_LIST_NUMBER = re.compile(r"\d+[.)]\s*")
_NUMBER_BEFORE = re.compile(r"(?:^|\s)\(?#?\d+[.):]?\s*$")
_COUNT = re.compile(r"\b(?:one|1\s?[x×])\s+(?=\w)", re.IGNORECASE)
_ITEM_NUMBERS = re.compile(
    r"(?:\bitems?\s+(?:numbers?\s+)?#?(\d{1,4})\s*(?:[+&,]|and|with)\s*(?:item\s+)?"
    r"|(?<![\w.+-])#?(\d{1,4})\s*\+\s*)#?(\d{1,4})\b(?!\s*(?:[+&,/]|or\b|and\b)\s*#?\d)",
    re.IGNORECASE,
)


class _NoPair(ActionError):
    """A text names no pair, so another part of the message may be the answer."""


def read_answer(message: str, labels: Sequence[str]) -> Pair:
    r"""Return the places of the two items that a message names, in written order.

    Args:
        message: text with any number of lines.
        labels: distinct labels of the items on the table, in the order of their numbers.

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
        >>> read_answer("<think>orchard + doctor?</think><answer>number + doctor</answer>", labels)
        (0, 2)
    """
    text = _without_reasoning(_with_plain_signs(message, labels))
    elements = _Pairs((match[1], match[2]) for match in _ELEMENT.finditer(text))
    pairs = list(_pairs_in_value(elements))
    text = _without_tags(text, labels)
    pairs = pairs or _in_last_json(text)
    if pairs:
        return _same([_in_line(last_line(answer), labels) for answer in pairs], labels)
    line = last_line(text)
    try:
        return _in_line(line, labels)
    except _NoPair:
        # An answer that was attempted and cannot be read is invalid, whatever stands before it.
        is_attempt = "+" in line or any(_marked(line))
        pair = None if is_attempt else _elsewhere(text, labels)
        if pair is None:
            raise
        return pair


def read_set(message: str, labels: Sequence[str], most: int) -> tuple[int, ...]:
    r"""Return the places of the items that a message names, with repetitions, in written order.

    JSON at the end of the message counts (``["a", "b", "c"]``, ``{"items": ["a", "b", "c"]}``, a
    tool call), else the last line, or a marked answer in it, as in :func:`read_answer`: items with
    ``+`` between them, or else with commas or ``and``; a label may hold these, too. Blanks between
    numbers are enough. A sentence counts if all its known items are joined. A result behind an
    arrow or equals sign is left out.

    Args:
        message: text with any number of lines.
        labels: distinct labels of the items on the table, in the order of their numbers.
        most: most items of a set.

    Raises:
        ActionError: if there is no item or more than ``most``, a text between two signs names no
            item, or there are several sets.

    Example:
        >>> read_set("So:\n2 + doctor + 2 = number", ["orchard", "doctor", "number"], 8)
        (1, 1, 1)
    """
    texts = _in_last_json(_plain(message, labels), are_sets=True)
    line = answer_line(message, labels)
    for marked in [] if texts else _marked(line):
        texts += _in_last_json(marked, are_sets=True) or [_without_latex(marked)]
    found = [_set_in(text, labels, most) for text in texts or [line]]
    if len({tuple(sorted(places)) for places in found}) > 1:
        raise ActionError(
            f"the answer has {len(found)} different sets: expected one. Write it in the last line."
        )
    return found[0]


def _set_in(text: str, labels: Sequence[str], most: int) -> tuple[int, ...]:
    """Return the places of the items that a text lists, or of the joined ones in a sentence.

    Args:
        text: a line without markup around it.
        labels: distinct labels of the items on the table, in the order of their numbers.
        most: most items of a set.

    Raises:
        ActionError: if it lists no items, too many or unknown ones, and is no clear sentence; or
            if it is long.
    """
    if len(text) > _LONGEST:
        raise ActionError(
            f"the answer has {len(text):,} characters: expected 1 to {most} items, such as "
            f"'{labels[0]} + {labels[-1]}', in a short line."
        )
    line = _MADE.sub("", _VERB.sub("", text)).strip(_LINE_MARKS + ".`")
    try:
        return _listed(line, labels, most)
    except ActionError:
        places = _joined_items(text, labels)
        if not 0 < len(places) <= most:
            raise
        return places


def _joined_items(sentence: str, labels: Sequence[str]) -> tuple[int, ...]:
    """Return the places of the known items in a sentence, if joiners connect all of them.

    Empty with a negation, question or alternative, and if a joiner leads to something unknown: a
    set that lacks an item is another attempt.
    """
    text = _MADE.sub("", sentence)
    items = list(_items(text, index_of(tuple(labels))))
    pairs, _, is_clear = _mentions(text, labels)
    if not items or len(pairs) != len(items) - 1 or not is_clear:
        return ()
    is_cut = _JOINED_BEFORE.search(text[: items[0].start]) or _JOINER.match(text, items[-1].end)
    return () if is_cut or len(items) < 2 else tuple(item.place for item in items)


def _listed(line: str, labels: Sequence[str], most: int) -> tuple[int, ...]:
    """Return the places of the items that a line lists, the longest whole labels first.

    So ``salt and pepper and oil`` has two items if the first one is on the table.

    Args:
        line: items with separators between them.
        labels: distinct labels of the items on the table, in the order of their numbers.
        most: most items of a set.

    Raises:
        ActionError: if there is no item or more than ``most``, or a text names no item.
    """
    index = index_of(tuple(labels))
    separator = _BLANK if _NUMBERS.fullmatch(line) else _SIGN if "+" in line else _SEPARATOR
    cuts = [match.span() for match in separator.finditer(line)]
    starts = [0, *(end for _, end in cuts)] if line else []
    ends = [*(start for start, _ in cuts), len(line)]
    places = []
    piece = 0
    while piece < len(starts):
        # A label may hold separators: pieces are joined as far as they name it in full.
        for last in range(min(len(starts), piece + index.most_words) - 1, piece - 1, -1):
            text = " ".join(line[starts[piece] : ends[last]].split())
            named = places_named(text, index, by_number=True)
            if len(named) == 1:
                break
        else:
            named = [read_label(text, labels)]
            label = labels[named[0]]
            if cuts and separator.search(label):
                raise ActionError(
                    f"'{text}' is only the beginning of '{label}', which is one item: expected "
                    "whole names between the separators. Write the whole name, or the number."
                )
        places += named
        piece = last + 1
    if not 0 < len(places) <= most:
        raise ActionError(
            f"{len(places)} items: expected 1 to {most}, such as '{labels[0]} + {labels[-1]}'."
        )
    return tuple(places)


def answer_line(message: str, labels: Sequence[str]) -> str:
    """Return the last line of a message, without reasoning in tags, marks of turns and markup."""
    return last_line(_plain(message, labels))


def _plain(message: str, labels: Sequence[str]) -> str:
    """Return a message without reasoning in tags, marks of turns and markup."""
    text = _without_reasoning(_with_plain_signs(message, labels))
    return _without_tags(text, labels)


def _with_plain_signs(message: str, labels: Sequence[str]) -> str:
    """Return a message without marks of turns, and with the usual sign for each plus.

    A sign that belongs to a label stays.
    """
    text = _TURN.sub("\n", message)
    for sign in _PLUS:
        if sign in text and not any(sign in label for label in labels):
            text = text.replace(sign, "+")
    return text


def _without_reasoning(text: str) -> str:
    """Return a text without reasoning in tags, and without tags of bold or other type."""
    text = _REASONING.sub("\n", text)
    if "</" in text:
        text = _END_OF_REASONING.sub("", text)
    return _INLINE_TAG.sub("", text)


def _without_tags(text: str, labels: Sequence[str]) -> str:
    """Return a text with a line break for each tag; an item in angle brackets is no tag."""
    if "<" not in text:
        return text
    index = index_of(tuple(labels))
    # A label of several words looks like a tag with an attribute.
    return _TAG.sub(lambda tag: "\n" if index.find(tag[0].strip("</>")) is None else tag[0], text)


def _in_line(line: str, labels: Sequence[str]) -> Pair:
    """Return the pair that a line names as a whole, as a marked answer, or as its only pair.

    Raises:
        _NoPair: if the line names none.
        ActionError: if it could name several.
    """
    try:
        pair = read_pair(line, labels)
    except ActionError as error:
        # A count such as `one` may belong to a label, so the line as it is comes first.
        pairs = _in_sentence(line, labels) or _in_sentence(_COUNT.sub("", line), labels)
        if not pairs:
            raise _NoPair(str(error)) from None
        return _same(pairs, labels)
    # `a + b = c, c + d = e` reads as `a + b` if all behind the sign were ignored.
    _, by_sign, _ = _mentions(line, labels)
    return _same([pair, *by_sign], labels)


def _elsewhere(text: str, labels: Sequence[str]) -> Pair | None:
    """Return the only pair in a message, or None.

    Raises:
        ActionError: if there are several pairs, or a sentence may not mean its pair.
    """
    if len(text) > _LONGEST_MESSAGE:
        return None
    named = _Pairs((match[1], match[2]) for match in _NAMED_LINE.finditer(text))
    values = [value for _, value in _json_values(text)]
    written = [pair for value in (*values, named) for pair in _pairs_in_value(value)]
    pairs = []
    for answer in written or _marked(text):
        with suppress(_NoPair):
            pairs.append(_in_line(last_line(answer), labels))
    if pairs:
        return _same(pairs, labels)
    lines = [line for line in text.splitlines() if line.strip(_LINE_MARKS)]
    for line in lines:
        pairs += _only_pair(line, labels)
    if not pairs and len(lines) == 2:
        # An item in each line.
        index = index_of(tuple(labels))
        first, second = (_LIST_NUMBER.sub("", line.strip(_LINE_MARKS), count=1) for line in lines)
        firsts = places_named(" ".join(first.split()), index, by_number=True)
        seconds = places_named(" ".join(second.split()), index, by_number=True)
        pairs += product(firsts, seconds)
    return _same(pairs, labels) if pairs else None


def _same(pairs: Sequence[Pair], labels: Sequence[str]) -> Pair:
    """Return the first pair.

    Raises:
        ActionError: if the pairs differ in more than order, which a recipe does not have.
    """
    different = {tuple(sorted(pair)): pair for pair in pairs}
    if len(different) > 1:
        ways = " or ".join(
            f"{labels[first]} + {labels[second]}" for first, second in different.values()
        )
        raise ActionError(
            f"the answer could mean several pairs: {ways[:200]}. Write one pair in the last line."
        )
    return pairs[0]


def _in_sentence(line: str, labels: Sequence[str]) -> list[Pair]:
    """Return the marked pairs in a line, or else its only pair; an empty list if there is none.

    Raises:
        ActionError: if there are several pairs, or the sentence may not mean its pair.
    """
    pairs = []
    for text in _marked(line) or [line]:
        bare = _without_latex(text)
        try:
            pairs.append(read_pair(bare, labels))
        except ActionError:
            pairs += _only_pair(bare, labels)
    return pairs


def _marked(text: str) -> list[str]:
    """Return the texts that are marked as the answer, in boxes or calls, or by the last marker."""
    calls = [_PARAMETER.sub("", call[1]) for call in _CALL.finditer(text)]
    enclosed = [*_BOXED.findall(text), *calls]
    markers = list(_MARKER.finditer(text))
    if enclosed or not markers:
        return enclosed
    # The marker takes line breaks with it: the answer may stand in the next line.
    return [text[markers[-1].end() :][:_LONGEST].partition("\n")[0]]


def _without_latex(text: str) -> str:
    r"""Return the text of a formula, such as ``a + b`` for ``\text{a} + \text{b}``."""
    return _LATEX_MARK.sub(" ", _LATEX_TEXT.sub(r" \1 ", text)).strip()


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


def _only_pair(line: str, labels: Sequence[str]) -> list[Pair]:
    """Return the only pair in a sentence, in a list; an empty list if there is none.

    Raises:
        ActionError: if there are several pairs, or the sentence may not mean its pair.
    """
    pairs, _, is_clear = _mentions(line, labels)
    if not pairs:
        return []
    pair = _same(pairs, labels)
    if not is_clear:
        raise ActionError(
            f"the answer mentions {labels[pair[0]]} + {labels[pair[1]]}, but with a negation, a "
            "question, an alternative, or other items. Write the pair alone in the last line."
        )
    return [pair]


def _with_names(numbers: re.Match[str], labels: Sequence[str]) -> str:
    """Return two items by their names where a sentence has their numbers, as ``items 1 and 9``.

    Text in which a number or the word before it may belong to a label stays as it is.
    """
    digits = [number for number in numbers.groups() if number]
    places = [int(number) - 1 for number in digits]
    is_named = any(label in digits or label.casefold().startswith("item") for label in labels)
    if is_named or not all(0 <= place < len(labels) for place in places):
        return numbers[0]
    return " + ".join(labels[place] for place in places)


def _mentions(line: str, labels: Sequence[str]) -> tuple[list[Pair], list[Pair], bool]:
    """Return all pairs of neighbouring items in a line with a joiner between them.

    The text behind an arrow or equals sign is the result, and is left out.

    Returns:
        the pairs, from left to right, as places on the table in written order; those of them whose
        joiner is ``+`` or ``&``, not a word or a comma; and whether there is no negation,
        alternative or question, and no sign without a known item.
    """
    text = _ITEM_NUMBERS.sub(partial(_with_names, labels=labels), line[:_LONGEST])
    text = _MADE.sub("", text)
    items = list(_items(text, index_of(tuple(labels))))
    pairs: list[Pair] = []
    by_sign: list[Pair] = []
    if not items:
        return [], [], False
    gaps = [text[: items[0].start]]  # text that joins no items
    is_clear = not text.rstrip().endswith("?")
    for left, right in pairwise(items):
        between = text[left.end : right.start]
        joiner = _JOINER.fullmatch(between)
        if joiner:
            pair = (left.place, right.place)
            pairs.append(pair)
            if joiner["sign"]:
                by_sign.append(pair)
        elif _ALTERNATIVE.fullmatch(between):
            is_clear = False
        else:
            gaps.append(between)
    gaps.append(text[items[-1].end :])
    for gap in gaps:
        is_clear &= not _NEGATION.search(gap) and "+" not in gap
    for item in items:
        before = _LIST_NUMBER.sub("", text[: item.start], count=1)
        is_clear &= not _NUMBER_BEFORE.search(before)  # the number of another item
    return pairs, by_sign, is_clear


def _items(text: str, index: LabelIndex) -> Iterator[_Item]:
    """Yield the known items in a text from left to right, the longest at each word."""
    words = list(WORDS.finditer(text))
    most_words = index.most_words + 2  # an article and the item's number
    start = 0
    while start < len(words):
        # The longest first: `fire brigade` is not the item `fire`.
        for end in range(min(start + most_words, len(words)), start, -1):
            first = words[start]
            last = words[end - 1]
            if first[0] in ",;" or last[0] in ",;":
                continue
            mention = " ".join(text[first.start() : last.end()].split())
            places = places_named(mention, index, by_number=True)
            is_bare_place = mention.isdigit() and index.place_of(mention) is None
            if len(places) == 1 and not is_bare_place:
                yield _Item(first.start(), last.end(), places[0])
                start = end
                break
        else:
            start += 1


def _in_last_json(text: str, *, are_sets: bool = False) -> list[str]:
    """Return the pairs, or sets of any size, in a JSON value at the end of a message, as texts."""
    end = text.strip().removesuffix("```").rstrip()[-_LONGEST:]
    for place, value in _json_values(end):
        if place == len(end):
            return list(_pairs_in_value(value, are_sets=are_sets))
    return []


def _json_values(text: str) -> Iterator[tuple[int, Any]]:
    """Yield the outermost JSON objects and lists in a text, each with the place behind it."""
    decoder = json.JSONDecoder(object_pairs_hook=_Pairs)
    starts = [place for place, char in enumerate(text) if char in "{["][:_MOST_STARTS]
    # Some models write the quotes of Python.
    spellings = (text, text.replace("'", '"'))
    behind = 0
    for start in starts:
        if start < behind:
            continue
        for spelling in spellings:
            with suppress(ValueError, RecursionError):
                value, behind = decoder.raw_decode(spelling, start)
                yield behind, value
                break


class _Pairs(list[tuple[str, Any]]):
    """The members of a JSON object in order; a name may be repeated."""


def _pairs_in_value(value: Any, name: str = "answer", *, are_sets: bool = False) -> Iterator[str]:
    """Yield the pairs in a JSON value, as texts; names that are repeated give several pairs.

    Args:
        value: a value of :func:`_json_values`, or a member of one.
        name: name of the member in its object; the values of other names than answers are answers
            if they are objects, lists of objects, or a call's arguments.
        are_sets: whether a list may have more than two items, and no item has a name of its own.
    """
    is_answer = name in _ANSWER_KEYS
    if isinstance(value, _Pairs):
        members = [(key.casefold().strip().replace(" ", "_"), member) for key, member in value]
        if not are_sets:
            yield from _named_pairs(members)
        for key, member in members:
            yield from _pairs_in_value(member, key, are_sets=are_sets)
    elif isinstance(value, str) and (is_answer or name in _CALL_KEYS):
        values = [nested for _, nested in _json_values(value[:_LONGEST])]
        for nested in values:
            yield from _pairs_in_value(nested, are_sets=are_sets)
        if is_answer and not values:
            yield value
    elif isinstance(value, list):
        # The calls of a message; other lists of texts, such as the table, are no answers.
        entries = [entry for entry in value if is_answer or isinstance(entry, _Pairs)]
        yield from _pairs_in_list(entries, are_sets=are_sets)


def _pairs_in_list(entries: Sequence[Any], *, are_sets: bool) -> Iterator[str]:
    """Yield the items in a JSON list as a pair or set, or the pairs in its objects."""
    items = [_item(entry) for entry in entries]
    if all(items) and (len(items) == 2 or (are_sets and len(items) > 2)):
        yield " + ".join(items)
    elif len(entries) == 1 and isinstance(entries[0], str):
        yield entries[0]
    else:
        for entry in entries:
            if isinstance(entry, _Pairs):
                yield from _pairs_in_value(entry, are_sets=are_sets)


def _named_pairs(members: Sequence[tuple[str, Any]]) -> Iterator[str]:
    """Yield the pairs of items that are named as first and second, or in a similar way."""
    for first_key, second_key in _ITEM_KEYS:
        firsts = [_item(member) for name, member in members if name == first_key]
        seconds = [_item(member) for name, member in members if name == second_key]
        for first, second in product(firsts, seconds):
            if first and second:
                yield f"{first} + {second}"


def _item(value: Any) -> str:
    """Return the item in a JSON value as text; empty if the value is none."""
    if isinstance(value, _Pairs):
        labels = [member for name, member in value if name in _LABEL_KEYS]
        value = labels[0] if len(labels) == len(value) == 1 else None
    # A bool is an int in Python.
    is_item = isinstance(value, str | int) and not isinstance(value, bool)
    return str(value) if is_item else ""
