"""Write docs/terms.md from the glossary of the reports and further terms; ``--check`` only
compares.
"""

import sys
from pathlib import Path
from typing import get_args

from wordcraft_kg.reports.pages import GLOSSARY, Topic

PAGE = Path(__file__).with_name("terms.md")
BEGINNING = """# Terms

Look up a term of the reports, the help, the errors and the guides. `make docs` writes this page from
`wordcraft_kg/reports/glossary.toml`, whose definitions the tooltips of the reports show, and `docs/make_terms.py`.

![Two recipes as triples: one triple is leaked, the rest of the test recipe is unseen](images/concepts.svg)

The *partial graph* holds the triples of the train recipe *dough + fire → bread*. The test recipe *dough + oven →
bread* shares the triple *dough componentOf bread*: this triple is *leaked* and left out. The remaining three triples
are *unseen* and evaluated. The two combinesWith triples *mirror* each other, so both stay out of training. The *full
graph* holds all triples. A *self edge* is an entity's self score.
"""

FURTHER = {
    "Graphs": {
        "recipe": "One to eight ingredients and their result; two in environments and recipe scorers. The order of the ingredients does not matter, and the same ingredients may have several results.",
        "groups": "Recipes that a split and its folds keep together: recipes of one pair, of one goal, or with a shared ingredient and result.",
    },
    "Links": {
        "trained on": "The recipes that a model has learned from: all recipes (full), the train recipes (partial), or none.",
        "training fraction": "The share of the train recipes that a scorer is trained on.",
        "label noise": "The share of these recipes whose result is replaced by a wrong result.",
        "inductive": "Scores for entities outside the graph, computed from the words of their labels. A transductive model knows only the entities of its graph.",
        "percentile rank": "The share of entities with a lower score than the given entity.",
        "evaluated": "Ranked against all entities on the test triples, and reported with an interval and baselines.",
    },
    "Play": {
        "action": "The choice of one slot of the table. Two actions make an attempt.",
        "selection": "The entity chosen by the first action of an attempt.",
        "termination reason": "The end of an episode: the goal was made, or the kind of the last pair if the goal was not made.",
        "open-ended mode": "Play without a goal. Results stay known, and the score is the number of known entities after a number of attempts.",
        "text agent": "A player that reads and writes text, such as a language model or a program behind a line protocol.",
        "prompt template": "The texts that a text agent reads. Their hash is part of every result, because other prompts are another experiment.",
        "look-up": "A question about an entity during a game. The answer lists train recipes or predictions of a scorer, and costs no attempt.",
        "invalid action": "An answer of a text agent that cannot be parsed. The player reads an explanation and may answer again; after several invalid actions in a row the next one costs an attempt.",
        "Model Context Protocol, MCP": "A protocol for programs with a language model that call tools of other programs.",
    },
    "Agents": {
        "external scores": "The scores of all sources for the slots of a table, computed outside the network of the agent.",
    },
}
"""Terms of the guides, by topic and name, that no report explains."""


def page() -> str:
    """Return the page: the terms of each topic in a table."""
    parts = [BEGINNING]
    for topic in get_args(Topic):
        terms = [term for term in GLOSSARY.values() if term.topic == topic]
        meanings = {
            f"{term.name}{f' ({term.symbol})' if term.symbol else ''}": term.meaning
            for term in terms
        }
        meanings |= FURTHER[topic]
        rows = [f"| {name} | {meanings[name]} |" for name in sorted(meanings, key=str.casefold)]
        parts.append("\n".join([f"## {topic}\n", "| term | definition |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(
            "docs/terms.md is not up to date; run `make docs`" if PAGE.read_text() != page() else 0
        )
    PAGE.write_text(page())
