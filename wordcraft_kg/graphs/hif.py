"""Recipe graphs in the Hypergraph Interchange Format (HIF), written and read.

HIF is a JSON format of libraries for hypergraphs, such as HyperNetX and XGI. A recipe is an edge of
a directed hypergraph: its ingredients are the edge's tail, its result is the head. An ingredient
that is combined with itself is one incidence with the weight 2, since a set holds it once. Nodes
are entities by label, with ``base`` in their attributes; edges have the recipe's ``kind`` and
``quantities``, if any. So nothing of a graph is lost.

Files of other tools are read by the same rules. Their recipes may have any number of ingredients
and results; :func:`recipes_of_hif` returns them as they are.

Source: Coll et al., "HIF: The hypergraph interchange format for higher-order networks".
"""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import check_label, shown

_DIRECTIONS = ("tail", "head")
_MOST_PIECES = 1_000  # a larger weight is no count of an ingredient
_FACTS = ("kind", "quantities")
"""Attributes of edges."""


@dataclass(frozen=True)
class HifRecipes:
    """The recipes in a HIF document.

    Attributes:
        name: the document's ``metadata.name``; empty without one.
        base: entities that are marked as base; None if no node says whether it is one.
        listed: all nodes, in order.
        rows: for each result of each edge the labels of the ingredients, repeated by weight, and
            then the result.
        kinds: the kind of each row; empty texts without kinds.
        quantities: the quantities of each row; empty texts without quantities.
        dropped_counts: number of results with a weight other than 1, a count that is left out.
    """

    name: str
    base: tuple[str, ...] | None
    listed: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    kinds: tuple[str, ...]
    quantities: tuple[str, ...]
    dropped_counts: int


def is_hif(document: Any) -> bool:
    """Return whether a JSON value has the shape of HIF: an object with a list of incidences."""
    return isinstance(document, Mapping) and isinstance(document.get("incidences"), list)


def hif_lines(graph: RecipeGraph) -> Iterator[str]:
    """Yield a graph as a HIF document, with a node or an incidence in each line."""
    # NaN is no JSON, and other readers of HIF would refuse the file.
    dump = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    metadata = {"name": graph.name, "hash": graph.hash}
    yield "{\n"
    yield '"network-type": "directed",\n'
    yield f'"metadata": {dump(metadata)},\n'
    # Generators: a large graph has millions of lines.
    yield '"nodes": [\n'
    yield from _lines(map(dump, _described_nodes(graph)))
    yield '],\n"edges": [\n'
    yield from _lines(map(dump, _described_edges(graph)))
    yield '],\n"incidences": [\n'
    yield from _lines(map(dump, _incidences(graph)))
    yield "]\n}\n"


def _described_nodes(graph: RecipeGraph) -> Iterator[dict[str, Any]]:
    """Yield a node for each entity, which says whether it is in the base."""
    base = set(graph.base_ids.tolist())
    for entity, label in enumerate(graph.entities):
        yield {"node": label, "attrs": {"base": entity in base}}


def _described_edges(graph: RecipeGraph) -> Iterator[dict[str, Any]]:
    """Yield an edge for each recipe, with its kind and quantities if the graph has them."""
    nothing = [""] * graph.num_recipes
    facts_of_edges = zip(graph.kinds or nothing, graph.quantities or nothing, strict=True)
    for edge, facts in enumerate(facts_of_edges):
        described: dict[str, Any] = {"edge": edge}
        attributes = {name: fact for name, fact in zip(_FACTS, facts, strict=True) if fact}
        if attributes:
            described["attrs"] = attributes
        yield described


def _incidences(graph: RecipeGraph) -> Iterator[dict[str, Any]]:
    for edge, recipe in enumerate(graph.recipe_labels()):
        # A node is once in an edge; an entity with itself has the weight 2.
        for label, count in Counter(recipe.ingredients).items():
            tail: dict[str, Any] = {"edge": edge, "node": label, "direction": "tail"}
            if count > 1:
                tail["weight"] = count
            yield tail
        yield {"edge": edge, "node": recipe.result, "direction": "head"}


def _lines(values: Iterable[str]) -> Iterator[str]:
    """Yield values as the lines of a JSON list, with commas between them."""
    # A value is held back until the next one shows that a comma follows.
    before = None
    for value in values:
        if before is not None:
            yield f"{before},\n"
        before = value
    if before is not None:
        yield f"{before}\n"


def recipes_of_hif(document: Mapping[str, Any], where: str = "HIF") -> HifRecipes:
    """Return the recipes in a HIF document.

    Args:
        document: the parsed JSON, see :func:`is_hif`.
        where: name of the file, for errors.

    Returns:
        The recipes, a row for each result of each edge.

    Raises:
        RecipeFileError: for a hypergraph that is not directed, an edge without ingredients or
            result, a weight that is no count, or a damaged part; the message names the place.
    """
    _check_directed(document, where)
    metadata = _object(document, "metadata", where)
    nodes = _Nodes(where)
    marks: dict[str, Any] = {}
    for node, place in _objects(document, "nodes", where):
        label = nodes.label(node, place)
        marks[label] = _object(node, "attrs", place).get("base")
    facts: dict[str, dict[str | int, str]] = {name: {} for name in _FACTS}
    for described, place in _objects(document, "edges", where):
        for name_of_fact, facts_by_edge in facts.items():
            fact = _object(described, "attrs", place).get(name_of_fact)
            if fact:
                edge_name = _identifier(described, "edge", place)
                facts_by_edge[edge_name] = check_label(fact, f"{place}: {name_of_fact}")
    rows = []
    facts_of_rows: list[list[str]] = []
    edges = _edges(document, nodes, where)
    for name, edge in edges.items():
        for result in edge.heads:
            rows.append((*edge.tail.elements(), result))
            facts_of_rows.append([facts_by_edge.get(name, "") for facts_by_edge in facts.values()])
    base = None
    # A file in which nothing is marked says nothing of the base, rather than that it is empty.
    if any(isinstance(mark, bool) for mark in marks.values()):
        base = tuple(label for label, mark in marks.items() if mark is True)
    title = metadata.get("name")
    return HifRecipes(
        name=title if isinstance(title, str) else "",
        base=base,
        listed=tuple(nodes.labels),
        rows=tuple(rows),
        kinds=tuple(kind for kind, _ in facts_of_rows),
        quantities=tuple(numbers for _, numbers in facts_of_rows),
        dropped_counts=sum(edge.dropped_counts for edge in edges.values()),
    )


@dataclass
class _Edge:
    """An edge while its incidences are read.

    Attributes:
        place: place of its first incidence, for errors.
        tail: the ingredients, with how often each is needed.
        heads: the results, in order; a dict as an ordered set.
        dropped_counts: number of results with a weight other than 1.
    """

    place: str
    tail: Counter[str] = field(default_factory=Counter)
    heads: dict[str, None] = field(default_factory=dict)
    dropped_counts: int = 0


def _edges(document: Mapping[str, Any], nodes: "_Nodes", where: str) -> dict[str | int, _Edge]:
    """Return the edges by name, each with ingredients and a result."""
    edges: dict[str | int, _Edge] = {}
    for incidence, place in _objects(document, "incidences", where):
        name = _identifier(incidence, "edge", place)
        edge = edges.setdefault(name, _Edge(place))
        label = nodes.label(incidence, place)
        if incidence["direction"] == "tail":
            edge.tail[label] += _count(incidence, place)
        else:
            edge.heads[label] = None
            edge.dropped_counts += incidence.get("weight", 1) != 1
    for name, edge in edges.items():
        subject = f"{edge.place}: edge {shown(name)} has"
        if not edge.tail or not edge.heads:
            lacks = "head, the result" if edge.tail else "tail, the ingredients"
            raise RecipeFileError(f"{subject} no {lacks}; a recipe needs both. Nothing was read.")
        num_ingredients = edge.tail.total()
        if num_ingredients > _MOST_PIECES:
            raise RecipeFileError(
                f"{subject} {num_ingredients:,} ingredients; the limit is {_MOST_PIECES:,}."
            )
    return edges


class _Nodes:
    """Labels of nodes; a number stands for its digits, unless a text has the same digits."""

    def __init__(self, where: str):
        self.labels: dict[str, str | int] = {}
        self._where = where

    def label(self, holder: Mapping[str, Any], place: str) -> str:
        """Return the label of the node that an object names."""
        identifier = _identifier(holder, "node", place)
        label = check_label(str(identifier), place)
        first_identifier = self.labels.setdefault(label, identifier)
        if type(first_identifier) is not type(identifier):
            raise RecipeFileError(
                f"{place}: the nodes {first_identifier!r} and {identifier!r} would be one entity. "
                "Rename one."
            )
        return label


def _check_directed(document: Mapping[str, Any], where: str) -> None:
    """Refuse a hypergraph that does not say which nodes are ingredients."""
    kind = document.get("network-type", "directed")
    problem = "" if kind == "directed" else f"the network-type {shown(kind)}"
    for incidence, place in _objects(document, "incidences", where):
        if incidence.get("direction") not in _DIRECTIONS:
            problem = problem or place
    if problem:
        raise RecipeFileError(
            f"{where}: a hypergraph without directions ({problem}); expected a directed one, in "
            "which each recipe is an edge, its ingredients have the direction 'tail', and its "
            "result 'head'. Other hypergraphs do not say what is made."
        )


def _objects(
    document: Mapping[str, Any],
    name: str,
    where: str,
) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield the objects in a list of the document, with their places."""
    values = document.get(name, [])
    if not isinstance(values, list):
        raise RecipeFileError(f"{where}: '{name}' is {shown(values)}; expected a list.")
    for index, value in enumerate(values):
        place = f"{where}: {name}[{index}]"
        if not isinstance(value, dict):
            raise RecipeFileError(f"{place} is {shown(value)}; expected an object.")
        yield value, place


def _object(holder: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    value = holder.get(name)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise RecipeFileError(f"{where}: '{name}' is {shown(value)}; expected an object.")
    return value


def _identifier(holder: Mapping[str, Any], name: str, place: str) -> str | int:
    value = holder.get(name)
    # A bool is an int in Python, but not in JSON.
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise RecipeFileError(
            f"{place}: the {name} is {shown(value)}; expected a text or a whole number."
        )
    return value


def _count(incidence: Mapping[str, Any], place: str) -> int:
    """Return how often an ingredient is needed: its weight, 1 by default."""
    weight = incidence.get("weight", 1)
    is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
    # The range first: int() refuses infinity and NaN.
    is_count = is_number and 1 <= weight <= _MOST_PIECES and weight == int(weight)
    if not is_count:
        raise RecipeFileError(
            f"{place}: the weight of an ingredient is {shown(weight)}; expected how often it is "
            f"needed, a whole number from 1 to {_MOST_PIECES:,}."
        )
    return int(weight)
