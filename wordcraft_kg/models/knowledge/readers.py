"""Read ConceptNet assertions, and tables of triples, line by line; plain or gzipped.

Memory holds nodes and edges, about 150 bytes for a new node and 30 for an edge, never the lines.

The page docs/outside-knowledge.md describes the formats.
"""

import csv
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from wordcraft_kg.base.artefacts import read_lines
from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.models.knowledge.network import Network, plain, unique_edges

HEADER = ("head", "relation", "tail")
"""Header of the files that the product writes."""
HEAVIEST = 1e30
"""Weights are below: sums must fit into 32-bit numbers."""
EXPECTED = (
    "expected head, relation and tail with tabs between them, or below a header with these names "
    "and perhaps weight (positive numbers), with tabs or commas, in UTF-8. "
    "`wordcraft-kg export --format tsv` and DataFrame.to_csv of pandas write such a table"
)
_USELESS = {
    b"/r/ExternalURL",
    b"/r/FormOf",
    b"/r/EtymologicallyDerivedFrom",
    b"/r/EtymologicallyRelatedTo",
}
"""Relations about words or web pages, not about things; also all below /r/dbpedia/."""
_SYMMETRIC = {b"Antonym", b"DistinctFrom", b"LocatedNear", b"RelatedTo", b"SimilarTo", b"Synonym"}
"""Relations whose edges are stored in one direction, so that two assertions are not two edges."""
_ENGLISH = b"/c/en/"


class _Assertion(msgspec.Struct):
    """The last column of an assertion, JSON with many more keys, which are skipped."""

    weight: Annotated[float, msgspec.Meta(lt=HEAVIEST)]


def read_conceptnet(path: Path) -> Network:
    """Read assertions about English words, whose senses are one node.

    Raises:
        KnowledgeFileError: if the file cannot be read, has no English assertion, or has a wrong
            line (the error names the line).
    """
    decode = msgspec.json.Decoder(_Assertion).decode
    collected = _Collected(path)
    for number, line in _lines(path):
        columns = line.split(b"\t")
        if len(columns) != 5:
            raise _fault(
                path, number, f"{len(columns)} columns; expected uri, relation, start, end and JSON"
            )
        _, relation, start, end, about = columns
        # Before the JSON is decoded: most of the 34 million lines are about other languages.
        is_english = start.startswith(_ENGLISH) and end.startswith(_ENGLISH)
        if not is_english or relation in _USELESS:
            continue
        try:
            weight = decode(about).weight
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise _fault(
                path, number, f"the last column is not JSON with a weight ({error})"
            ) from None
        name = relation.removeprefix(b"/r/")
        if weight > 0 and not name.startswith(b"dbpedia/"):
            # /c/en/word/n/sense: the word alone.
            head, _, _ = start.removeprefix(_ENGLISH).partition(b"/")
            tail, _, _ = end.removeprefix(_ENGLISH).partition(b"/")
            if name in _SYMMETRIC:
                head, tail = sorted((head, tail))
            collected.add(head, name, tail, weight)
    return collected.network("ConceptNet", "cn")


def read_triples(path: Path) -> Network:
    """Read a table of triples: tabs between head, relation and tail, or a header with these names.

    A header may have the columns in any order, and a weight. Its columns are separated by tabs, or
    by commas with quotation marks where a cell holds a comma.

    Raises:
        KnowledgeFileError: if the file cannot be read, has no triple, or has a wrong line (the
            error names the line).
    """
    collected = _Collected(path)
    header: list[str] = []
    has_tabs = False
    for number, line in _lines(path):
        try:
            text = line.decode().strip("\r\n")
            # The header decides: a label in a row may hold either character.
            has_tabs = has_tabs or (not header and "\t" in text)
            cells = text.split("\t") if has_tabs else next(csv.reader([text]))
            row = [" ".join(cell.split()) for cell in cells]
            if not header:
                header = [name.casefold() for name in row]
                if sorted(header) in (sorted(HEADER), sorted((*HEADER, "weight"))):
                    continue
                # Our exports, and data sets of link prediction, have tabs and no header.
                if not has_tabs or not set(HEADER).isdisjoint(header):
                    raise ValueError
                header = list(HEADER)
            by_name = dict(zip(header, row, strict=True))
            weight = float(by_name.get("weight", 1))
            # Not a number fails both comparisons.
            if not all(row) or not 0 < weight < HEAVIEST:
                raise ValueError
        except (ValueError, csv.Error):
            shown = line[:80].decode(errors="replace").strip()
            raise _fault(path, number, f"'{shown}'; {EXPECTED}") from None
        head, relation, tail = (by_name[name].encode() for name in HEADER)
        collected.add(head, relation, tail, weight)
    # The name of the file, without .tsv and .gz, is the source's.
    source, _, _ = path.name.partition(".")
    return collected.network(source or "triples", "other")


class _Collected:
    """Nodes, relations and edges, in the order of the file."""

    def __init__(self, path: Path):
        self.path = path
        self.nodes: dict[bytes, int] = {}
        self.relations: dict[bytes, int] = {}
        # C numbers of 32 bits, for the memory that the module promises.
        self.ids = array("i")
        self.weights = array("f")

    def add(self, head: bytes, relation: bytes, tail: bytes, weight: float) -> None:
        """Add an edge; a new name gets the next number.

        Args:
            head: name of a node.
            relation: name of a relation.
            tail: name of a node.
            weight: positive weight.
        """
        nodes = self.nodes
        head_id = nodes.setdefault(head, len(nodes))
        relation_id = self.relations.setdefault(relation, len(self.relations))
        # After the head, which may have become a node just now.
        tail_id = nodes.setdefault(tail, len(nodes))
        self.ids.extend((head_id, relation_id, tail_id))
        self.weights.append(weight)

    def network(self, source: str, prefix: str) -> Network:
        """Return the edges as a network; w, the sum of an edge's weights, becomes log(1 + w).

        Args:
            source: name of the network, for reports and errors.
            prefix: beginning of the names of nodes and relations, such as ``wn``.

        Raises:
            KnowledgeFileError: if the file has no triple to use, or is not UTF-8.
        """
        if not self.ids:
            raise KnowledgeFileError(
                f"{self.path} has no triple to use; expected {source}'s triples."
            )
        try:
            nodes = [name.decode() for name in self.nodes]
            relations = [name.decode() for name in self.relations]
        except UnicodeDecodeError as error:
            raise KnowledgeFileError(
                f"{self.path} is not UTF-8: {error.object[:80]!r}. Save it as UTF-8."
            ) from None
        # The names as bytes are no longer needed.
        self.nodes.clear()
        # Three numbers for each edge, one after another: head, relation and tail.
        ids = np.frombuffer(self.ids, np.int32).reshape(-1, 3)
        sums = np.frombuffer(self.weights, np.float32)
        edges, weights = unique_edges(
            ids.astype(np.int64),
            sums.astype(np.float64),
            (len(nodes), len(relations)),
        )
        spellings: dict[str, tuple[int, ...]] = {}
        for node, name in enumerate(nodes):
            # ConceptNet's names are folded already, which :func:`plain` would do again for
            # millions.
            if prefix == "other":
                text = plain(name)
            else:
                text = name.replace("_", " ").replace("'", "")
            spellings[text] = (*spellings.get(text, ()), node)
        return Network(source, prefix, nodes, relations, edges, np.log1p(weights), spellings)


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield lines that are not blank, numbered from 1, from a plain or gzipped file."""
    if not path.is_file():
        raise KnowledgeFileError(
            f"{path} is not a file; expected a file of triples or assertions, plain or gzipped."
        )
    for number, line in read_lines(path, KnowledgeFileError):
        if not line.isspace():
            yield number, line


def _fault(path: Path, line: int, problem: str) -> KnowledgeFileError:
    return KnowledgeFileError(
        f"{path}, line {line:,}: {problem}. Restore a copy of the file, or correct the line."
    )
