"""Import a general graph, such as WordNet, as a knowledge folder for a recipe graph.

The page docs/outside-knowledge.md describes the command and its files.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from wordcraft_kg.base import (
    Count,
    KnowledgeFileError,
    Record,
    nearest,
    read_small_file,
    sha256_of,
    stage,
)
from wordcraft_kg.graphs import RELATIONS, OpenedGraph, is_in
from wordcraft_kg.models.knowledge.knowledge_folder import (
    TRIPLES,
    KnowledgeRecord,
    KnowledgeTables,
    write_knowledge,
)
from wordcraft_kg.models.knowledge.network import Alignment, Network, align
from wordcraft_kg.models.knowledge.readers import (
    HEADER,
    read_conceptnet,
    read_triples,
    read_wordnet,
)
from wordcraft_kg.models.knowledge.surroundings import (
    make_tables,
    near_triples,
    with_descriptions,
)
from wordcraft_kg.models.scorers.score_limits import check_table

COMMAND = "import-knowledge"
"""Name of the command in ``run.json``."""
Kind = Literal["wordnet", "conceptnet", "triples"]
READERS = {"wordnet": read_wordnet, "conceptnet": read_conceptnet, "triples": read_triples}
"""Readers of graphs, by kind."""
ALIGNMENT = "alignment.tsv"
"""File with the node of each label, in the form in which overrides are read."""
_COLUMNS = ("label", "node", "method", "confidence", "meaning")
_LICENCES = {
    "wordnet": "WordNet 3.0 is copyright 2006 by Princeton University; its licence must accompany "
    "copies of a folder.",
    "conceptnet": "ConceptNet 5 is available under CC BY-SA 4.0, and so is what is made from it.",
    "triples": "The licence of the imported triples applies.",
}


class ImportedKnowledge(Record, frozen=True, kw_only=True):
    """What was imported.

    Attributes:
        out: the knowledge folder.
        source: display name of the imported graph.
        entities: number of labels in the recipe graph.
        aligned: number of labels with a node.
        held_out: number of triples of held-out recipes in the file; above 0, scores that learn
            from it know test recipes.
        nodes: number of nodes in the imported graph.
        edges: number of edges in the imported graph, with those from definitions.
        tables: names of the tables.
        triples: number of lines in ``triples.tsv`` without the header.
    """

    out: str
    source: str
    entities: Count
    aligned: Count
    held_out: Count
    nodes: Count
    edges: Count
    tables: tuple[str, ...]
    triples: Count


def import_knowledge(
    opened: OpenedGraph,
    kind: Kind,
    path: Path,
    out: Path,
    *,
    overrides: Path | None = None,
    force: bool = False,
) -> ImportedKnowledge:
    """Import a general graph for a recipe graph; recipes are read for a warning alone.

    Args:
        opened: recipe graph, and the split whose held-out triples the warning counts.
        kind: kind of the imported graph.
        path: WordNet's folder, ConceptNet's assertions, or a file of triples.
        out: the knowledge folder.
        overrides: file with nodes for some labels, see :func:`with_overrides`; None without.
        force: replace the folder.

    Raises:
        KnowledgeFileError: for a damaged file (the error names the line), and if no label has a
            node.
        ConfigError: if the recipe graph has too many entities for tables of all pairs.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    entities = opened.graph.entities
    # Checked before the slow steps.
    check_table("knowledge from outside the book", len(entities))
    if overrides is not None and not overrides.is_file():
        raise KnowledgeFileError(f"{overrides} is not a file; expected lines as in {ALIGNMENT}.")
    with stage(f"reading {path}"):
        network = READERS[kind](path)
    with stage("aligning labels"):
        alignment = align(network, entities)
        # What a person says goes before what was found.
        if overrides is not None:
            alignment = with_overrides(alignment, network, entities, overrides)
        if (alignment.nodes < 0).all():
            raise KnowledgeFileError(
                f"{path}: none of the {len(entities):,} labels of '{opened.graph.name}', such as "
                f"'{entities[0]}', is in {network.source}. Expected a graph with English "
                "names, or `overrides`."
            )
        if network.glosses:
            network = with_descriptions(network, alignment, entities)
    with stage("making tables"):
        tables = make_tables(network, alignment)
        triples = near_triples(network, alignment, entities)
    held_out = _num_held_out(network, alignment, opened)
    if held_out:
        logging.getLogger(__name__).warning(
            "%s holds %s triples of held-out recipes of '%s', so success on test tasks would say "
            "nothing. Export the train recipes alone: `wordcraft-kg export --part partial`.",
            *(path, f"{held_out:,}", opened.graph.name),
        )
    record = KnowledgeRecord(
        source=network.source,
        entities=entities,
        tables=tuple(info for info, _ in tables),
        triples=len(triples),
    )
    # Half precision: the tables of all pairs are by far the largest files of a folder.
    halves = tuple(torch.from_numpy(values).half() for _, values in tables)
    view = ImportedKnowledge(
        out=str(out),
        source=network.source,
        entities=len(entities),
        aligned=int((alignment.nodes >= 0).sum()),
        held_out=held_out,
        nodes=len(network.nodes),
        edges=len(network.edges),
        tables=tuple(info.name for info, _ in tables),
        triples=len(triples),
    )
    contents = {
        TRIPLES: _table(HEADER, triples),
        ALIGNMENT: _table(_COLUMNS, _alignment_rows(network, alignment, entities)),
        "README.md": _card(view, opened, kind),
    }
    # A file, or each file in a folder, by name.
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    hashes = {file.name: sha256_of(file) for file in files if file.is_file()}
    inputs = {"graph": opened.graph.hash, **hashes}
    if overrides is not None:
        inputs["overrides"] = sha256_of(overrides)
    knowledge = KnowledgeTables(record, halves)
    write_knowledge(out, COMMAND, knowledge, inputs=inputs, files=contents, force=force)
    return view


def _num_held_out(network: Network, alignment: Alignment, opened: OpenedGraph) -> int:
    """Return the number of triples of held-out recipes among the edges of a network."""
    if not set(RELATIONS) <= set(network.relations):
        return 0
    places = np.array([network.relations.index(name) for name in RELATIONS])
    head, relation, tail = opened.split.unseen.T
    edges = np.column_stack([alignment.nodes[head], places[relation], alignment.nodes[tail]])
    is_aligned = (edges >= 0).all(1)
    return int(is_in(edges[is_aligned], network.edges, len(network.nodes)).sum())


def with_overrides(
    alignment: Alignment, network: Network, entities: Sequence[str], path: Path
) -> Alignment:
    """Replace the nodes of some labels by nodes that the user names.

    Args:
        alignment: the automatic alignment.
        network: the graph from outside the book.
        entities: labels in id order.
        path: lines as in ``alignment.tsv``, of which two columns count: a label and a node; without
            a node, the label is left out.

    Returns:
        A new alignment, in which a named node has confidence 1.

    Raises:
        KnowledgeFileError: for an unknown or repeated label, or an unknown node.
        ArtefactError: if the file cannot be read.
    """
    nodes = alignment.nodes.copy()
    confidences = alignment.confidences.copy()
    methods = list(alignment.methods)
    numbers = {network.name_of(node): node for node in range(len(network.nodes))}
    # Nothing leaves a label out.
    numbers[""] = -1
    lines_of: dict[str, int] = {}
    lines = read_small_file(path).decode("utf-8-sig", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        label, tab, columns = line.partition("\t")
        is_header = number == 1 and label == _COLUMNS[0]
        if is_header or not line.strip():
            continue
        name = columns.partition("\t")[0].strip()
        if not tab or label not in entities or name not in numbers:
            raise KnowledgeFileError(
                f"{path}, line {number}: '{line[:80]}' is not a label of the graph, a tab, and a "
                f"node of {network.source} or nothing.{nearest(label, entities)} Expected lines as "
                f"in {ALIGNMENT}, in UTF-8."
            )
        if label in lines_of:
            raise KnowledgeFileError(
                f"{path}, line {number}: '{label}' stands in line {lines_of[label]}, too; expected "
                "each label once."
            )
        lines_of[label] = number
        entity = entities.index(label)
        nodes[entity] = numbers[name]
        confidences[entity] = float(bool(name))
        methods[entity] = "override" if name else "left out"
    return Alignment(nodes, tuple(methods), confidences)


def _alignment_rows(
    network: Network,
    alignment: Alignment,
    entities: Sequence[str],
) -> list[Sequence[str]]:
    """Return the lines of ``alignment.tsv``, in columns."""
    rows = list[Sequence[str]]()
    columns = (entities, alignment.nodes, alignment.methods, alignment.confidences)
    for label, node, method, confidence in zip(*columns, strict=True):
        name = network.name_of(node) if node >= 0 else ""
        meaning = ""
        if node >= 0 and network.glosses:
            meaning = f"{', '.join(network.lemmas[node])}: {network.glosses[node]}"
        rows.append((label, name, method, f"{confidence:.3f}", meaning))
    return rows


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a text with tabs between columns, and a line end after each row."""
    lines = ["\t".join(row) for row in (header, *rows)]
    return "\n".join([*lines, ""])


def _card(view: ImportedKnowledge, opened: OpenedGraph, kind: Kind) -> str:
    """Return the folder's ``README.md``."""
    return (
        f"# Knowledge from {view.source}\n\n"
        f"For graph `{opened.graph.hash[:12]}`: "
        f"{view.aligned:,} of {view.entities:,} labels are aligned with {view.nodes:,} nodes. "
        f"{view.triples:,} triples, tables {', '.join(view.tables)}. "
        "No recipe was used.\n\n"
        f"{_LICENCES[kind]}\n"
    )
