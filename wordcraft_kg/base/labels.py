"""Parser for entity labels in texts by people and models.

Different spellings are accepted if the match is unique: forgiving where only one label can be
meant, strict where a text is ambiguous. :mod:`wordcraft_kg.base.answers` reads whole messages by
these rules; both together are the answer grammar.
"""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property, lru_cache
from itertools import chain

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.base.wording import SIGNS, listed, quoted, signs_of, without_variation_selectors

ANSWER_GRAMMAR = 3
"""Version of the rules by which texts are read as items, as recorded with games."""
_MOST_CHOICES = 8  # labels that an error about an ambiguous word names
_MOST_SHOWN = 40  # characters of the input that an error repeats
_MOST_WRITTEN = 1_000  # characters in which two labels are searched
_MOST_AROUND = 200  # characters around a label in a text for an index: blanks, quotes, an article
_ARTICLE = re.compile(r"^(?:an?|the|some)\s+(?=\S)")
_MARKS = " \t*_`'\"“”‘’«».,;:!?()[]{}<>"
_VERB = re.compile(r"^(?:i\s+)?(?:combine|mix|pair|pick|try|attempt|answer)\b[\s:]*", re.IGNORECASE)
_MADE = re.compile(r"\s*(?:=>|->|=|→).*$")
_SEPARATOR = re.compile(r"\s*[+&,;]\s*|\s+(?:and|with|plus|then)\s+", re.IGNORECASE)
WORDS = re.compile(r"[^\s+&,;]+|[+&,;]")
"""Words and separators in a text."""
_LIST_MARK = re.compile(r"^(?:[-*•>#]+\s+)+")
_TWO_NUMBERS = re.compile(r"[-+]?\d+\s+[-+]?\d+", re.ASCII)
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)*", re.ASCII)
_FRACTION = re.compile(r"\.\d", re.ASCII)
_ENDINGS = {"y": "ies", "f": "ves", "fe": "ves"}
"""Endings of the plural by those of the singular."""
_PLACE = re.compile(r"[1-9]\d{0,8}", re.ASCII)  # as many digits as a table can need
# An item as prompts print it (`2 orchard`), or as errors do (`orchard (2)`).
_PRINTED = re.compile(
    r"\(?#?(?P<before>\d{1,9})[.):]?\s+(?P<first>.+)|(?P<last>.+?)\s+\(#?(?P<after>\d{1,9})\)",
    re.ASCII,
)


def folded(text: str) -> str:
    """Return text in a normal form for comparison.

    Differences in case, Unicode form, variation selectors, blanks and hyphens disappear.
    """
    text = without_variation_selectors(text)
    usual = unicodedata.normalize("NFKC", text)
    spaced = re.sub("[-_]", " ", usual.casefold())
    return " ".join(spaced.split())


def read_label(
    written: str,
    labels: Sequence[str],
    *,
    by_number: bool = True,
) -> int:
    """Return the index of the label that a text names.

    The first matching rule decides: exact label; number from 1; case-insensitive label; label
    without article, quotes and punctuation; singular or plural; number and label as printed (``2
    orchard``), or a 1 that counts the item (``1 orchard``); label prefix. A number is never the
    spelling or the prefix of another label, and signs belong to a name: ``C-`` is not ``C``.

    Args:
        written: text that names a label.
        labels: distinct labels, in the order of their numbers.
        by_number: whether numbers from 1 are accepted as places.

    Returns:
        Index in ``labels``.

    Raises:
        ActionError: if no label or several labels fit.

    Example:
        >>> labels = ["water", "fire", "fire brigade", "berry"]
        >>> [read_label(text, labels) for text in ("The Water", "berries", "fire")]
        [0, 3, 1]
    """
    meant = _meant(written, labels, by_number=by_number)
    if len(meant) == 1:
        return meant[0]
    text = " ".join(written.split())
    if meant:
        shown_places = meant[:_MOST_CHOICES]
        choices = [quoted(labels[place]) for place in shown_places]
        remedy = "Write more of the name"
        if by_number:
            choices = [f"{quoted(labels[place])} ({place + 1})" for place in shown_places]
            remedy += ", or the number"
        shown = listed(choices, _MOST_CHOICES, len(meant))
        raise ActionError(f"'{_shown(text)}' is ambiguous: {shown}. {remedy}.")
    numbers = f"1 to {len(labels)}, " if by_number else ""
    expected = f"expected {numbers}an item name, or the start of a name"
    if not text:
        raise ActionError(f"no answer: {expected}.")
    similar = nearest(text[:100].casefold(), labels)
    raise ActionError(f"unknown item {_shown(text)!r}: {expected}.{similar}")


class LabelIndex:
    """An index of entity labels for many texts; case, articles and plurals may differ.

    Signs at the ends of a name may not: ``C-`` is not ``C``, and ``-7`` not ``7``.
    """

    def __init__(self, labels: Sequence[str]):
        # A text much longer than any label names none, and would take long to compare.
        longest_label = max(map(len, labels), default=0)
        self._longest = _MOST_AROUND + 4 * longest_label
        # Each form of a label is made once: there may be thousands of labels and texts.
        self._exact = {label: place for place, label in enumerate(labels)}
        self._plain: list[str] = []
        self._signs: list[tuple[str, str]] = []
        self._folded: dict[str, set[int]] = defaultdict(set)
        self._bare: dict[str, set[int]] = defaultdict(set)
        self._plural: dict[str, set[int]] = defaultdict(set)
        for place, label in enumerate(labels):
            plain, bare, signs, plurals = _forms(label)
            self._plain.append(plain)
            self._signs.append(signs)
            self._folded[plain].add(place)
            self._bare[bare].add(place)
            for form in plurals:
                self._plural[form].add(place)

    def __len__(self) -> int:
        return len(self._plain)

    @cached_property
    def most_words(self) -> int:
        """Number of words and separators in the longest label."""
        numbers = [len(WORDS.findall(label)) for label in self._exact]
        return max(numbers, default=0)

    def place_of(self, label: str) -> int | None:
        """Return the index of an exact label, or None."""
        return self._exact.get(label)

    def find(self, written: str) -> int | None:
        """Return the index of the label that a text names; None without a unique match.

        The rules are those of :meth:`places`; a text of blanks, or much longer than any label,
        names none.

        Args:
            written: a text, with any blanks.

        Example:
            >>> index = LabelIndex(["water", "fire", "Fire", "berry"])
            >>> index.find("The Water"), index.find("berries"), index.find("FIRE")
            (0, 3, None)
        """
        text = " ".join(written.split())
        # A text that is longer than any label can be: not worth the comparisons.
        if not text or len(written) > self._longest:
            return None
        places = self.places(text)
        return places[0] if len(places) == 1 else None

    def places(self, text: str, *, by_beginning: bool = False) -> list[int]:
        """Return the indices of all labels that a text may name, by the first rule that fits.

        The rules are those of :func:`read_label` but for numbers: here a number is a text like any
        other, never a place, and may be the beginning of a label.

        Args:
            text: text without repeated blanks.
            by_beginning: whether a text may be the prefix of a label.

        Returns:
            Indices in ascending order; empty without a match.
        """
        if text in self._exact:
            return [self._exact[text]]
        plain = folded(text)
        without_marks = _bare(text)
        # The text is the plural of a label, or a label is the plural of the text.
        in_plural = set(self._plural.get(without_marks, ()))
        for form in _plurals(without_marks):
            in_plural |= self._bare.get(form, set())
        signs = _signs(text)
        by_rule = (self._folded.get(plain), self._bare.get(without_marks), in_plural)
        for places in by_rule:
            matches = [place for place in places or () if self._signs[place] == signs]
            if matches:
                return sorted(matches)
        # The sign at an end is not the beginning of a longer name.
        if not by_beginning or signs[1]:
            return []
        # Searched in turn: beginnings come last, and rarely.
        beginnings = enumerate(self._plain)
        matches = [place for place, label in beginnings if label.startswith(plain)]
        # A label without its sign is another label, not a beginning.
        return [place for place in matches if self._plain[place].rstrip(SIGNS) != plain]


index_of = lru_cache(maxsize=64)(LabelIndex)
"""Return the :class:`LabelIndex` of a tuple of labels; the last ones are kept."""


def read_pair(written: str, labels: Sequence[str]) -> tuple[int, int]:
    """Return the indices of the two labels that a text such as ``water + earth`` names.

    Separators are ``+``, ``&``, comma, semicolon, ``and``, ``with``, ``plus`` and ``then``; a blank
    between two numbers is enough. A leading verb and a trailing result (``= mud``, ``-> mud``) are
    ignored. A label may contain a separator if the result is unambiguous.

    Args:
        written: text that names two labels.
        labels: distinct labels, in the order of their numbers.

    Returns:
        Two indices in ``labels``, in written order; they may be equal.

    Raises:
        ActionError: if the text does not name two labels, or could name several pairs.

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
    bare = _without_marks(text)
    # The text as it is comes first: a label may begin with a verb, or hold an arrow.
    without_result = _MADE.sub("", text)
    without_verb = _VERB.sub("", bare)
    without_both = _VERB.sub("", _MADE.sub("", bare))
    readings = (text, without_result, without_verb, without_both)
    for reading in dict.fromkeys(readings):
        pairs = _pairs_in(reading, labels)
        if len({tuple(sorted(pair)) for pair in pairs}) > 1:
            ways = " or ".join(f"{labels[first]} + {labels[second]}" for first, second in pairs)
            raise ActionError(
                f"'{_shown(text)}' is ambiguous: {ways}. Write the numbers, such as '1 2'."
            )
        if pairs:
            return pairs[0]
    for reading in readings:
        for half in chain.from_iterable(_halves(reading, labels)):
            read_label(half, labels)  # raises the error for the first half that names no item
    raise ActionError(f"cannot parse {_shown(text)!r}: {expected}.")


def last_line(message: str) -> str:
    """Return the answer in a message: the last non-empty line, without list marks and quotes."""
    marks = _MARKS + "-•>|#"
    lines = [line.strip() for line in message.splitlines() if line.strip(marks)]
    if not lines:
        return ""
    return _LIST_MARK.sub("", lines[-1]).strip("*`| \t")


def _meant(written: str, labels: Sequence[str], *, by_number: bool = True) -> list[int]:
    """Return the places of the labels that a text can mean, see :func:`read_label`."""
    text = " ".join(written.split())
    if not text:
        return []
    index = index_of(tuple(labels))
    places = places_named(text, index, by_number=by_number)
    # A number is never the prefix of a label: `1` must not mean the item `10`.
    if places or _NUMBER.fullmatch(text.strip(_MARKS)):
        return places
    return index.places(text, by_beginning=True)


def places_named(text: str, index: LabelIndex, *, by_number: bool) -> list[int]:
    """Return the places of the labels that a text names in full.

    Args:
        text: text without repeated blanks.
        index: the labels.
        by_number: whether numbers from 1 are accepted as places.

    Returns:
        Indices in ascending order; empty without a match.
    """
    number = _without_marks(text).removeprefix("#").replace("\u2212", "-")  # the minus sign
    if _NUMBER.fullmatch(number):
        # `-7` is not another spelling of `7`, though labels else may differ in hyphens.
        for spelling in (text, number):
            place = index.place_of(spelling)
            if place is not None:
                return [place]
        is_place = by_number and _PLACE.fullmatch(number) and int(number) <= len(index)
        return [int(number) - 1] if is_place else []
    places = index.places(text)
    if places or not by_number:
        return places
    return _printed(text, index)


def _printed(text: str, index: LabelIndex) -> list[int]:
    """Return the place of an item that is written with its number; empty if the two disagree.

    A 1 before another item counts it: small language models write ``1 noise + 1 clock`` for one of
    each, and a whole name says more than this number.
    """
    match = _PRINTED.fullmatch(text)
    if match is None:
        return []
    place = int(match["before"] or match["after"]) - 1
    label = match["first"] or match["last"]
    if _NUMBER.fullmatch(label):
        return [place] if index.place_of(label) == place else []
    if place in index.places(label, by_beginning=True):
        return [place]
    return index.places(label) if match["before"] == "1" else []


def _pairs_in(text: str, labels: Sequence[str]) -> list[tuple[int, int]]:
    """Return the distinct pairs that a text can name."""
    pairs: dict[tuple[int, int], None] = {}
    for halves in _halves(text, labels):
        first, second = (_meant(half, labels) for half in halves)
        if len(first) == 1 and len(second) == 1:
            pairs[first[0], second[0]] = None
    return list(pairs)


def _halves(text: str, labels: Sequence[str]) -> list[tuple[str, str]]:
    """Return all ways to divide a text into two items."""
    if _TWO_NUMBERS.fullmatch(text):
        first, second = text.split()
        # `2 -7` may also be the item `-7` as prompts print it, at place 2.
        is_one_item = bool(_printed(text, index_of(tuple(labels))))
        return [] if is_one_item else [(first, second)]
    separators = _SEPARATOR.finditer(text)
    return [(text[: match.start()], text[match.end() :]) for match in separators]


@lru_cache(maxsize=1 << 15)
def _forms(label: str) -> tuple[str, str, tuple[str, str], set[str]]:
    """Return a label's forms for comparison: folded, bare, its signs, and plurals of the bare form.

    Kept for many labels, because the tables of a book's games show the same labels again and again.
    """
    bare = _bare(label)
    return folded(label), bare, _signs(label), _plurals(bare)


def _bare(text: str) -> str:
    """Return a folded text without article, quotes and punctuation, unless nothing else is left."""
    plain = folded(text)
    without_article = _ARTICLE.sub("", plain.strip(_MARKS))
    return without_article.strip(_MARKS) or plain


def _signs(text: str) -> tuple[str, str]:
    """Return the signs that belong to the name in a text, without article and punctuation."""
    bare = _without_marks(text).lower()
    return signs_of(_ARTICLE.sub("", bare))


def _without_marks(text: str) -> str:
    """Return a text without quotes and punctuation at its ends; `.5` keeps its point."""
    with_points = text.rstrip(_MARKS).lstrip(_MARKS.replace(".", ""))
    return with_points if _FRACTION.match(with_points) else text.strip(_MARKS)


def _plurals(word: str) -> set[str]:
    """Return the possible plurals of a word, by the regular forms of English."""
    if len(word) < 2:
        return set()
    forms = {word + plural for plural in ("s", "es")}
    for singular, plural in _ENDINGS.items():
        if word.endswith(singular):
            forms.add(word.removesuffix(singular) + plural)
    return forms


def _shown(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
