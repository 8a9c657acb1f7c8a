"""Model cards: the ``README.md`` in a model folder, with a YAML header for model hubs."""

from collections.abc import Iterable, Sequence

from wordcraft_kg.graphs.folder import OpenedGraph


def front_matter(*tags: str) -> str:
    """Return the YAML header of a model card, from which model hubs read the library name and the tags."""
    return "\n".join(
        ["---", "library_name: wordcraft-kg", "tags:", *(f"- {tag}" for tag in tags), "---"]
    )


def scorer_card(
    opened: OpenedGraph,
    title: str,
    about: str,
    points: Sequence[str],
    closing: str,
    usage: Iterable[str],
) -> str:
    """Return a scorer's card: graph, split and ``points``, then caveats (``closing``) and ``usage`` code lines."""
    graph, split = opened.graph, opened.split.config
    where = f"graph `{graph.hash[:12]}`: {graph.num_entities:,} entities; split `{split.kind}`, seed {split.seed}"
    first, *others = points or ("",)
    lines = "\n".join(f"- {line}" for line in ("; ".join(filter(None, (where, first))), *others))
    code = "\n".join(
        ["from wordcraft_kg import load_scorer", "", 'scorer = load_scorer("this folder")', *usage]
    )
    head = f"{front_matter('knowledge-graph', 'link-prediction')}\n# {title}"
    return f"{head}\n\n{about}\n\n{lines}\n\n{closing}\n\n```python\n{code}\n```\n"
