"""Model cards: the ``README.md`` in a model folder, with a YAML header for model hubs."""

from collections.abc import Iterable, Sequence

from wordcraft_kg.graphs.folder import OpenedGraph


def front_matter(*tags: str) -> str:
    """Return the YAML header of a model card, where model hubs read library name and tags."""
    lines = ["---", "library_name: wordcraft-kg", "tags:"]
    lines += [f"- {tag}" for tag in tags]
    return "\n".join([*lines, "---"])


def scorer_card(
    opened: OpenedGraph,
    title: str,
    about: str,
    points: Sequence[str],
    closing: str,
    usage: Iterable[str],
) -> str:
    """Return a scorer's model card, in Markdown.

    Args:
        opened: graph and split of the training.
        title: heading.
        about: paragraph below the heading.
        points: list of facts; the first continues the line on graph and split.
        closing: paragraph of caveats below the list.
        usage: lines of Python that use ``scorer``.
    """
    graph = opened.graph
    split = opened.split.config
    trained_on = (
        f"graph `{graph.hash[:12]}`: {graph.num_entities:,} entities; "
        f"split `{split.kind}`, seed {split.seed}"
    )
    if points:
        points = [f"{trained_on}; {points[0]}" if points[0] else trained_on, *points[1:]]
    lines = "\n".join(f"- {point}" for point in points or [trained_on])
    loading = ["from wordcraft_kg import load_scorer", "", 'scorer = load_scorer("this folder")']
    code = "\n".join([*loading, *usage])
    head = f"{front_matter('knowledge-graph', 'link-prediction')}\n# {title}"
    return f"{head}\n\n{about}\n\n{lines}\n\n{closing}\n\n```python\n{code}\n```\n"
