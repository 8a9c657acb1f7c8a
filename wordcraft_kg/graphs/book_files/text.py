"""The text of a recipe book: which encoding its bytes are in.

A byte order mark decides, then UTF-8. Other bytes are read in each encoding that programs still
write; the words of a wrong reading mix scripts or have capitals inside. If several readings remain,
the file is refused with two of them. A detector was judged: of 18 short texts in 13 encodings,
charset-normalizer 3.5 took a wrong reading in silence for 5; the rule here for none, and refuses 6.
"""

import codecs
import re
import unicodedata
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.escaping import for_terminal
from wordcraft_kg.graphs.book_files.rows import refusal

# UTF-32 first: its little-endian mark begins with that of UTF-16.
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_SAMPLE = 2**14  # bytes of lines with non-ASCII characters for the guess
_ENCODINGS = (
    *("cp1252", "cp1250", "cp1251", "cp1253", "cp1254", "cp1257", "iso8859_2", "iso8859_15"),
    *("koi8_r", "cp437", "cp850", "cp852", "cp866", "mac_roman"),
    *("shift_jis", "euc_jp", "gb18030", "big5", "cp949"),
)
"""Encodings of text files other than Unicode's: Windows, Unix, DOS, Macintosh, East Asia."""
_NOT_OF_FILES = frozenset(
    {"punycode", "idna", "unicode_escape", "raw_unicode_escape", "undefined", "mbcs", "oem"}
    | {"unicode-escape", "raw-unicode-escape"}
)
"""Python's encodings of names and source code, not of files."""
_WORD = re.compile(r"[^\s,;|\t\"=+()\[\]{}:/-]+")
_PUNCTUATION = frozenset(
    "\u2019\u2018\u201c\u201d\u2013\u2014\u2026\u20ac\u00b0\u00bd\u00b2\u00b3\u00ab\u00bb"
)
_JAPANESE = ("CJK", "HIRAGANA", "KATAKANA", "KATAKANA-HIRAGANA", "IDEOGRAPHIC")
_SHORT_WORD = 3
_REMEDY = "Name the file's encoding with --encoding, or save the file as UTF-8."
_MANY_ZEROS = 0.3  # of the bytes at even or odd places: text in UTF-16


class Decoded(NamedTuple):
    """A file's text.

    Attributes:
        text: the text, without a byte order mark.
        encoding: name of the encoding.
        has_mark: whether the bytes began with a byte order mark.
    """

    text: str
    encoding: str
    has_mark: bool


def check_encoding(encoding: str | None) -> None:
    """Check that Python knows a text encoding.

    Args:
        encoding: its name; None, which stands for a guess, is always right.

    Raises:
        ConfigError: if it does not, or the encoding is one of names or source code, not of files.
    """
    if encoding is None:
        return
    try:
        if not isinstance("".encode(encoding), bytes):
            raise LookupError
        if codecs.lookup(encoding).name in _NOT_OF_FILES:
            raise LookupError
        b"".decode(encoding)
    except (LookupError, UnicodeError, ValueError, TypeError):
        raise ConfigError(
            f"`encoding` {encoding!r}: expected an encoding that Python knows, such as utf-8, "
            "cp1252 or shift_jis."
        ) from None


def decode(path: Path, data: bytes, encoding: str | None = None) -> Decoded:
    """Decode a file's bytes.

    Args:
        path: the file, for errors.
        data: the bytes.
        encoding: the encoding, one that :func:`check_encoding` accepts; None to guess.

    Raises:
        RecipeFileError: for an empty or binary file, for bytes that do not fit ``encoding``, and if
            several encodings fit and give different texts; the message shows two readings.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    marked = _MARKS.get(mark, "")
    name = codecs.lookup(encoding).name if encoding else marked or _guess(path, data)
    if marked and not name.startswith(marked.removesuffix("-sig")):
        family = marked.removesuffix("-sig")
        seen = f"it begins with the byte order mark of {family}, and `encoding` is {encoding}"
        raise refusal(path, seen, "encodings", "Leave --encoding out.")
    try:
        text = data.removeprefix(codecs.BOM_UTF8).decode(name.removesuffix("-sig"))
    except UnicodeDecodeError as error:
        seen = _not(path, data, name.removesuffix("-sig"), error)
        raise refusal(path, seen, "encodings", _REMEDY) from None
    # A decoder with a byte order in its name leaves the mark.
    text = text.removeprefix("\ufeff") if mark and encoding else text
    if text.startswith("\ufeff"):
        raise refusal(path, "two byte order marks", "encodings", "Remove them.")
    if not text.strip():
        raise RecipeFileError(f"{path} is empty; a recipe book needs at least one recipe.")
    return Decoded(text, name.removesuffix("-sig"), bool(mark))


def _not(path: Path, data: bytes, name: str, error: UnicodeDecodeError) -> str:
    line = data.count(b"\n", 0, error.start) + 1
    return f"line {line} is not {name} (byte 0x{data[error.start]:02x})"


def _guess(path: Path, data: bytes) -> str:
    """Return the encoding of bytes, if all plausible ones give one text."""
    if b"\x00" in data:
        return _wide(path, data)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        start = error.start
        seen = _not(path, data, "UTF-8", error)
    else:
        return "utf-8"
    # All lines with bytes outside of ASCII, each once, are all that a guess can go by.
    lines = dict.fromkeys(line for line in data.splitlines() if not line.isascii())
    sample = b"\n".join(lines)[:_SAMPLE]
    texts: dict[str, str] = {}
    for name in _ENCODINGS:
        # A sample may end within a character of several bytes.
        with suppress(UnicodeDecodeError):
            text = codecs.getincrementaldecoder(name)().decode(sample)
            if all(word.isascii() or _is_word(word) for word in set(_WORD.findall(text))):
                texts.setdefault(text, name)
    if len(texts) == 1:
        return next(iter(texts.values()))
    if texts:
        two = [_reading(data, name, start) for name in list(texts.values())[:2]]
        seen = f"{seen}; its encoding is not certain: {' or '.join(two)}"
    raise refusal(path, seen, "encodings", _REMEDY)


def _wide(path: Path, data: bytes) -> str:
    """Return which kind of UTF-16 bytes with zeros are, or refuse them as binary."""
    # In most scripts many characters, such as spaces and line ends, are below 256. One byte of
    # their two is zero: the second one in little endian, the first one in big endian. The other
    # byte is never zero in usual text, but often in binary files.
    even, odd = data[::2].count(0), data[1::2].count(0)
    if min(even, odd) or max(even, odd) <= _MANY_ZEROS * (len(data) // 2):
        raise refusal(path, "a binary file (it holds zero bytes), not text", "encodings")
    return "utf-16-le" if odd else "utf-16-be"


def _is_word(word: str) -> bool:
    """Return whether a word looks as people write it.

    It has one script, no capitals after small letters, no signs inside, and in Latin script at most
    half of the letters with accents.
    """
    foreign = [char for char in word if not char.isascii() and char not in _PUNCTUATION]
    if not all(char.isalpha() or char.isdigit() for char in foreign):
        return False
    if any(a.islower() and b.isupper() and not b.isascii() for a, b in pairwise(word)):
        return False
    # A letter's name begins with its script, as in LATIN SMALL LETTER A.
    names = [unicodedata.name(char, "").partition(" ")[0] for char in word if char.isalpha()]
    scripts = {"CJK" if name in _JAPANESE else name for name in names}
    is_latin = scripts == {"LATIN"} and len(word) > _SHORT_WORD
    return len(scripts) <= 1 and not (is_latin and 2 * len(foreign) > len(word))


def _reading(data: bytes, name: str, start: int) -> str:
    """Return the line around a byte as an encoding reads it, for a refusal."""
    line_start = data.rfind(b"\n", 0, start) + 1
    around = data[line_start : start + 30].decode(name, errors="replace")
    return f"{for_terminal(around.splitlines()[0][:60])!r} as {name}"
