"""Import a general graph, such as WordNet or ConceptNet, as a knowledge folder for a recipe graph."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import torch

from wordcraft_kg.base.artefacts import read_small_file, sha256_of
from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.knowledge.alignment import Alignment, align, with_overrides
from wordcraft_kg.models.knowledge.folder import (
    FACTS,
    TRIPLES,
    Knowledge,
    KnowledgeRecord,
    write_knowledge,
)
from wordcraft_kg.models.knowledge.network import Network
from wordcraft_kg.models.knowledge.paths import hops, make_tables, with_descriptions
from wordcraft_kg.models.knowledge.readers import HEADER, read_conceptnet, read_triples
from wordcraft_kg.models.knowledge.surroundings import Reach, Surroundings, Triple, reach_of
from wordcraft_kg.models.knowledge.wordnet import read_wordnet
from wordcraft_kg.models.scorers.config import check_dense

COMMAND = "import-knowledge"
Kind = Literal["wordnet", "conceptnet", "triples"]
READERS = {"wordnet": read_wordnet, "conceptnet": read_conceptnet, "triples": read_triples}
ALIGNMENT = "alignment.tsv"
_COLUMNS = ("label", "node", "method", "confidence", "meaning")
_LICENCES = {
    "wordnet": "WordNet 3.0 is copyright 2006 by Princeton University; its licence must accompany copies of a folder.",
    "conceptnet": "ConceptNet 5 is available under CC BY-SA 4.0, and so is what is made from it.",
    "triples": "The licence of the imported triples applies.",
}


class Coverage(Record, frozen=True, kw_only=True):
    """Entities aligned by one method, with their mean confidence."""

    method: str
    entities: Count
    confidence: Share


class ImportedKnowledge(Record, frozen=True, kw_only=True):
    """What was imported, from which ``source``, into the knowledge folder ``out``.

    Attributes:
        entities, aligned: numbers of labels of the recipe graph, and of labels with a node.
        coverage: labels with a node by method.
        nodes, edges: size of the imported graph.
        triples, facts: lines in ``triples.tsv`` and ``facts.tsv`` without the headers.
        reach: distances of ingredients and results in train recipes, beside random triples.
    """

    out: str
    source: str
    entities: Count
    aligned: Count
    coverage: tuple[Coverage, ...]
    nodes: Count
    edges: Count
    tables: tuple[str, ...]
    triples: Count
    facts: Count
    reach: Reach


def import_knowledge(
    opened: OpenedGraph,
    kind: Kind,
    path: Path,
    out: Path,
    *,
    overrides: Path | None = None,
    force: bool = False,
) -> ImportedKnowledge:
    """Import a general graph for a recipe graph; test and validation recipes are not read.

    The train recipes in ``opened`` decide between senses. ``path`` is WordNet's folder, ConceptNet's assertions, or a
    file of triples; ``overrides`` is a file for :func:`read_overrides`.

    KnowledgeFileError naming the line, for a damaged file, and if no label has a node; ConfigError if the graph has too
    many entities; OutputExistsError if ``out`` exists and ``force`` is False.
    """
    entities, recipes = opened.graph.entities, opened.split.recipes("train")
    check_dense("knowledge from outside the book", len(entities))
    chosen = {} if overrides is None else read_overrides(overrides)
    with stage(f"reading {path}"):
        network = READERS[kind](path)
    with stage("aligning labels"):
        alignment = with_overrides(align(network, entities, recipes), network, entities, chosen)
        if (alignment.nodes < 0).all():
            raise KnowledgeFileError(
                f"{path}: none of the {len(entities):,} labels of '{opened.graph.name}', such as '{entities[0]}', is "
                f"in {network.source}. Expected a graph with English names, or `overrides`."
            )
        if network.glosses:
            network = with_descriptions(network, alignment, entities)
    with stage("making tables"):
        walks = hops(network, alignment)
        tables = make_tables(network, alignment, walks)
        surroundings = Surroundings(network, alignment, entities)
        triples, facts = list(surroundings.triples()), list(surroundings.facts())
    record = KnowledgeRecord(
        source=network.source,
        entities=entities,
        tables=tuple(info for info, _ in tables),
        triples=len(triples),
    )
    knowledge = Knowledge(record, tuple(torch.from_numpy(values).half() for _, values in tables))
    view = ImportedKnowledge(
        out=str(out),
        source=network.source,
        entities=len(entities),
        aligned=int((alignment.nodes >= 0).sum()),
        coverage=coverage_of(alignment),
        nodes=len(network.nodes),
        edges=len(network.edges),
        tables=tuple(info.name for info, _ in tables),
        triples=len(triples),
        facts=len(facts),
        reach=reach_of(walks, recipes),
    )
    files = {
        TRIPLES: _table(HEADER, triples),
        FACTS: _table(("entity", "relation", "entity or class"), facts),
        ALIGNMENT: _table(_COLUMNS, _alignment_rows(network, alignment, entities)),
        "README.md": _card(view, opened, kind),
    }
    inputs = {"graph": opened.graph.hash, "split": opened.split.hash, **_hashes(path)}
    if overrides is not None:
        inputs["overrides"] = sha256_of(overrides)
    write_knowledge(out, COMMAND, knowledge, inputs=inputs, files=files, force=force)
    return view


def read_overrides(path: Path) -> dict[str, str]:
    """Read nodes by label from lines as in ``alignment.tsv``; KnowledgeFileError names a wrong line."""
    if not path.is_file():
        raise KnowledgeFileError(
            f"{path} is not a file; expected lines with a label, a tab and a node."
        )
    collected: dict[str, str] = {}
    try:
        lines = read_small_file(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise KnowledgeFileError(f"{path} is not UTF-8. Save the file as UTF-8.") from None
    for number, line in enumerate(lines, 1):
        label, *columns = line.split("\t")
        if line.strip() and (number, label) != (1, _COLUMNS[0]):
            if not columns or label in collected:
                what = "is repeated" if columns else "has no tab"
                raise KnowledgeFileError(
                    f"{path}, line {number}: '{label}' {what}; expected a label, a tab and a node."
                )
            collected[label] = columns[0].strip()
    return collected


def coverage_of(alignment: Alignment) -> tuple[Coverage, ...]:
    """Return numbers of entities and mean confidences by method, most entities first."""
    counts = Counter(alignment.methods)
    return tuple(
        Coverage(
            method=method,
            entities=count,
            confidence=float(
                alignment.confidences[[one == method for one in alignment.methods]].mean()
            ),
        )
        for method, count in counts.most_common()
    )


def _alignment_rows(
    network: Network, alignment: Alignment, entities: Sequence[str]
) -> list[Sequence[str]]:
    rows = list[Sequence[str]]()
    for label, node, method, confidence in zip(
        entities, alignment.nodes.tolist(), alignment.methods, alignment.confidences, strict=True
    ):
        name = f"{network.prefix}:{network.nodes[node]}" if node >= 0 else ""
        meaning = (
            f"{', '.join(network.lemmas[node])}: {network.glosses[node]}"
            if name and network.glosses
            else ""
        )
        rows.append((label, name, method, f"{confidence:.3f}", meaning))
    return rows


def _table(header: Sequence[str], rows: Sequence[Sequence[str]] | Sequence[Triple]) -> str:
    return "".join("\t".join(row) + "\n" for row in (header, *rows))


def _hashes(path: Path) -> dict[str, str]:
    files = [path] if path.is_file() else sorted(one for one in path.iterdir() if one.is_file())
    return {one.name: sha256_of(one) for one in files}


def describe(view: ImportedKnowledge) -> list[tuple[str, ...]]:
    """Return the rows of a table: labels by method with confidence, and recipes by hops beside random triples."""
    rows: list[tuple[str, ...]] = [("aligned by", "labels", "confidence")]
    rows += [(one.method, f"{one.entities:,}", f"{one.confidence:.2f}") for one in view.coverage]
    rows.append(("ingredients and result within", "train recipes", "random triples"))
    for hop, shares in enumerate(zip(view.reach.recipes, view.reach.random, strict=True), 1):
        rows.append((f"{hop} hop{'s' * (hop > 1)}", *(f"{share:.1%}" for share in shares)))
    return rows


def _card(view: ImportedKnowledge, opened: OpenedGraph, kind: Kind) -> str:
    rows = "\n".join(
        "| " + " | ".join(row) + " |"
        for row in [*describe(view)[:1], ("---",) * 3, *describe(view)[1:]]
    )
    return (
        f"# Knowledge from {view.source}\n\nFor graph `{opened.graph.hash[:12]}`, split `{opened.split.hash[:12]}`: "
        f"{view.aligned:,} of {view.entities:,} labels are aligned with {view.nodes:,} nodes. {view.triples:,} "
        f"triples, {view.facts:,} facts, tables {', '.join(view.tables)}. No validation or test recipe was read.\n\n"
        f"{rows}\n\n{_LICENCES[kind]}\n"
    )
