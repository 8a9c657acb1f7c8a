"""Write docs/glossary.md from the glossary of the reports; ``--check`` only compares."""

import sys
from pathlib import Path
from typing import get_args

from wordcraft_kg.reports.glossary import GLOSSARY, Topic

PAGE = Path(__file__).with_name("glossary.md")
BEGINNING = """# Concepts

Made by `make docs` from `wordcraft_kg/reports/glossary.py`, where the tooltips of the reports come from too.

![Two recipes as triples: one triple is leaked, the others of the test recipe are unseen](images/concepts.svg)

The train recipe *dough + fire → bread* gives the *partial graph* its triples. Of the test recipe *dough + oven →
bread*, the train recipe has given *dough componentOf bread* already: that one is *leaked*, and left out. The other
three are *unseen* and evaluated; the two of combinesWith *mirror* each other, so both are kept out of training. The
*full graph* has all of them. A *self edge* is an entity's score with itself, true or not.
"""


def page() -> str:
    """Return the page: the terms of each topic in a table."""
    parts = [BEGINNING]
    for topic in get_args(Topic):
        terms = [term for term in GLOSSARY.values() if term.topic == topic]
        rows = [f"| {term.name}{f' ({term.symbol})' if term.symbol else ''} | {term.meaning} |" for term in terms]
        parts.append("\n".join([f"## {topic}\n", "| word | meaning |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit("docs/glossary.md is not up to date; run `make docs`" if PAGE.read_text() != page() else 0)
    PAGE.write_text(page())
