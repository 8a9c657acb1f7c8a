"""Which label somebody means: forgiving where only one can be meant, strict where it is ambiguous."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import islice

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.settings import nearest

MOST_CHOICES = 8
"""How many of the labels that could be meant are named."""
MOST_SHOWN = 40
"""Characters of what was written that an error repeats."""
MOST_WRITTEN = 1_000
"""Characters in which two labels are looked for."""
MOST_AROUND = 200
"""Characters that may stand around a label among many texts: blanks, quotes, an article."""
_ARTICLE = re.compile(r"^(?:an?|the|some)\s+(?=\S)")
_MARKS = " \t*_`'\"“”‘’«».,;:!?()[]{}<>"
_VERB = re.compile(r"^(?:i\s+)?(?:combine|mix|pair|pick|try|attempt|answer)\b[\s:]*", re.IGNORECASE)
_MADE = re.compile(r"\s*(?:=>|->|=|→).*$")
_SEPARATOR = re.compile(r"\s*[+&,;]\s*|\s+(?:and|with|plus|then)\s+", re.IGNORECASE)
_LIST_MARK = re.compile(r"^(?:[-*•>#]+\s+)+")
_NUMBERS = re.compile(r"\d+\s+\d+")


def folded(text: str) -> str:
    """Return a text as it is compared: without case, one kind of each character, hyphens and underscores as blanks."""
    return " ".join(re.sub("[-_]", " ", unicodedata.normalize("NFKC", text).casefold()).split())


def read_label(written: str, labels: Sequence[str], *, by_number: bool = True, by_beginning: bool = True) -> int:
    """Return the place of the label that is meant.

    In this order, the first that fits one label counts: the label's number from 1; the label; the same in another
    case; without article, quotes and punctuation around it; in singular or plural; its beginning.

    Args:
        written: what somebody wrote.
        labels: the labels to choose from, all different.
        by_number: whether a number means a place.
        by_beginning: whether the beginning of a label means it.

    Raises:
        ActionError: if it means no label or several, with what would be understood.

    Example:
        >>> labels = ["water", "fire", "fire brigade", "berry"]
        >>> read_label("The Water", labels), read_label("berries", labels), read_label("fire", labels)
        (0, 3, 1)
    """
    meant = _meant(written, labels, by_number=by_number, by_beginning=by_beginning)
    if len(meant) == 1:
        return meant[0]
    text = " ".join(written.split())
    if meant:
        choices = (f"{labels[place]} ({place + 1})" if by_number else labels[place] for place in meant)
        shown = ", ".join(islice(choices, MOST_CHOICES))
        more = f" and {len(meant) - MOST_CHOICES} more" if len(meant) > MOST_CHOICES else ""
        way = "; write more of the word" + ", or the number" * by_number
        raise ActionError(f"'{_shown(text)}' could be {shown}{more}{way}.")
    ways = [f"1 to {len(labels)}"] * by_number + ["one of the words"] + ["the beginning of one"] * by_beginning
    expected = "expected " + (", ".join(ways[:-1]) + ", or " + ways[-1] if len(ways) > 1 else ways[0])
    if not text:
        raise ActionError(f"nothing written: {expected}.")
    raise ActionError(f"{_shown(text)!r}: {expected}.{nearest(folded(text)[:100], labels)}")


class LabelIndex:
    """Many texts read against the same labels, as :func:`read_label` does without numbers and beginnings."""

    def __init__(self, labels: Sequence[str]):
        """Take the labels to choose from, all different."""
        # What is much longer than any label means none, and many such texts would take long to compare.
        self._longest = MOST_AROUND + 4 * max(map(len, labels), default=0)
        self._exact = {label: place for place, label in enumerate(labels)}
        self._folded: dict[str, set[int]] = defaultdict(set)
        self._bare: dict[str, set[int]] = defaultdict(set)
        self._plural: dict[str, set[int]] = defaultdict(set)
        for place, label in enumerate(labels):
            bare = _bare(label)
            self._folded[folded(label)].add(place)
            self._bare[bare].add(place)
            for form in _plurals(bare):
                self._plural[form].add(place)

    def find(self, written: str) -> int | None:
        """Return the place of the label that is meant, None if it is none or could be several.

        Example:
            >>> index = LabelIndex(["water", "fire", "Fire", "berry"])
            >>> index.find("The Water"), index.find("berries"), index.find("FIRE")
            (0, 3, None)
        """
        text = " ".join(written.split()) if len(written) <= self._longest else ""
        if not text:
            return None
        if text in self._exact:
            return self._exact[text]
        bare = _bare(text)
        in_plural = self._plural.get(bare, set()).union(*(self._bare.get(form, ()) for form in _plurals(bare)))
        for meant in (self._folded.get(folded(text)), self._bare.get(bare), in_plural):
            if meant:
                return next(iter(meant)) if len(meant) == 1 else None
        return None


def read_pair(written: str, labels: Sequence[str]) -> tuple[int, int]:
    """Return the places of the two labels that are meant, in the order in which they are written.

    Between them is ``+``, ``&``, a comma, a semicolon, ``and``, ``with``, ``plus`` or ``then``; of two numbers only a
    blank. A verb before them and a result after them (``= mud``, ``-> mud``) are left out. A label that holds such a
    word itself is found, if there is only one way to read it all.

    Args:
        written: what somebody wrote.
        labels: the labels to choose from, all different.

    Raises:
        ActionError: if it does not mean two of the labels, or could mean several pairs.

    Example:
        >>> read_pair("Combine the water with earth", ["earth", "fire", "water"])
        (2, 0)
        >>> read_pair("2 2", ["earth", "fire", "water"])
        (1, 1)
    """
    text = " ".join(written.split())
    if not labels:
        raise ActionError("there is nothing to combine.")
    expected = f"expected two things, such as '{labels[0]} + {labels[-1]}'"
    if not text:
        raise ActionError(f"nothing written: {expected}.")
    if len(text) > MOST_WRITTEN:
        raise ActionError(f"{len(text):,} characters: {expected}, in one short line.")
    unread: list[str] = []
    bare = text.strip(_MARKS)
    readings = (text, _MADE.sub("", text), _VERB.sub("", bare), _VERB.sub("", _MADE.sub("", bare)))
    for reading in dict.fromkeys(readings):
        pairs = _pairs_in(reading, labels, unread)
        if len({tuple(sorted(pair)) for pair in pairs}) > 1:
            ways = " or ".join(f"{labels[one]} + {labels[other]}" for one, other in pairs)
            raise ActionError(f"'{_shown(text)}' could be {ways}; write the numbers, such as '1 2'.")
        if pairs:
            return pairs[0]
    if unread:
        read_label(unread[0], labels)  # raises the error for that half
    raise ActionError(f"{_shown(text)!r}: {expected}.")


def last_line(message: str) -> str:
    """Return the line of a message that counts as its answer: the last one that is not empty.

    List marks, quotes and the like around it are left out, as long as something is left.
    """
    lines = [line.strip() for line in message.splitlines() if line.strip(_MARKS + "-•>|#")]
    return _LIST_MARK.sub("", lines[-1]).strip("*`| \t") if lines else ""


def _meant(written: str, labels: Sequence[str], *, by_number: bool = True, by_beginning: bool = True) -> list[int]:
    """Return the places of the labels that can be meant, by the first way of :func:`read_label` that fits any."""
    text = " ".join(written.split())
    if not text:
        return []
    if by_number and text.isascii() and text.isdigit() and text[0] != "0" and len(text) < 10:
        place = int(text) - 1
        if place < len(labels):
            return [place]
    # Each form of what was written is made once: it may be long, and there may be thousands of labels.
    plain, bare = folded(text), _bare(text)
    plurals = _plurals(bare)
    ways: list[Callable[[str, str, str], bool]] = [
        lambda label, _plain, _bare: label == text,
        lambda _label, its_plain, _bare: its_plain == plain,
        lambda _label, _plain, its_bare: its_bare == bare,
        lambda _label, _plain, its_bare: its_bare in plurals or _is_plural(bare, its_bare),
        lambda _label, its_plain, _bare: by_beginning and its_plain.startswith(plain),
    ]
    forms = [(label, *_forms(label)) for label in labels]
    for fits in ways:
        if meant := [place for place, form in enumerate(forms) if fits(*form)]:
            return meant
    return []


def _pairs_in(text: str, labels: Sequence[str], unread: list[str]) -> list[tuple[int, int]]:
    """Return the different pairs of places that a text can mean; halves that mean no single label join ``unread``."""
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
    """Return a text without what may stand around a label."""
    return _ARTICLE.sub("", folded(text).strip(_MARKS)).strip(_MARKS) or folded(text)


@lru_cache(maxsize=2**15)
def _forms(label: str) -> tuple[str, str]:
    """Return a label as it is compared, and without what may stand around it; tables show the same ones again."""
    return folded(label), _bare(label)


def _is_plural(word: str, other: str) -> bool:
    """Return whether a text is another one in the plural, by the regular forms of English."""
    return word.startswith(other[:-2]) and word in _plurals(other)  # no ending changes more than two letters


def _plurals(word: str) -> set[str]:
    if len(word) < 2:
        return set()
    endings = {"y": "ies", "f": "ves"}
    forms = {word + "s", word + "es", word[:-1] + endings.get(word[-1], word[-1] + "s")}
    if word.endswith("fe"):
        forms.add(word[:-2] + "ves")
    return forms


def _shown(text: str) -> str:
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
