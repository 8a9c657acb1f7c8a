"""Export recipe graphs to file formats for other tools.

Add a format as an :class:`Exporter` in :data:`EXPORTERS`.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args
from urllib.parse import quote

import numpy as np

from wordcraft_kg.base import ConfigError, json_text, one_of, stage, staged_file, write_atomically
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.book_files import write_book
from wordcraft_kg.graphs.book_files.words import own_header
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS
from wordcraft_kg.graphs.triples import RELATIONS, triple_lines

if TYPE_CHECKING:
    import networkx as nx
    import pandas as pd

NAMESPACE = "urn:wordcraft-kg:"
"""Prefix of IRIs in RDF; labels in IRIs are percent-encoded.

The rest is ``entity:<label>``, ``recipe:<a>+<b>=<result>`` with all ingredients,
``relation:<name>``, ``role:ingredient`` or ``role:result``.
"""
_RDF_TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
_RDFS_LABEL = "http://www.w3.org/2000/01/rdf-schema#label"
ExportPart = Literal["full", "partial", "unseen"]
"""All recipes, the train recipes, or the held-out recipes and the triples of no train recipe."""
MOST_BYTES = 4 * 2**30
"""Most memory that an export may take."""
_GRAPHML_BYTES = 6_000  # per recipe while networkx writes, measured with 250,000 recipes
_HIF_BYTES = 1_500  # per recipe of a pair, measured with 190,000 recipes


@dataclass(frozen=True)
class Exporter:
    """An export format.

    Attributes:
        about: content of the file, for the help.
        write: writes graph and triples, shape (T, 3), to a path.
        recipe_bytes: memory in bytes that each recipe takes while it is written; 0 if little.
    """

    about: str
    write: Callable[[RecipeGraph, Ids, Path], object]
    recipe_bytes: int = 0


@stage("writing the export")
def export_graph(
    opened: OpenedGraph,
    format: str,
    out: Path,
    *,
    part: ExportPart = "full",
    force: bool = False,
) -> None:
    """Write a graph in one of the formats of :data:`EXPORTERS`, complete or not at all.

    Args:
        opened: the graph and its split.
        format: name of the format.
        out: file to write.
        part: recipes and triples to write; entities and base are always complete.
        force: whether to replace ``out``.

    Raises:
        ConfigError: for an unknown format or part, or if so many recipes would take more than
            :data:`MOST_BYTES` of memory.
        OutputExistsError: if ``out`` is a folder, or exists and ``force`` is False.
        OSError: if the file cannot be written.
    """
    one_of("format", format, tuple(EXPORTERS))
    one_of("part", part, get_args(ExportPart))
    exporter = EXPORTERS[format]
    graph = opened.graph
    if part != "full":
        # The train recipes, or all others. All entities stay, so that ids mean the same.
        graph = graph.part(opened.split.is_in("train") == (part == "partial"))
    # Some formats are built in memory as a whole: refused before the machine runs out of it.
    needed_bytes = graph.num_recipes * exporter.recipe_bytes
    if needed_bytes > MOST_BYTES:
        raise ConfigError(
            f"`format` {format!r}: {graph.num_recipes:,} recipes would take about "
            f"{needed_bytes / 2**30:.0f} GiB of memory; expected at most {MOST_BYTES / 2**30:.0f}. "
            "Take nt, tsv, parquet, csv, json or sentences, which need little."
        )
    # Unseen triples are those that train recipes do not give; an unseen recipe may give others.
    triples = opened.split.unseen if part == "unseen" else opened.triples(part)
    with staged_file(out, force=force) as path:
        exporter.write(graph, triples, path)


def _book(ending: str) -> Callable[[RecipeGraph, Ids, Path], object]:
    def write(graph: RecipeGraph, triples: Ids, path: Path) -> None:
        # The ending chooses the format, and a staged file has none.
        staged = path.with_name("book" + ending)
        write_book(graph.to_book(), staged)
        staged.rename(path)

    return write


def _graphml(graph: RecipeGraph, triples: Ids, path: Path) -> None:
    import networkx as nx

    nx.write_graphml(to_networkx(graph), path)


def _sentences(graph: RecipeGraph, triples: Ids) -> Iterator[str]:
    """Yield a line with a sentence for each recipe; a self pair names its ingredient once."""
    for recipe in graph.recipe_labels():
        first, *partners = recipe.ingredients
        if partners == [first]:
            partners = ["itself"]
        *between, last = partners or [""]
        with_others = f" with {' and '.join(filter(None, (', '.join(between), last)))}"
        yield f"Combining {first}{with_others if partners else ''} makes {recipe.result}.\n"


def _hif(graph: RecipeGraph) -> dict[str, Any]:
    """Return a graph as a document of the Hypergraph Interchange Format.

    A recipe is an edge of a directed hypergraph: its ingredients are the edge's tail, its result is
    the head. Nodes are entities by label, with ``base`` in their attributes; edges have the
    recipe's ``kind`` and ``quantities``, if any.

    Source: Coll et al., "HIF: The hypergraph interchange format for higher-order networks".
    """
    base = set(graph.base)
    nothing = [""] * graph.num_recipes
    facts_of_edges = zip(graph.kinds or nothing, graph.quantities or nothing, strict=True)
    edges: list[dict[str, Any]] = []
    incidences = []
    for edge, (recipe, facts) in enumerate(zip(graph.recipe_labels(), facts_of_edges, strict=True)):
        attributes = dict(zip(("kind", "quantities"), facts, strict=True))
        filled_facts = {name: fact for name, fact in attributes.items() if fact}
        edges.append({"edge": edge} | ({"attrs": filled_facts} if filled_facts else {}))
        # A node is once in an edge; an entity with itself has the weight 2.
        for label, count in Counter(recipe.ingredients).items():
            weight = {"weight": count} if count > 1 else {}
            incidences.append({"edge": edge, "node": label, "direction": "tail"} | weight)
        incidences.append({"edge": edge, "node": recipe.result, "direction": "head"})
    return {
        "network-type": "directed",
        "metadata": {"name": graph.name, "hash": graph.hash},
        "nodes": [{"node": label, "attrs": {"base": label in base}} for label in graph.entities],
        "edges": edges,
        "incidences": incidences,
    }


def _rdf_lines(graph: RecipeGraph, triples: Ids) -> Iterator[str]:
    """Yield N-Triples: labels, triples, and a node for each recipe."""
    # An IRI holds neither blanks nor most signs; "+" and "=" part the names in that of a recipe.
    names = [quote(label, safe="") for label in graph.entities]
    entities = [f"<{NAMESPACE}entity:{name}>" for name in names]
    for iri, label in zip(entities, graph.entities, strict=True):
        # Each escape of JSON is one of N-Triples, if characters beyond ASCII stay.
        yield f"{iri} <{_RDFS_LABEL}> {json.dumps(label, ensure_ascii=False)} .\n"
    for head, relation, tail in triples.tolist():
        predicate = f"<{NAMESPACE}relation:{RELATIONS[relation]}>"
        yield f"{entities[head]} {predicate} {entities[tail]} .\n"
    for row, size in zip(graph.sets.tolist(), graph.sizes.tolist(), strict=True):
        # Named after its labels, so that equal recipes of two graphs are one node. A statement is
        # there once, so that only this name has the same ingredient twice.
        ingredients, result = row[:size], row[-1]
        sum_of_names = "+".join(names[entity] for entity in ingredients)
        recipe = f"<{NAMESPACE}recipe:{sum_of_names}={names[result]}>"
        yield f"{recipe} <{_RDF_TYPE}> <{NAMESPACE}Recipe> .\n"
        for entity in dict.fromkeys(ingredients):
            yield f"{recipe} <{NAMESPACE}role:ingredient> {entities[entity]} .\n"
        yield f"{recipe} <{NAMESPACE}role:result> {entities[result]} .\n"


def to_networkx(graph: RecipeGraph) -> "nx.MultiDiGraph":
    """Convert a recipe graph to a networkx graph with entity nodes and recipe nodes.

    Entity nodes have ``kind="entity"``, ``base``, ``recipes`` (number of recipes for the entity),
    ``uses`` (number of recipes with the entity as ingredient) and, if reachable from the base,
    ``layer`` (crafting rounds). A recipe has a node ``recipe <index>`` with ``kind="recipe"``, and
    edges ``ingredient -> recipe -> result``, one for each time an ingredient is needed. If a label
    begins like the name of a recipe node, underscores precede these names.
    """
    import networkx as nx

    view = nx.MultiDiGraph(name=graph.name, hash=graph.hash)
    # Plain numbers, which every writer of networkx accepts.
    columns = (
        np.isin(np.arange(graph.num_entities), graph.base_ids).tolist(),
        graph.recipe_counts.tolist(),
        graph.use_counts.tolist(),
        layers(graph).tolist(),
    )
    for label, base, recipes, uses, layer in zip(graph.entities, *columns, strict=True):
        place = {"layer": layer} if layer >= 0 else {}  # GraphML cannot hold None
        view.add_node(label, kind="entity", base=base, recipes=recipes, uses=uses, **place)
    prefix = "recipe "
    while any(label.startswith(prefix) for label in graph.entities):
        prefix = "_" + prefix
    for index, recipe in enumerate(graph.recipe_labels()):
        node = f"{prefix}{index}"
        quantities = graph.quantities[index] if graph.quantities else ""
        view.add_node(node, kind="recipe", **({"quantities": quantities} if quantities else {}))
        for name, ingredient in zip(own_header(MOST_INGREDIENTS), recipe.ingredients, strict=False):
            view.add_edge(ingredient, node, name, role="ingredient")
        view.add_edge(node, recipe.result, "result", role="result")
    return view


def triples_frame(graph: RecipeGraph, triples: Ids) -> "pd.DataFrame":
    """Return a data frame of triples with the label columns ``head``, ``relation``, ``tail``.

    Args:
        graph: the recipe graph, for the labels.
        triples: shape (T, 3).
    """
    import pandas as pd

    # Objects: arrays of fixed width would take the length of the longest label for each.
    entities = np.array(graph.entities, dtype=object)
    relations = np.array(RELATIONS, dtype=object)
    head, relation, tail = triples.T
    return pd.DataFrame(
        {
            "head": entities[head],
            "relation": relations[relation],
            "tail": entities[tail],
        }
    )


EXPORTERS = {
    "tsv": Exporter(
        "triples, head relation tail",
        lambda graph, triples, path: write_atomically(path, triple_lines(triples, graph.entities)),
    ),
    "graphml": Exporter(
        "GraphML, with a node for each recipe between its ingredients and its result",
        _graphml,
        _GRAPHML_BYTES,
    ),
    "nt": Exporter(
        "RDF N-Triples, with a node for each recipe",
        lambda graph, triples, path: write_atomically(path, _rdf_lines(graph, triples)),
    ),
    "parquet": Exporter(
        "triples as a Parquet table",
        lambda graph, triples, path: triples_frame(graph, triples).to_parquet(path, index=False),
    ),
    "csv": Exporter("recipe book with its base, for build-graph", _book(".csv")),
    "json": Exporter("recipe book in our own JSON, for build-graph", _book(".json")),
    "hif": Exporter(
        "directed hypergraph in the Hypergraph Interchange Format, with an edge for each recipe",
        lambda graph, triples, path: write_atomically(path, json_text(_hif(graph)) + "\n"),
        _HIF_BYTES,
    ),
    "sentences": Exporter(
        "a sentence for each recipe, for the pretraining of language models",
        lambda graph, triples, path: write_atomically(path, _sentences(graph, triples)),
    ),
}
if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(EXPORTERS)]
