"""Texts: numbers in sentences, foreign text in an output, and spelling.

There is one function for each format of an output. A label, a name, a path or a commit of a hub is
foreign text: it may hold escape codes of terminals, marks that reorder a line, links or headings.
Each function returns a text that the format shows character for character.

Labels are compared by their spelling: the same label, another spelling, or another thing. A sign
can be a part of the name: ``C`` and ``C-`` are an atom and an ion, ``7`` and ``-7`` two numbers. So
hyphens, points, apostrophes and blanks make no difference only between letters, as in ``ice-cream``
and ``icecream``; beside a digit, at the end, or between two single letters, they count. Labels
themselves are never changed: their keys are compared, and their words looked up, such as for
vectors. Answers in texts are read more leniently, see :mod:`wordcraft_kg.base.labels`.
"""

import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from itertools import chain, pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup


def counted(number: int, one: str, more: str = "") -> str:
    """Return a number with a noun in the singular or plural.

    Args:
        number: the number.
        one: the noun in the singular.
        more: the noun in the plural; empty for the singular with an s.

    Example:
        >>> counted(1, "entity", "entities"), counted(1_200, "pair")
        ('1 entity', '1,200 pairs')
    """
    noun = one if number == 1 else more or f"{one}s"
    return f"{number:,} {noun}"


def quoted(label: str) -> str:
    """Return a label for a list with commas.

    It is in quotes if it holds a comma, or begins or ends blank.

    Example:
        >>> ", ".join(map(quoted, ["water", "salt, pepper"]))
        "water, 'salt, pepper'"
    """
    is_clear = "," not in label and label == label.strip()
    return label if is_clear else f"'{label}'"


def listed(names: Sequence[str], most: int = 10, total: int | None = None) -> str:
    """Return the first names with commas between them, and the number of those left out.

    Args:
        names: names in order, perhaps only some of them.
        most: number of names to show.
        total: number of all names; None if these are all.

    Example:
        >>> listed(["a", "b", "c"], most=2)
        'a, b and 1 more'
    """
    num_hidden = (len(names) if total is None else total) - most
    ending = f" and {num_hidden:,} more" if num_hidden > 0 else ""
    return ", ".join(names[:most]) + ending


_BIDI = "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
# Control characters reach a terminal as commands, and lone surrogates (bytes of a path that are not
# UTF-8) end print in an error. Blanks other than the space, format characters other than joiners
# (which some scripts and emoji need), fillers and tags are invisible, or change the direction of a
# line.
_HIDDEN = re.compile(
    "[\x00-\x1f\x7f-\xa0\xad\u034f\u115f\u1160\u1680\u17b4\u17b5\u180e\u2000-\u200b\u2028\u2029"
    "\u202f\u205f-\u2065\u206a-\u206f\u2800\u3000\u3164\ufeff\uffa0\ufff9-\ufffb"
    f"\ud800-\udfff\U000e0000-\U000e007f{_BIDI}]"
)
_BIDI_MARK = re.compile(f"[{_BIDI}]")
# Not printed raw by --json: JSON itself escapes only the first 32 characters.
_JSON = re.compile(f"[\x7f-\x9f\u2028\u2029\ud800-\udfff{_BIDI}]")


def for_terminal(text: str) -> str:
    r"""Return a text for a line of a terminal, with codes for characters that do not show.

    A code is such as ``<U+001B>``.

    Line breaks are among them, so a foreign text cannot begin a line of its own.

    Example:
        >>> for_terminal("mine\x1b[2J\nverified")
        'mine<U+001B>[2J<U+000A>verified'
    """
    return _HIDDEN.sub(_code, text)


def for_html(text: object) -> "Markup":
    """Return a value for HTML, escaped.

    Marks of direction, which reorder the page around a text, become codes.

    Markup stays as it is.
    """
    # Late: the light installation, without reports and pages, has no MarkupSafe.
    from markupsafe import Markup, escape

    if isinstance(text, Markup):
        return text
    return escape(_BIDI_MARK.sub(_code, str(text)))


def for_file(text: str) -> str:
    r"""Return a text for a file in UTF-8: U+FFFD stands for halves of characters.

    JSON may hold such halves (lone surrogates), and no file can.

    Example:
        >>> for_file("a\ud800b \ud83d\ude80")
        'a\ufffdb 🚀'
    """
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def for_json(dumped: str) -> str:
    r"""Return a JSON text with control and direction characters as escapes, such as ``\u009b``.

    Such characters occur only inside JSON strings, so the value is unchanged.
    """
    return _JSON.sub(lambda match: f"\\u{ord(match[0]):04x}", dumped)


def _code(match: re.Match[str]) -> str:
    """Return the code that stands for a character, such as ``<U+001B>``."""
    return f"<U+{ord(match[0]):04X}>"


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
    return [tuple(group) for group in groups.values() if len(group) > 1]


def means_another(label: str, other: str) -> bool:
    """Return whether two labels look alike, but surely name different things.

    These are different numbers, and labels that differ only in plus and minus signs at their ends.

    Example:
        >>> means_another("7", "-7"), means_another("C", "C-"), means_another("watr", "water")
        (True, True, False)
    """
    first_key = spelling_key(label)
    second_key = spelling_key(other)
    if first_key == second_key:
        return False
    has_number = _NUMBER.fullmatch(first_key) or _NUMBER.fullmatch(second_key)
    only_signs_differ = first_key.strip(SIGNS) == second_key.strip(SIGNS)
    return bool(has_number) or only_signs_differ


def signs_of(text: str) -> tuple[str, str]:
    """Return the signs at the ends of a text that belong to its name, empty without them.

    A sign before a number does, and plus and minus signs right behind a word; a hyphen before a
    word does not, since lists begin with one.

    Example:
        >>> signs_of("-7"), signs_of("O2-"), signs_of("- water")
        (('-', ''), ('', '-'), ('', ''))
    """
    return _signs_in(_NUMBER_SIGN.match(text)), _signs_in(_CHARGE.search(text))


def _signs_in(match: re.Match[str] | None) -> str:
    """Return the matched signs, each minus as a hyphen, so that both spellings are the same."""
    return match[0].replace("\u2212", "-") if match else ""


def words_in(label: str) -> list[str]:
    """Return the words in a label: between blanks, ``_``, ``-``, ``:``, ``/``, and capitals.

    Signs count between words only, so that ``C-`` is not the word ``C``.

    Example:
        >>> words_in("minecraft:oak_log"), words_in("IronPlate"), words_in("O2-")
        (['minecraft', 'oak', 'log'], ['Iron', 'Plate'], ['O2-'])
    """
    spaced = _BETWEEN_WORDS.sub(" ", label.replace("_", " ")).split()
    return list(chain.from_iterable(map(_at_capitals, spaced)))


def _at_capitals(word: str) -> list[str]:
    """Return the parts of a word in camel case, such as HTTP and Server of HTTPServer."""
    if word.islower() or word.isupper():
        return [word]
    starts = [0]
    for place in range(1, len(word)):
        # A capital begins a word behind a small letter, or between a capital and a small letter.
        before = word[place - 1]
        begins_word = before.isupper() and word[place + 1 : place + 2].islower()
        if word[place].isupper() and (before.islower() or begins_word):
            starts.append(place)
    return [word[start:end] for start, end in pairwise([*starts, len(word)])]


def _in_usual_width(char: str) -> str:
    kind = unicodedata.decomposition(char).partition(" ")[0]
    return unicodedata.normalize("NFKC", char) if kind in _SAME_SHAPE else char
