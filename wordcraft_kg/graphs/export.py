"""Writing a graph for other tools. A new exporter is a function ``(content, path) -> None`` in :data:`EXPORTERS`."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args
from urllib.parse import quote

from wordcraft_kg.base.artefacts import staged_file, staged_folder, write_atomically
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.book_files import write_book
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.frames import to_networkx, triples_frame
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import RecipeBook
from wordcraft_kg.graphs.triples import RELATIONS, triple_lines

NAMESPACE = "urn:wordcraft-kg:"
"""Prefix of the IRIs of entities (``...entity:<label>``), recipes (``...recipe:<a>+<b>=<result>``), relations
(``...relation:<name>``) and roles (``...role:ingredient``, ``...role:result``); labels are percent-encoded."""
RDF_TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
RDFS_LABEL = "http://www.w3.org/2000/01/rdf-schema#label"
ExportPart = Literal["full", "partial", "unseen"]
"""All recipes; the train recipes; or the held-out recipes, with the triples that no train recipe gives."""
MOST_BYTES = 4 * 2**30
"""Memory that an export may take."""
# Bytes of a recipe in memory while networkx or rdflib write it: measured for GraphML with 250,000 recipes.
_GRAPHML, _GEXF, _TURTLE = 6_000, 8_000, 8_000


@dataclass(frozen=True)
class Content:
    """The exported part of a graph."""

    opened: OpenedGraph
    part: ExportPart = "full"

    @cached_property
    def graph(self) -> RecipeGraph:
        """The graph with the recipes of the part only; entities and ids stay."""
        graph, split = self.opened.graph, self.opened.split
        if self.part == "full":
            return graph
        is_train = split.is_in("train")
        kept = graph.recipes[is_train if self.part == "partial" else ~is_train]
        return RecipeGraph(graph.entities, kept, graph.base_ids, graph.name)

    @property
    def triples(self) -> Ids:
        """The triples of the part, shape (T, 3), sorted."""
        return self.opened.split.unseen if self.part == "unseen" else self.opened.triples(self.part)


@dataclass(frozen=True)
class Exporter:
    """A format.

    Attributes:
        about: its content.
        write: writes it.
        is_folder: whether it is a folder.
        recipe_bytes: memory of a recipe while it is written; 0 where that is little.
    """

    about: str
    write: Callable[[Content, Path], None]
    is_folder: bool = False
    recipe_bytes: int = 0


@stage("writing the export")
def export_graph(
    opened: OpenedGraph, format: str, out: Path, *, part: ExportPart = "full", force: bool = False
) -> None:
    """Write a graph in one of the formats of :data:`EXPORTERS`; the output appears complete or not at all.

    Entities and base are always complete, whatever the ``part`` of recipes and triples.

    Raises:
        ConfigError: for an unknown format, a part of a format that holds all parts, or more memory than
            :data:`MOST_BYTES`.
        MissingExtraError: if the format needs a package that is not installed.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    one_of("format", format, tuple(EXPORTERS))
    one_of("part", part, get_args(ExportPart))
    exporter = EXPORTERS[format]
    if part != "full" and exporter.is_folder:
        raise ConfigError(f"`part` {part!r}: {format} holds the parts of the split already; leave the part out.")
    content = Content(opened, part)
    needed = content.graph.num_recipes * exporter.recipe_bytes
    if needed > MOST_BYTES:
        raise ConfigError(
            f"`format` {format!r}: {content.graph.num_recipes:,} recipes would take about {needed / 2**30:.0f} GiB of "
            f"memory; expected at most {MOST_BYTES / 2**30:.0f}. Take nt, tsv, parquet, csv or json, which take little."
        )
    staged = staged_folder if exporter.is_folder else staged_file
    with staged(out, force=force) as path:
        exporter.write(content, path)


def _book(ending: str) -> Callable[[Content, Path], None]:
    def write(content: Content, path: Path) -> None:
        graph = content.graph
        recipes = graph.recipe_labels()
        book = RecipeBook.of(graph.name, recipes, base=graph.base, listed=graph.entities, keep_self_results=True)
        staged = path.with_name("book" + ending)
        write_book(book, staged)
        staged.rename(path)

    return write


def _libkge(content: Content, folder: Path) -> None:
    """LibKGE's dataset folder: ids as ``.del`` files, the triples of each part by id, and ``dataset.yaml``."""
    graph, split = content.opened.graph, content.opened.split
    for name, labels in (("entity_ids", graph.entities), ("relation_ids", RELATIONS)):
        write_atomically(folder / f"{name}.del", (f"{i}\t{label}\n" for i, label in enumerate(labels)))
    parts = {"train": split.partial, "valid": split.held_out("valid"), "test": split.held_out("test")}
    head = (
        "# wordcraft-kg: triples of the partial knowledge graph, and the held-out ones that it does not contain.\n"
        f"dataset:\n  name: {json.dumps(graph.name, ensure_ascii=False)}\n"
    )
    values: dict[str, object] = {"num_entities": graph.num_entities, "num_relations": len(RELATIONS)}
    for name in ("entity_ids", "relation_ids"):
        values |= {f"files.{name}.filename": f"{name}.del", f"files.{name}.type": "map"}
    for part, triples in parts.items():
        write_atomically(folder / f"{part}.del", (f"{h}\t{r}\t{t}\n" for h, r, t in triples.tolist()))
        about = {"filename": f"{part}.del", "size": len(triples), "split_type": part, "type": "triples"}
        values |= {f"files.{part}.{key}": value for key, value in about.items()}
    write_atomically(folder / "dataset.yaml", head + "".join(f"  {key}: {value}\n" for key, value in values.items()))


def _networkx(writer: str) -> Callable[[Content, Path], None]:
    def write(content: Content, path: Path) -> None:
        import networkx as nx

        getattr(nx, writer)(to_networkx(content.graph, recipe_nodes=True), path)

    return write


def _statements(content: Content) -> Iterator[tuple[str, str, str]]:
    """Yield RDF statements as IRIs, the object of a label as text; a pair of one thing has one ingredient."""
    code = [quote(label, safe="") for label in content.graph.entities]
    entities = [f"{NAMESPACE}entity:{label}" for label in code]
    for iri, label in zip(entities, content.graph.entities, strict=True):
        yield iri, RDFS_LABEL, label
    for head, relation, tail in zip(*(column.tolist() for column in content.triples.T), strict=True):
        yield entities[head], f"{NAMESPACE}relation:{RELATIONS[relation]}", entities[tail]
    for a, b, result in zip(*(column.tolist() for column in content.graph.recipes.T), strict=True):
        recipe = f"{NAMESPACE}recipe:{code[a]}+{code[b]}={code[result]}"
        yield recipe, RDF_TYPE, f"{NAMESPACE}Recipe"
        for part in dict.fromkeys((a, b)):
            yield recipe, f"{NAMESPACE}role:ingredient", entities[part]
        yield recipe, f"{NAMESPACE}role:result", entities[result]


def _nt(content: Content, path: Path) -> None:
    def line(subject: str, predicate: str, value: str) -> str:
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f"<{subject}> <{predicate}> " + (f'"{escaped}" .\n' if predicate == RDFS_LABEL else f"<{value}> .\n")

    write_atomically(path, (line(*statement) for statement in _statements(content)))


def _ttl(content: Content, path: Path) -> None:
    check_extra("rdf")
    import rdflib

    store = rdflib.Graph()
    for prefix in ("entity", "recipe", "relation", "role"):
        store.bind(prefix, rdflib.Namespace(f"{NAMESPACE}{prefix}:"))
    for subject, predicate, value in _statements(content):
        term = rdflib.Literal(value) if predicate == RDFS_LABEL else rdflib.URIRef(value)
        store.add((rdflib.URIRef(subject), rdflib.URIRef(predicate), term))
    path.write_bytes(store.serialize(format="turtle", encoding="utf-8"))


_WITH_RECIPES = "with a node for each recipe"
EXPORTERS = {
    "tsv": Exporter(
        "triples, head relation tail",
        lambda content, path: write_atomically(path, triple_lines(content.triples, content.graph.entities)),
    ),
    "libkge": Exporter("LibKGE dataset folder with train, valid and test", _libkge, is_folder=True),
    "graphml": Exporter(
        f"GraphML, {_WITH_RECIPES} between its ingredients and its result",
        _networkx("write_graphml"),
        recipe_bytes=_GRAPHML,
    ),
    "gexf": Exporter(f"GEXF for Gephi, {_WITH_RECIPES}", _networkx("write_gexf"), recipe_bytes=_GEXF),
    "nt": Exporter(f"RDF N-Triples, {_WITH_RECIPES}", _nt),
    "ttl": Exporter(f"RDF Turtle, {_WITH_RECIPES} (extra: rdf)", _ttl, recipe_bytes=_TURTLE),
    "parquet": Exporter(
        "triples as a Parquet table",
        lambda content, path: triples_frame(content.graph, content.triples).to_parquet(path, index=False),
    ),
    "csv": Exporter("recipe book with its base, for build-graph", _book(".csv")),
    "json": Exporter("recipe book in our own JSON, for build-graph", _book(".json")),
}
"""The formats by name."""
if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(EXPORTERS)]
