"""Codes with which people come back: random, impossible to guess, easy to type, and never stored."""

import hashlib
import re
import secrets

ALPHABET = "23456789abcdefghjkmnpqrstuvwxyz"
"""Without 0 and o, 1, l and i, which look alike."""
LENGTH, GROUP = 12, 4
"""Characters of a code, of about 59 bits; it is shown in groups."""


def new_code() -> str:
    """Return a random code, such as ``k7qm-2xwd-9hrt``."""
    return _grouped("".join(secrets.choice(ALPHABET) for _ in range(LENGTH)))


def read_code(typed: str) -> str | None:
    """Return the code that somebody means, with any capitals, blanks and dashes; None if it is none."""
    letters = re.sub(r"[\s\-–—._]", "", typed[:100]).lower()
    is_code = len(letters) == LENGTH and set(letters) <= set(ALPHABET)
    return _grouped(letters) if is_code else None


def code_hash(code: str) -> str:
    """Return what is stored instead of a code."""
    return hashlib.sha256(code.encode()).hexdigest()


def _grouped(letters: str) -> str:
    return "-".join(letters[start : start + GROUP] for start in range(0, LENGTH, GROUP))
