"""Read ConceptNet assertions, and files of triples, line by line; plain or gzipped.

A line of triples is a row of a table or a statement of RDF (N-Triples). Nothing is guessed beyond
the separator: columns stand in the order of a header, or are head, relation, tail and perhaps a
weight.

Memory holds nodes and edges, about 150 bytes for a new node and 30 for an edge, never the lines.

The page docs/outside-knowledge.md describes the formats.
"""

import csv
import re
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple
from urllib.parse import unquote

import msgspec
import numpy as np

from wordcraft_kg.base.artefacts import read_lines
from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.models.knowledge.network import Network, plain, unique_edges

HEADER = ["head", "relation", "tail"]
"""Header of the files that the product writes."""
_ROLES = {
    "head": 0,
    "subject": 0,
    "source": 0,
    "relation": 1,
    "predicate": 1,
    "tail": 2,
    "object": 2,
    "target": 2,
    "weight": 3,
}
"""Words of a header, by the place of their column in a triple."""
_SEPARATORS = ",;|"
"""Separators of columns in a file without tabs."""
HEAVIEST = 1e30
"""Weights are below: sums must fit into 32-bit numbers."""
EXPECTED = (
    "expected head, relation, tail and perhaps a positive weight, separated by tabs, commas, "
    "semicolons or |, or N-Triples, in UTF-8. `wordcraft-kg export --format tsv` and "
    "DataFrame.to_csv of pandas write such a table, Graph.serialize(format='nt') of rdflib "
    "N-Triples"
)
_ESCAPE = r"""\\[tbnrf"'\\]|\\u[0-9A-Fa-f]{4}|\\U[0-9A-Fa-f]{8}"""
_STATEMENT = re.compile(
    r"\s*(?:<([^<>\s]+)>|(_:\S+))"  # subject: an IRI or a blank node
    r"\s+<([^<>\s]+)>"  # predicate
    r'\s+(?:<([^<>\s]+)>|(_:\S+)|"((?:[^"\\]|'
    + _ESCAPE
    + r')*)"(?:@[\w-]+|\^\^<[^<>\s]*>)?)'  # object
    r"\s*\.\s*(?:#.*)?"
)
_NAMING = {"label", "prefLabel", "altLabel", "name"}
"""Predicates (RDFS, SKOS, schema.org and others) whose object is a name of the subject."""


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
        self.ids.extend((head_id, relation_id, tail_id))
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


# --- a line of a file of triples ------------------------------------------------------------------


class Triple(NamedTuple):
    """An edge, with names in UTF-8 for the memory.

    Attributes:
        head: name of a node.
        relation: name of a relation.
        tail: name of a node.
        weight: positive weight.
    """

    head: bytes
    relation: bytes
    tail: bytes
    weight: float


class Name(NamedTuple):
    """A name of a node, such as its label in RDF.

    Attributes:
        node: the node.
        text: its name.
    """

    node: str
    text: str


Parser = Callable[[str], Triple | Name | None]
"""Parses a line; None for a line without content, such as a header or a comment."""


@dataclass(frozen=True)
class Table:
    """The columns of a table.

    Attributes:
        separator: character between columns.
        is_quoted: whether quotation marks enclose cells.
        places: places of head, relation, tail and perhaps a weight in a row; empty for the usual
            order.
        header: the line that names the columns; "" without one.
    """

    separator: str
    is_quoted: bool
    places: tuple[int, ...] = ()
    header: str = ""

    def __call__(self, line: str) -> Triple | None:
        """Parse a row; None for the header."""
        if line == self.header:
            return None
        cells = self.cells(line)
        if self.places and len(cells) != len(self.places):
            raise ValueError(f"expected {len(self.places)} columns, as in the header")
        if self.places:
            cells = [cells[place] for place in self.places]
        if len(cells) not in (3, 4) or not all(cells):
            raise ValueError(EXPECTED)
        head, relation, tail = (cell.encode() for cell in cells[:3])
        weight = _weight(cells[3]) if len(cells) == 4 else 1.0
        return Triple(head, relation, tail, weight)

    def cells(self, line: str) -> list[str]:
        """Split a line into cells with single blanks."""
        if self.is_quoted:
            (row,) = csv.reader([line], delimiter=self.separator, skipinitialspace=True)
        else:
            row = line.split(self.separator)
        return [" ".join(cell.split()) for cell in row]


def parser_of(line: str) -> Parser:
    """Choose the parser of a file by its first line that is not blank."""
    if line.lstrip().startswith(("<", "_:", "#")):
        return _statement
    if "\t" in line:
        # By the second cell: labels may begin with a quotation mark, relations do not.
        _, relation, *_ = line.split("\t")
        table = Table("\t", is_quoted=relation.startswith('"'))
    else:
        tables = [Table(separator, is_quoted=True) for separator in _SEPARATORS]
        fitting = [table for table in tables if len(table.cells(line)) in (3, 4)]
        if len(fitting) != 1:
            raise ValueError(EXPECTED)
        (table,) = fitting
    names = [cell.casefold() for cell in table.cells(line)]
    roles = [_ROLES[name] for name in names if name in _ROLES]
    if len(roles) < 2:
        return table
    is_whole = len(roles) == len(names) and sorted(roles) in ([0, 1, 2], [0, 1, 2, 3])
    if not is_whole:
        raise ValueError("expected the columns head, relation, tail and perhaps weight, no others")
    places = sorted(range(len(roles)), key=roles.__getitem__)
    if places == [0, 1, 2]:
        # In the usual order, a weight may follow without a name.
        places = []
    return Table(table.separator, table.is_quoted, tuple(places), line)


def _weight(text: str) -> float:
    """Return a weight, or raise a ValueError."""
    try:
        weight = float(text)
    except ValueError:
        weight = 0.0
    # Not a number fails both comparisons.
    if not 0 < weight < HEAVIEST:
        raise ValueError(EXPECTED)
    return weight


def _statement(line: str) -> Triple | Name | None:
    """Parse a statement in N-Triples.

    Literals that name nothing are left out, and so are the recipe nodes of our own export: their
    triples stand beside them.
    """
    if not line.strip() or line.lstrip().startswith("#"):
        return None
    match = _STATEMENT.fullmatch(line)
    if match is None:
        raise ValueError("expected a statement of N-Triples, such as <urn:a> <urn:b> <urn:c> .")
    subject_iri, subject_blank, predicate, object_iri, object_blank, literal = match.groups()
    subject = subject_iri or subject_blank
    relation = local_name(predicate)
    if literal is None:
        entity = object_iri or object_blank
        return Triple(subject.encode(), relation.encode(), entity.encode(), 1.0)
    if relation not in _NAMING:
        return None
    # The codec reads the escapes of N-Triples; characters that Latin-1 lacks become such escapes.
    text = literal.encode("latin-1", "backslashreplace").decode("unicode_escape")
    # Half a character from an escape such as \ud800 is no text.
    text.encode()
    return Name(subject, " ".join(text.split()))


def local_name(iri: str) -> str:
    """Return the last part of an IRI as text: Family_tree of http://example.org/Family_tree."""
    if iri.startswith("_:"):
        # A blank node has no name: its text means nothing outside the file.
        return iri
    separators = "[/#]" if re.search("[/#]", iri) else ":"
    *_, last = re.split(separators, iri.rstrip("/#:"))
    decoded = unquote(last)
    return " ".join(decoded.split()) or iri
