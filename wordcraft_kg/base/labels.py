"""Read entity labels in texts by people and models: forgiving where one label fits, else strict."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import lru_cache

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.settings import nearest

_MOST_CHOICES = 8  # labels that an error about an ambiguous word names
_MOST_SHOWN = 40  # characters of the input that an error repeats
_MOST_WRITTEN = 1_000  # characters in which two labels are searched; the search is quadratic
_MOST_AROUND = 200  # characters around a label in a text for an index: blanks, quotes, an article
_ARTICLE = re.compile(r"^(?:an?|the|some)\s+(?=\S)")
_MARKS = " \t*_`'\"“”‘’«».,;:!?()[]{}<>"
_VERB = re.compile(r"^(?:i\s+)?(?:combine|mix|pair|pick|try|attempt|answer)\b[\s:]*", re.IGNORECASE)
_MADE = re.compile(r"\s*(?:=>|->|=|→).*$")
_SEPARATOR = re.compile(r"\s*[+&,;]\s*|\s+(?:and|with|plus|then)\s+", re.IGNORECASE)
_LIST_MARK = re.compile(r"^(?:[-*•>#]+\s+)+")
_NUMBERS = re.compile(r"\d+\s+\d+")


def folded(text: str) -> str:
    """Return text as it is compared: without case, Unicode forms, repeated blanks and hyphens."""
    same_characters = unicodedata.normalize("NFKC", text).casefold()
    return _in_one_line(re.sub("[-_]", " ", same_characters))


def _in_one_line(text: str) -> str:
    """Return text with single blanks instead of line breaks and repeated blanks."""
    return " ".join(text.split())


def read_label(
    written: str,
    labels: Sequence[str],
    *,
    by_number: bool = True,
) -> int:
    """Return the index of the label that a text names.

    The first rule that fits any label decides: number from 1; exact label; case-insensitive label;
    label without article, quotes and punctuation; singular or plural; label prefix.

    Args:
        written: the text.
        labels: the labels to choose from, all different.
        by_number: whether a number such as ``2`` means the second label.

    Raises:
        ActionError: if no label or several labels fit; the message has the accepted answers.

    Example:
        >>> labels = ["water", "fire", "fire brigade", "berry"]
        >>> [read_label(text, labels) for text in ("The Water", "berries", "fire")]
        [0, 3, 1]
    """
    meant = _meant(written, labels, by_number=by_number)
    if len(meant) == 1:
        return meant[0]
    text = _in_one_line(written)
    if meant:
        raise _ambiguous(text, meant, labels, by_number=by_number)
    numbers = f"1 to {len(labels)}, " if by_number else ""
    expected = f"expected {numbers}an item name, or the start of a name"
    if not text:
        raise ActionError(f"no answer: {expected}.")
    # Similar labels are searched by the beginning of a long text, which may be a whole story.
    hint = nearest(folded(text)[:100], labels)
    raise ActionError(f"unknown item {_shown(text)!r}: {expected}.{hint}")


def _ambiguous(
    text: str,
    meant: list[int],
    labels: Sequence[str],
    *,
    by_number: bool,
) -> ActionError:
    choices = []
    for place in meant[:_MOST_CHOICES]:
        number = f" ({place + 1})" if by_number else ""
        choices.append(labels[place] + number)
    shown = ", ".join(choices)
    if len(meant) > _MOST_CHOICES:
        shown += f" and {len(meant) - _MOST_CHOICES} more"
    remedy = "Write more of the name, or the number." if by_number else "Write more of the name."
    return ActionError(f"'{_shown(text)}' is ambiguous: {shown}. {remedy}")


class LabelIndex:
    """An index of entity labels for many texts; case, articles and plurals may differ."""

    def __init__(self, labels: Sequence[str]):
        """Index the ``labels``, all different; a label's index is its place in the sequence."""
        # A text much longer than any label names none, and would take long to compare.
        self._longest = _MOST_AROUND + 4 * max(map(len, labels), default=0)
        self._exact = {label: place for place, label in enumerate(labels)}
        self._plain = [folded(label) for label in labels]
        self._folded: dict[str, set[int]] = defaultdict(set)
        self._bare: dict[str, set[int]] = defaultdict(set)
        self._plural: dict[str, set[int]] = defaultdict(set)
        for place, label in enumerate(labels):
            bare = _bare(label)
            self._folded[self._plain[place]].add(place)
            self._bare[bare].add(place)
            for form in _plurals(bare):
                self._plural[form].add(place)

    def find(self, written: str) -> int | None:
        """Return the index of the label that a text names; None if no label or several labels fit.

        Unlike :func:`read_label`, numbers and beginnings of labels mean nothing here.

        Example:
            >>> index = LabelIndex(["water", "fire", "Fire", "berry"])
            >>> index.find("The Water"), index.find("berries"), index.find("FIRE")
            (0, 3, None)
        """
        if len(written) > self._longest:
            return None
        text = _in_one_line(written)
        places = self.places(text) if text else []
        return places[0] if len(places) == 1 else None

    def places(self, text: str) -> list[int]:
        """Return the indices of all labels that fit a text by the first rule that fits any."""
        if text in self._exact:
            return [self._exact[text]]
        bare = _bare(text)
        # The text may be the plural of a label, or a label the plural of the text.
        in_plural = set(self._plural.get(bare, ()))
        for form in _plurals(bare):
            in_plural |= self._bare.get(form, set())
        meant = self._folded.get(folded(text)) or self._bare.get(bare) or in_plural
        return sorted(meant)

    def beginning_with(self, text: str) -> list[int]:
        """Return the indices of all labels that begin with a text, in any case."""
        beginning = folded(text)
        return [place for place, label in enumerate(self._plain) if label.startswith(beginning)]


@lru_cache(maxsize=64)
def _index(labels: tuple[str, ...]) -> LabelIndex:
    # Kept, because a game asks for the same labels at each of its attempts.
    return LabelIndex(labels)


def read_pair(written: str, labels: Sequence[str]) -> tuple[int, int]:
    """Return the indices of the two labels that a text such as ``water + earth`` names.

    Separators are ``+``, ``&``, comma, semicolon, ``and``, ``with``, ``plus`` and ``then``; a blank
    between two numbers is enough. A leading verb and a trailing result (``= mud``, ``-> mud``) are
    ignored. A label may contain a separator if only one reading of the text gives two labels.

    Args:
        written: the text.
        labels: the labels to choose from, all different.

    Returns:
        Two indices in written order; equal for an entity with itself.

    Raises:
        ActionError: if the text does not name two labels, or could name several pairs.

    Example:
        >>> read_pair("Combine the water with earth", ["earth", "fire", "water"])
        (2, 0)
        >>> read_pair("2 2", ["earth", "fire", "water"])
        (1, 1)
    """
    text = _in_one_line(written)
    if not labels:
        raise ActionError("nothing to combine: expected at least one item.")
    expected = f"expected two items, such as '{labels[0]} + {labels[-1]}'"
    if not text:
        raise ActionError(f"no answer: {expected}.")
    if len(text) > _MOST_WRITTEN:
        raise ActionError(f"the answer has {len(text):,} characters: {expected}, in a short line.")
    unread: list[str] = []
    # The first reading with a pair decides; a later one leaves more of the text out.
    for reading in _readings(text):
        pairs = _pairs_in(reading, labels, unread)
        unordered = {tuple(sorted(pair)) for pair in pairs}
        if len(unordered) > 1:
            ways = [f"{labels[one]} + {labels[other]}" for one, other in pairs]
            raise ActionError(
                f"'{_shown(text)}' is ambiguous: {' or '.join(ways)}. "
                "Write the numbers, such as '1 2'."
            )
        if pairs:
            return pairs[0]
    if unread:
        read_label(unread[0], labels)  # raises the error for that half
    raise ActionError(f"cannot parse {_shown(text)!r}: {expected}.")


def _readings(text: str) -> list[str]:
    """Return a text as written, then without a result, without a verb, and without both.

    The text as written comes first, because a label may contain a verb or an arrow.
    """
    bare = text.strip(_MARKS)
    without_result = _MADE.sub("", text)
    without_verb = _VERB.sub("", bare)
    without_both = _VERB.sub("", _MADE.sub("", bare))
    return list(dict.fromkeys([text, without_result, without_verb, without_both]))


def last_line(message: str) -> str:
    """Return the answer in a message: the last non-empty line, without list marks and quotes.

    Models explain first and answer last. A line of marks alone, such as the end of a code block,
    counts as empty.
    """
    lines = [line.strip() for line in message.splitlines() if line.strip(_MARKS + "-•>|#")]
    return _LIST_MARK.sub("", lines[-1]).strip("*`| \t") if lines else ""


def _meant(
    written: str,
    labels: Sequence[str],
    *,
    by_number: bool = True,
) -> list[int]:
    text = _in_one_line(written)
    if not text:
        return []
    # Ten digits or a leading zero are no place in a list, and "²" is a digit only for Python.
    is_number = text.isascii() and text.isdigit() and text[0] != "0" and len(text) < 10
    if by_number and is_number and int(text) <= len(labels):
        return [int(text) - 1]
    index = _index(tuple(labels))
    return index.places(text) or index.beginning_with(text)


def _pairs_in(
    text: str,
    labels: Sequence[str],
    unread: list[str],
) -> list[tuple[int, int]]:
    """Return the distinct pairs; halves that name no single label join ``unread``."""
    pairs: dict[tuple[int, int], None] = {}
    for halves in _halves(text):
        meant = [_meant(half, labels) for half in halves]
        for half, places in zip(halves, meant, strict=True):
            if len(places) != 1:
                unread.append(half)
        if all(len(places) == 1 for places in meant):
            pairs[meant[0][0], meant[1][0]] = None
    return list(pairs)


def _halves(text: str) -> Iterator[tuple[str, str]]:
    """Yield the parts before and after each separator."""
    if _NUMBERS.fullmatch(text):
        one, other = text.split()
        yield one, other
        return
    for at in _SEPARATOR.finditer(text):
        yield text[: at.start()], text[at.end() :]


def _bare(text: str) -> str:
    """Return folded text without marks around it and without an article, if anything is left."""
    without_article = _ARTICLE.sub("", folded(text).strip(_MARKS))
    return without_article.strip(_MARKS) or folded(text)


def _plurals(word: str) -> set[str]:
    """Return possible plurals: berry, berries; leaf, leaves; knife, knives; some are no words."""
    if len(word) < 2:
        return set()
    forms = {word + "s", word + "es"}
    # A form that is no word does no harm: it is compared with labels only.
    for ending, plural in {"y": "ies", "f": "ves", "fe": "ves"}.items():
        if word.endswith(ending):
            forms.add(word.removesuffix(ending) + plural)
    return forms


def _shown(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
