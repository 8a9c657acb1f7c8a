"""Export recipe graphs to file formats for other tools; add a format as an :class:`Exporter` in :data:`EXPORTERS`."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args
from urllib.parse import quote

from wordcraft_kg.base.artefacts import staged_file, write_atomically
from wordcraft_kg.base.errors import ConfigError
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
"""Prefix of IRIs in RDF: ``entity:<label>``, ``recipe:<a>+<b>=<result>``, ``relation:<name>``, ``role:ingredient``,
``role:result``; labels are percent-encoded."""
_RDF_TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
_RDFS_LABEL = "http://www.w3.org/2000/01/rdf-schema#label"
ExportPart = Literal["full", "partial", "unseen"]
"""All recipes, the train recipes, or the held-out recipes with the triples that no train recipe gives."""
MOST_BYTES = 4 * 2**30
_GRAPHML_BYTES = 6_000  # per recipe while networkx writes, measured with 250,000 recipes


@dataclass(frozen=True)
class Content:
    """Recipes and triples to export: all, train or held-out, by ``part``."""

    opened: OpenedGraph
    part: ExportPart = "full"

    @cached_property
    def graph(self) -> RecipeGraph:
        """The recipe graph with the exported recipes only; entities and ids stay."""
        graph, split = self.opened.graph, self.opened.split
        if self.part == "full":
            return graph
        is_train = split.is_in("train")
        kept = is_train if self.part == "partial" else ~is_train
        exported = RecipeGraph(graph.entities, graph.recipes[kept], graph.base_ids, graph.name)
        exported.kinds = None if graph.kinds is None else tuple(compress(graph.kinds, kept))
        return exported

    @property
    def triples(self) -> Ids:
        """The exported triples, shape (T, 3), sorted."""
        return self.opened.split.unseen if self.part == "unseen" else self.opened.triples(self.part)


@dataclass(frozen=True)
class Exporter:
    """An export format; writing needs ``recipe_bytes`` bytes memory per recipe, 0 if negligible."""

    about: str
    write: Callable[[Content, Path], None]
    recipe_bytes: int = 0


@stage("writing the export")
def export_graph(
    opened: OpenedGraph, format: str, out: Path, *, part: ExportPart = "full", force: bool = False
) -> None:
    """Write a graph to the file ``out`` in a format of :data:`EXPORTERS`.

    ``part`` selects recipes and triples, never entities.

    Raises:
        ConfigError: for an unknown format or part, or if writing needs over 4 GiB memory.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    one_of("format", format, tuple(EXPORTERS))
    one_of("part", part, get_args(ExportPart))
    exporter = EXPORTERS[format]
    content = Content(opened, part)
    needed = content.graph.num_recipes * exporter.recipe_bytes
    if needed > MOST_BYTES:
        raise ConfigError(
            f"`format` {format!r}: {content.graph.num_recipes:,} recipes would take about {needed / 2**30:.0f} GiB of "
            f"memory; expected at most {MOST_BYTES / 2**30:.0f}. Take nt, tsv, parquet, csv or json, which need little."
        )
    with staged_file(out, force=force) as path:
        exporter.write(content, path)


def _book(ending: str) -> Callable[[Content, Path], None]:
    def write(content: Content, path: Path) -> None:
        graph = content.graph
        recipes = graph.recipe_labels()
        book = RecipeBook.of(graph.name, recipes, base=graph.base, listed=graph.entities, keep_self_results=True)
        if graph.kinds is not None:
            book = replace(
                book, kinds={recipe: kind for recipe, kind in zip(recipes, graph.kinds, strict=True) if kind}
            )
        staged = path.with_name("book" + ending)
        write_book(book, staged)
        staged.rename(path)

    return write


def _graphml(content: Content, path: Path) -> None:
    import networkx as nx

    nx.write_graphml(to_networkx(content.graph, recipe_nodes=True), path)


def _statements(content: Content) -> Iterator[tuple[str, str, str]]:
    """Yield RDF statements as IRIs; labels are text, and a self pair has one ingredient."""
    code = [quote(label, safe="") for label in content.graph.entities]
    entities = [f"{NAMESPACE}entity:{label}" for label in code]
    for iri, label in zip(entities, content.graph.entities, strict=True):
        yield iri, _RDFS_LABEL, label
    for head, relation, tail in zip(*(column.tolist() for column in content.triples.T), strict=True):
        yield entities[head], f"{NAMESPACE}relation:{RELATIONS[relation]}", entities[tail]
    for a, b, result in zip(*(column.tolist() for column in content.graph.recipes.T), strict=True):
        recipe = f"{NAMESPACE}recipe:{code[a]}+{code[b]}={code[result]}"
        yield recipe, _RDF_TYPE, f"{NAMESPACE}Recipe"
        for part in dict.fromkeys((a, b)):
            yield recipe, f"{NAMESPACE}role:ingredient", entities[part]
        yield recipe, f"{NAMESPACE}role:result", entities[result]


def _nt(content: Content, path: Path) -> None:
    def line(subject: str, predicate: str, value: str) -> str:
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f"<{subject}> <{predicate}> " + (f'"{escaped}" .\n' if predicate == _RDFS_LABEL else f"<{value}> .\n")

    write_atomically(path, (line(*statement) for statement in _statements(content)))


EXPORTERS = {
    "tsv": Exporter(
        "triples, head relation tail",
        lambda content, path: write_atomically(path, triple_lines(content.triples, content.graph.entities)),
    ),
    "graphml": Exporter(
        "GraphML, with a node for each recipe between its ingredients and its result", _graphml, _GRAPHML_BYTES
    ),
    "nt": Exporter("RDF N-Triples, with a node for each recipe", _nt),
    "parquet": Exporter(
        "triples as a Parquet table",
        lambda content, path: triples_frame(content.graph, content.triples).to_parquet(path, index=False),
    ),
    "csv": Exporter("recipe book with its base, for build-graph", _book(".csv")),
    "json": Exporter("recipe book in our own JSON, for build-graph", _book(".json")),
}
if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(EXPORTERS)]
