"""Parser for entity labels in texts by people and models; different spellings are accepted if the match is unique."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from itertools import islice

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.settings import nearest

_MOST_CHOICES = 8  # labels that an error about an ambiguous word names
_MOST_SHOWN = 40  # characters of the input that an error repeats
_MOST_WRITTEN = 1_000  # characters in which two labels are searched
_MOST_AROUND = 200  # characters around a label in a text for an index: blanks, quotes, an article
_ARTICLE = re.compile(r"^(?:an?|the|some)\s+(?=\S)")
_MARKS = " \t*_`'\"“”‘’«».,;:!?()[]{}<>"
_VERB = re.compile(r"^(?:i\s+)?(?:combine|mix|pair|pick|try|attempt|answer)\b[\s:]*", re.IGNORECASE)
_MADE = re.compile(r"\s*(?:=>|->|=|→).*$")
_SEPARATOR = re.compile(r"\s*[+&,;]\s*|\s+(?:and|with|plus|then)\s+", re.IGNORECASE)
_LIST_MARK = re.compile(r"^(?:[-*•>#]+\s+)+")
_NUMBERS = re.compile(r"\d+\s+\d+")


def folded(text: str) -> str:
    """Return text in a normal form for comparison, without differences in case, Unicode form, blanks and hyphens."""
    return " ".join(re.sub("[-_]", " ", unicodedata.normalize("NFKC", text).casefold()).split())


def read_label(written: str, labels: Sequence[str], *, by_number: bool = True) -> int:
    """Return the index of the label that a text names.

    The first matching rule decides: number from 1; exact label; case-insensitive label; label without article, quotes
    and punctuation; singular or plural; label prefix.

    ``labels`` are distinct; without ``by_number``, numbers are not accepted. Raises ActionError if no label or several
    labels fit.

    Example:
        >>> labels = ["water", "fire", "fire brigade", "berry"]
        >>> read_label("The Water", labels), read_label("berries", labels), read_label("fire", labels)
        (0, 3, 1)
    """
    meant = _meant(written, labels, by_number=by_number)
    if len(meant) == 1:
        return meant[0]
    text = " ".join(written.split())
    if meant:
        choices = (
            f"{labels[place]} ({place + 1})" if by_number else labels[place] for place in meant
        )
        shown = ", ".join(islice(choices, _MOST_CHOICES))
        more = f" and {len(meant) - _MOST_CHOICES} more" if len(meant) > _MOST_CHOICES else ""
        remedy = "Write more of the name" + ", or the number" * by_number
        raise ActionError(f"'{_shown(text)}' is ambiguous: {shown}{more}. {remedy}.")
    expected = f"expected {f'1 to {len(labels)}, ' * by_number}an item name, or the start of a name"
    if not text:
        raise ActionError(f"no answer: {expected}.")
    raise ActionError(
        f"unknown item {_shown(text)!r}: {expected}.{nearest(folded(text)[:100], labels)}"
    )


class LabelIndex:
    """An index of entity labels for many texts; case, articles and plurals may differ."""

    def __init__(self, labels: Sequence[str]):
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
        """Return the index of the label that a text names; None without a match or with several matches.

        Example:
            >>> index = LabelIndex(["water", "fire", "Fire", "berry"])
            >>> index.find("The Water"), index.find("berries"), index.find("FIRE")
            (0, 3, None)
        """
        text = " ".join(written.split()) if len(written) <= self._longest else ""
        places = self._places(text) if text else []
        return places[0] if len(places) == 1 else None

    def _places(self, text: str, *, by_beginning: bool = False) -> list[int]:
        if text in self._exact:
            return [self._exact[text]]
        plain, bare = folded(text), _bare(text)
        in_plural = self._plural.get(bare, set()).union(
            *(self._bare.get(form, ()) for form in _plurals(bare))
        )
        if meant := self._folded.get(plain) or self._bare.get(bare) or in_plural:
            return sorted(meant)
        return [
            place
            for place, label in enumerate(self._plain)
            if by_beginning and label.startswith(plain)
        ]


_index = lru_cache(maxsize=64)(LabelIndex)


def read_pair(written: str, labels: Sequence[str]) -> tuple[int, int]:
    """Return the indices of the two labels that a text such as ``water + earth`` names, in written order.

    Separators are ``+``, ``&``, comma, semicolon, ``and``, ``with``, ``plus`` and ``then``; a blank between two numbers
    is enough. A leading verb and a trailing result (``= mud``, ``-> mud``) are ignored. A label may contain a separator
    if the result is unambiguous. ActionError if the text does not name two labels, or could name several pairs.

    Example:
        >>> read_pair("Combine the water with earth", ["earth", "fire", "water"])
        (2, 0)
        >>> read_pair("2 2", ["earth", "fire", "water"])
        (1, 1)
    """
    text = " ".join(written.split())
    if not labels:
        raise ActionError("nothing to combine: expected at least one item.")
    expected = f"expected two items, such as '{labels[0]} + {labels[-1]}'"
    if not text:
        raise ActionError(f"no answer: {expected}.")
    if len(text) > _MOST_WRITTEN:
        raise ActionError(f"the answer has {len(text):,} characters: {expected}, in a short line.")
    unread: list[str] = []
    bare = text.strip(_MARKS)
    readings = (text, _MADE.sub("", text), _VERB.sub("", bare), _VERB.sub("", _MADE.sub("", bare)))
    for reading in dict.fromkeys(readings):
        pairs = _pairs_in(reading, labels, unread)
        if len({tuple(sorted(pair)) for pair in pairs}) > 1:
            ways = " or ".join(f"{labels[one]} + {labels[other]}" for one, other in pairs)
            raise ActionError(
                f"'{_shown(text)}' is ambiguous: {ways}. Write the numbers, such as '1 2'."
            )
        if pairs:
            return pairs[0]
    if unread:
        read_label(unread[0], labels)  # raises the error for that half
    raise ActionError(f"cannot parse {_shown(text)!r}: {expected}.")


def last_line(message: str) -> str:
    """Return the answer in a message: the last non-empty line, without list marks and quotes."""
    lines = [line.strip() for line in message.splitlines() if line.strip(_MARKS + "-•>|#")]
    return _LIST_MARK.sub("", lines[-1]).strip("*`| \t") if lines else ""


def _meant(written: str, labels: Sequence[str], *, by_number: bool = True) -> list[int]:
    text = " ".join(written.split())
    if not text:
        return []
    if by_number and text.isascii() and text.isdigit() and text[0] != "0" and len(text) < 10:
        place = int(text) - 1
        if place < len(labels):
            return [place]
    return _index(tuple(labels))._places(text, by_beginning=True)


def _pairs_in(text: str, labels: Sequence[str], unread: list[str]) -> list[tuple[int, int]]:
    """Return the distinct pairs; halves that name no single label join ``unread``."""
    pairs: dict[tuple[int, int], None] = {}
    for halves in _halves(text):
        meant = [_meant(half, labels) for half in halves]
        wrong = [half for half, places in zip(halves, meant, strict=True) if len(places) != 1]
        unread += wrong
        if not wrong:
            pairs[meant[0][0], meant[1][0]] = None
    return list(pairs)


def _halves(text: str) -> list[tuple[str, str]]:
    if _NUMBERS.fullmatch(text):
        one, other = text.split()
        return [(one, other)]
    return [(text[: at.start()], text[at.end() :]) for at in _SEPARATOR.finditer(text)]


def _bare(text: str) -> str:
    return _ARTICLE.sub("", folded(text).strip(_MARKS)).strip(_MARKS) or folded(text)


def _plurals(word: str) -> set[str]:
    if len(word) < 2:
        return set()
    endings = {"y": "ies", "f": "ves"}
    forms = {word + "s", word + "es", word[:-1] + endings.get(word[-1], word[-1] + "s")}
    if word.endswith("fe"):
        forms.add(word[:-2] + "ves")
    return forms


def _shown(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
