"""Model cards: the ``README.md`` of a folder, with the header by which model hubs list it."""

from collections.abc import Iterable, Sequence

from wordcraft_kg.graphs.folder import OpenedGraph


def front_matter(*tags: str) -> str:
    """Return the YAML header by which model hubs list a model: the library that loads it, and tags."""
    return "\n".join(["---", "library_name: wordcraft-kg", "tags:", *(f"- {tag}" for tag in tags), "---"])


def scorer_card(
    opened: OpenedGraph, title: str, about: str, points: Sequence[str], closing: str, usage: Iterable[str]
) -> str:
    """Return the card of a scorer.

    Args:
        opened: its graph and split, to which the first of the ``points`` is added.
        title: heading.
        about: what it scores and what it has seen.
        points: facts, one a line.
        closing: what its figures mean.
        usage: lines of Python that use ``scorer``.
    """
    graph, split = opened.graph, opened.split.config
    where = f"graph `{graph.hash[:12]}`: {graph.num_entities:,} entities; split `{split.kind}`, seed {split.seed}"
    first, *others = points or ("",)
    lines = "\n".join(f"- {line}" for line in ("; ".join(filter(None, (where, first))), *others))
    code = "\n".join(["from wordcraft_kg import load_scorer", "", 'scorer = load_scorer("this folder")', *usage])
    head = f"{front_matter('knowledge-graph', 'link-prediction')}\n# {title}"
    return f"{head}\n\n{about}\n\n{lines}\n\n{closing}\n\n```python\n{code}\n```\n"
