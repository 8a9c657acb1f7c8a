r"""Comparison of labels by their spelling: the same label, another spelling, or another thing.

A sign can be a part of the name: ``C`` and ``C-`` are an atom and an ion, ``7`` and ``-7`` two
numbers. So hyphens, points, apostrophes and blanks make no difference only between letters, as in
``ice-cream`` and ``icecream``; beside a digit, at the end, or between two single letters, they
count. Labels themselves are never changed: their keys are compared, and their words looked up, such
as for vectors. Answers in texts are read more leniently, see :mod:`wordcraft_kg.base.labels`.
"""

import re
import unicodedata
from collections.abc import Callable, Iterable
from itertools import chain, pairwise

_VARIATION_SELECTORS = re.compile("[\ufe00-\ufe0f\U000e0100-\U000e01ef]")
"""Characters that choose a picture of the character before them, such as the emoji form."""
_SAME_SHAPE = frozenset(("<wide>", "<narrow>", "<noBreak>"))
"""Kinds of decompositions that keep the meaning; superscripts and fractions change it."""
_SAME_SIGN = str.maketrans("\u2010\u2011\u2212\u2019_", "---' ")
"""Signs of other keyboards: two hyphens, minus, apostrophe; ids have ``_`` for a blank."""
_LETTER = r"[^\W\d_]"
# Between single letters a hyphen may be a minus sign or a bond: `a-b` is not `ab`.
_JOINER = re.compile(
    rf"(?<={_LETTER})[ '.]+(?={_LETTER})"
    rf"|(?<={_LETTER}{_LETTER})-(?={_LETTER})"
    rf"|(?<={_LETTER})-(?={_LETTER}{_LETTER})"
)
_BESIDE_DIGIT = re.compile(rf"(?<={_LETTER}) (?=\d)|(?<=\d) (?={_LETTER})")
_BETWEEN_WORDS = re.compile(r"(?<=\w)[-:/](?=\w)")
_NUMBER = re.compile(r"[-+]?[\d.,]*\d[\d.,]*")
SIGNS = "+-\u2212\u207a\u207b"
"""Plus, hyphen, minus, and the raised plus and minus."""
_NUMBER_SIGN = re.compile(r"[-+\u2212.](?=[.,]?\d)")
_CHARGE = re.compile(rf"(?<=\S)[{re.escape(SIGNS)}]+$")


def without_variation_selectors(text: str) -> str:
    """Return a text without the marks that choose a picture, such as the emoji form of a heart."""
    return text if text.isascii() else _VARIATION_SELECTORS.sub("", text)


def case_key(label: str) -> str:
    r"""Return a key that labels share if they differ only in case, width or variation selectors.

    Composed and decomposed characters are the same, too.

    Example:
        >>> case_key("LAVA") == case_key("Lava") == case_key("\uff2c\uff21\uff36\uff21")
        True
    """
    if label.isascii():
        return label.casefold()
    narrow = "".join(map(_in_usual_width, without_variation_selectors(label)))
    # Composed again: folding may decompose a character, such as the capital I with a dot.
    composed = unicodedata.normalize("NFC", narrow)
    return unicodedata.normalize("NFC", composed.casefold())


def spelling_key(label: str) -> str:
    """Return a key that labels share if they are probably spellings of one name.

    Example:
        >>> spelling_key("Ice_Cream") == spelling_key("ice-cream") == spelling_key("icecream")
        True
        >>> spelling_key("O2") == spelling_key("O2-") or spelling_key("1.0") == spelling_key("10")
        False
    """
    folded = case_key(label)
    words = " ".join(folded.translate(_SAME_SIGN).split())
    # A label of underscores alone is like no other label.
    joined = _JOINER.sub("", words)
    return _BESIDE_DIGIT.sub("", joined) or folded


def grouped(labels: Iterable[str], key: Callable[[str], str]) -> list[tuple[str, ...]]:
    """Return the groups of two or more labels with the same key, in order."""
    groups: dict[str, list[str]] = {}
    for label in labels:
        groups.setdefault(key(label), []).append(label)
    several = [group for group in groups.values() if len(group) > 1]
    return [tuple(group) for group in several]


def means_another(label: str, other: str) -> bool:
    """Return whether two labels look alike, but surely name different things.

    These are different numbers, and labels that differ only in plus and minus signs at their ends.

    Example:
        >>> means_another("7", "-7"), means_another("C", "C-"), means_another("watr", "water")
        (True, True, False)
    """
    one = spelling_key(label)
    two = spelling_key(other)
    if one == two:
        return False
    has_number = _NUMBER.fullmatch(one) or _NUMBER.fullmatch(two)
    if has_number:
        return True
    # Only signs at the ends differ.
    return one.strip(SIGNS) == two.strip(SIGNS)


def signs_of(text: str) -> tuple[str, str]:
    """Return the signs at the ends of a text that belong to its name, empty without them.

    A sign before a number does, and plus and minus signs right behind a word; a hyphen before a
    word does not, since lists begin with one.

    Example:
        >>> signs_of("-7"), signs_of("O2-"), signs_of("- water")
        (('-', ''), ('', '-'), ('', ''))
    """
    first = _NUMBER_SIGN.match(text)
    last = _CHARGE.search(text)
    before = first[0] if first else ""
    after = last[0] if last else ""
    # Each minus sign as a hyphen, so that both spellings are the same.
    before = before.replace("\u2212", "-")
    after = after.replace("\u2212", "-")
    return before, after


def words_in(label: str) -> list[str]:
    """Return the words in a label: between blanks, ``_``, ``-``, ``:``, ``/``, and capitals.

    Signs count between words only, so that ``C-`` is not the word ``C``.

    Example:
        >>> words_in("minecraft:oak_log"), words_in("IronPlate"), words_in("O2-")
        (['minecraft', 'oak', 'log'], ['Iron', 'Plate'], ['O2-'])
    """
    blanks = label.replace("_", " ")
    spaced = _BETWEEN_WORDS.sub(" ", blanks).split()
    return list(chain.from_iterable(map(_at_capitals, spaced)))


def _at_capitals(word: str) -> list[str]:
    """Return the parts of a word in camel case, such as HTTP and Server of HTTPServer."""
    if word.islower() or word.isupper():
        return [word]
    starts = [0]
    for place in range(1, len(word)):
        follows_small = word[place - 1].islower()
        follows_capital = word[place - 1].isupper()
        next_letter = word[place + 1 : place + 2]
        begins_word = follows_capital and next_letter.islower()
        if word[place].isupper() and (follows_small or begins_word):
            starts.append(place)
    ends = pairwise([*starts, len(word)])
    return [word[start:end] for start, end in ends]


def _in_usual_width(char: str) -> str:
    kind = unicodedata.decomposition(char).partition(" ")[0]
    return unicodedata.normalize("NFKC", char) if kind in _SAME_SHAPE else char
