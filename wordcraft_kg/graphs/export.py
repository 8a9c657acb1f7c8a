"""Writing a graph for other tools. A new exporter is a function ``(opened, path) -> None`` in :data:`EXPORTERS`."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote

from wordcraft_kg.artefacts import staged_file, staged_folder, write_atomically
from wordcraft_kg.errors import MissingExtraError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.frames import to_networkx, triples_frame
from wordcraft_kg.graphs.recipes import RecipeBook, write_book
from wordcraft_kg.graphs.triples import RELATIONS, triple_lines
from wordcraft_kg.progress import stage
from wordcraft_kg.settings import one_of

NAMESPACE = "urn:wordcraft-kg:"
"""IRI prefix of entities (``...entity:<label, percent-encoded>``) and relations (``...relation:<name>``)."""


@dataclass(frozen=True)
class Exporter:
    """A format: what it is for, whether it is a folder, and the function that writes it."""

    about: str
    write: Callable[[OpenedGraph, Path], None]
    is_folder: bool = False


@stage("writing the export")
def export_graph(opened: OpenedGraph, format: str, out: Path, *, force: bool = False) -> None:
    """Write a graph in one of the formats of :data:`EXPORTERS`; the output appears complete or not at all.

    Raises:
        ConfigError: for an unknown format.
        MissingExtraError: if the format needs a package that is not installed.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    one_of("format", format, tuple(EXPORTERS))
    exporter = EXPORTERS[format]
    staged = staged_folder if exporter.is_folder else staged_file
    with staged(out, force=force) as path:
        exporter.write(opened, path)


def _book(ending: str) -> Callable[[OpenedGraph, Path], None]:
    def write(opened: OpenedGraph, path: Path) -> None:
        graph = opened.graph
        recipes = graph.recipe_labels()
        book = RecipeBook.of(graph.name, recipes, base=graph.base, listed=graph.entities, keep_self_results=True)
        staged = path.with_name("book" + ending)
        write_book(book, staged)
        staged.rename(path)

    return write


def _tsv(opened: OpenedGraph, path: Path) -> None:
    write_atomically(path, triple_lines(opened.graph.triples, opened.graph.entities))


def _libkge(opened: OpenedGraph, folder: Path) -> None:
    """LibKGE's dataset folder: ids as ``.del`` files, the triples of each part by id, and ``dataset.yaml``."""
    graph, split = opened.graph, opened.split
    for name, labels in (("entity_ids", graph.entities), ("relation_ids", RELATIONS)):
        write_atomically(folder / f"{name}.del", (f"{i}\t{label}\n" for i, label in enumerate(labels)))
    parts = {"train": split.partial, "valid": split.held_out("valid"), "test": split.held_out("test")}
    lines = [
        "# wordcraft-kg: triples of the partial knowledge graph, and the held-out ones that it does not contain.",
        "dataset:",
        f"  name: {json.dumps(graph.name, ensure_ascii=False)}",
        f"  num_entities: {graph.num_entities}",
        f"  num_relations: {len(RELATIONS)}",
        "  files.entity_ids.filename: entity_ids.del",
        "  files.entity_ids.type: map",
        "  files.relation_ids.filename: relation_ids.del",
        "  files.relation_ids.type: map",
    ]
    for part, triples in parts.items():
        write_atomically(folder / f"{part}.del", (f"{h}\t{r}\t{t}\n" for h, r, t in triples.tolist()))
        lines += [
            f"  files.{part}.filename: {part}.del",
            f"  files.{part}.size: {len(triples)}",
            f"  files.{part}.split_type: {part}",
            f"  files.{part}.type: triples",
        ]
    write_atomically(folder / "dataset.yaml", "\n".join(lines) + "\n")


def _graphml(opened: OpenedGraph, path: Path) -> None:
    import networkx as nx

    nx.write_graphml(to_networkx(opened.graph, recipe_nodes=True), path)


def _gexf(opened: OpenedGraph, path: Path) -> None:
    import networkx as nx

    nx.write_gexf(to_networkx(opened.graph, recipe_nodes=True), path)


def _rdf(format: str) -> Callable[[OpenedGraph, Path], None]:
    def write(opened: OpenedGraph, path: Path) -> None:
        rdflib = _needs("rdflib", "rdf")
        store = rdflib.Graph()
        entity, relation = (rdflib.Namespace(f"{NAMESPACE}{kind}:") for kind in ("entity", "relation"))
        store.bind("relation", relation)
        store.bind("entity", entity)
        nodes = [entity[quote(label, safe="")] for label in opened.graph.entities]
        for node, label in zip(nodes, opened.graph.entities, strict=True):
            store.add((node, rdflib.RDFS.label, rdflib.Literal(label)))
        for head, predicate, tail in opened.graph.triples.tolist():
            store.add((nodes[head], relation[RELATIONS[predicate]], nodes[tail]))
        text = store.serialize(format=format, encoding="utf-8")
        # N-Triples come in the order of a hash table; sorting the lines gives the same bytes every time.
        path.write_bytes(b"".join(sorted(text.splitlines(keepends=True))) if format == "nt" else text)

    return write


def _parquet(opened: OpenedGraph, path: Path) -> None:
    triples_frame(opened.graph).to_parquet(path, engine="pyarrow", index=False)


def _needs(package: str, extra: str) -> Any:
    from importlib import import_module

    try:
        return import_module(package)
    except ImportError:
        raise MissingExtraError(
            f"this format needs {package}, which is not installed. Install it: pip install 'wordcraft-kg[{extra}]'"
        ) from None


EXPORTERS = {
    "tsv": Exporter("triples of the full graph, head relation tail", _tsv),
    "libkge": Exporter("LibKGE dataset folder with train, valid and test", _libkge, is_folder=True),
    "graphml": Exporter("GraphML, with a node for each recipe between its ingredients and its result", _graphml),
    "gexf": Exporter("GEXF for Gephi, with a node for each recipe", _gexf),
    "nt": Exporter("RDF N-Triples (extra: rdf)", _rdf("nt")),
    "ttl": Exporter("RDF Turtle (extra: rdf)", _rdf("turtle")),
    "parquet": Exporter("triples as a Parquet table", _parquet),
    "csv": Exporter("recipe book with its base, for build-graph", _book(".csv")),
    "json": Exporter("recipe book in our own JSON, for build-graph", _book(".json")),
}
"""The formats by name."""
if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(EXPORTERS)]
