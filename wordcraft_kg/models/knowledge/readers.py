"""Read ConceptNet assertions, and files of triples, line by line; plain or gzipped.

Memory holds nodes and edges, about 150 bytes for a new node and 30 for an edge, never the lines.

The page docs/outside-knowledge.md describes the formats.
"""

import csv
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from wordcraft_kg.base.artefacts import read_lines
from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.models.knowledge.network import Network, plain, unique_edges
from wordcraft_kg.models.knowledge.triple_lines import (
    EXPECTED,
    HEAVIEST,
    Name,
    Parser,
    Table,
    local_name,
    parser_of,
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
    """Read a table of triples, perhaps with weights and a header, or N-Triples.

    Raises:
        KnowledgeFileError: if the file cannot be read, has no triple, has a wrong line (the error
            names the line), or has columns in another order.
    """
    collected = _Collected(path)
    names = defaultdict[str, list[str]](list)
    parse: Parser | None = None
    for number, line in _lines(path):
        try:
            text = line.decode().strip("\r\n")
            parse = parse or parser_of(text)
            parsed = parse(text)
        except UnicodeError:
            raise _fault(path, number, f"the line is not UTF-8; {EXPECTED}") from None
        except (ValueError, csv.Error) as error:
            shown = line[:80].decode(errors="replace").strip()
            raise _fault(path, number, f"'{shown}'; {error}") from None
        if isinstance(parsed, Name):
            names[parsed.node].append(parsed.text)
        elif parsed is not None:
            collected.add(parsed.head, parsed.relation, parsed.tail, parsed.weight)
    if isinstance(parse, Table) and not parse.header:
        collected.check_columns()
    # The name of the file, without .tsv and .gz, is the source's.
    source, _, _ = path.name.partition(".")
    network = collected.network(source or "triples", "other")
    return network if isinstance(parse, Table) else _named(network, names)


def _named(network: Network, names: Mapping[str, Sequence[str]]) -> Network:
    """Name nodes of RDF by their labels, or the last parts of their IRIs.

    Nodes of one name keep their IRIs; each is a sense of the name.
    """
    names_of = [names.get(iri) or [local_name(iri)] for iri in network.nodes]
    counts = Counter(network.nodes)
    counts.update(spelled[0] for spelled in names_of)
    nodes = []
    spellings = defaultdict[str, list[int]](list)
    for node, (iri, spelled) in enumerate(zip(network.nodes, names_of, strict=True)):
        nodes.append(spelled[0] if counts[spelled[0]] == 1 else iri)
        for text in dict.fromkeys(map(plain, spelled)):
            spellings[text].append(node)
    return replace(network, nodes=nodes, spellings=spellings)


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
        self.ids.append(head_id)
        self.ids.append(relation_id)
        self.ids.append(tail_id)
        self.weights.append(weight)

    def check_columns(self) -> None:
        """Check that a file without a header has head, relation and tail in this order.

        Raises:
            KnowledgeFileError: if the first triple may be a header, or if relations are also
                nodes, as in a recipe book.
        """
        remedy = "Put the line 'head', 'relation', 'tail' above the columns, in their order."
        ids = np.frombuffer(self.ids, np.int32).reshape(-1, 3)
        numbers_of_nodes = np.bincount(ids[:, ::2].ravel(), minlength=2)
        is_apart = (ids[:, 1] == 0).sum() == 1 and (numbers_of_nodes[:2] == 1).all()
        # In a file without any repeated relation, every line looks like a header.
        if len(ids) > len(self.relations) and is_apart:
            raise KnowledgeFileError(
                f"{self.path}: no other line has a name of the first line, so it may be a header; "
                f"expected triples, perhaps below head, relation, tail. {remedy}"
            )
        names_of_nodes = [name for name in self.relations if name in self.nodes]
        if 2 * len(names_of_nodes) > len(self.relations):
            example = names_of_nodes[0].decode()
            raise KnowledgeFileError(
                f"{self.path}: {len(names_of_nodes):,} of {len(self.relations):,} relations, such "
                f"as '{example}', are also heads or tails; expected head, relation, tail in this "
                f"order. {remedy} A recipe book is for `train-recipes --with`."
            )

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
