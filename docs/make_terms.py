"""Write docs/terms.md from the glossary of the reports; ``--check`` only compares."""

import sys
from pathlib import Path
from typing import get_args

from wordcraft_kg.reports.glossary import GLOSSARY, Topic

PAGE = Path(__file__).with_name("terms.md")
BEGINNING = """# Terms

Look up a term of the reports, the help, the errors and the guides. `make docs` writes this page from
`wordcraft_kg/reports/glossary.py`; the tooltips of the reports show the same definitions.

![Two recipes as triples: one triple is leaked, the rest of the test recipe is unseen](images/concepts.svg)

The *partial graph* holds the triples of the train recipe *dough + fire → bread*. The test recipe *dough + oven →
bread* shares the triple *dough componentOf bread*: this triple is *leaked* and left out. The remaining three triples
are *unseen* and evaluated. The two combinesWith triples *mirror* each other, so both stay out of training. The *full
graph* holds all triples. A *self edge* is an entity's self score.
"""


def page() -> str:
    """Return the page: the terms of each topic in a table."""
    parts = [BEGINNING]
    for topic in get_args(Topic):
        terms = [term for term in GLOSSARY.values() if term.topic == topic]
        rows = [f"| {term.name}{f' ({term.symbol})' if term.symbol else ''} | {term.meaning} |" for term in terms]
        parts.append("\n".join([f"## {topic}\n", "| term | definition |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit("docs/terms.md is not up to date; run `make docs`" if PAGE.read_text() != page() else 0)
    PAGE.write_text(page())
