"""Terms for reports and pages from ``glossary.toml``, shown in tooltips and ``docs/terms.md``."""

import tomllib
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.base.records import Record
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, Label, label_of, with_letters

Topic = Literal["Graphs", "Links", "Play", "Agents"]


class Term(Record):
    """A glossary term.

    Attributes:
        topic: section of the glossary.
        name: the term.
        meaning: definition in one to three sentences.
        symbol: symbol in formulas, or empty.
    """

    topic: Topic
    name: str
    meaning: str
    symbol: str = ""


def _term(label: Label) -> Term:
    meaning = label.meaning or label.about
    if label is not ALPHA:
        # A reader of a report meets the letter, and needs the name that commands take.
        meaning = f"{meaning} In commands and settings: {with_letters([label.name])}."
    return Term("Agents", label.words, meaning, label.symbol)


_FILE = Path(__file__).with_suffix(".toml")
_TERMS: dict[Any, dict[str, list[str]]] = tomllib.loads(_FILE.read_text("utf-8"))
# Score sources define their own words, so that a term and a column never differ.
GLOSSARY = {label.name: _term(label) for label in (ALPHA, *BUILT_IN.values())}
for _topic, _terms in _TERMS.items():
    for _key, _words in _terms.items():
        GLOSSARY[_key] = Term(_topic, *_words)


def find_term(key: str) -> Term:
    """Return the term for a key: a glossary entry or a registered score source.

    Raises:
        KeyError: if the key is unknown.
    """
    if key in GLOSSARY:
        return GLOSSARY[key]
    # Sources of other packages may be registered after this module was imported.
    return _term(label_of(key))
