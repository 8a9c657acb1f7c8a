"""Parse a line of a file of triples: a row of a table, or a statement of RDF (N-Triples).

Nothing is guessed beyond the separator: columns stand in the order of a header, or are head,
relation, tail and perhaps a weight. A line that does not fit raises a ValueError.

The page docs/outside-knowledge.md describes the formats.
"""

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple
from urllib.parse import unquote

from wordcraft_kg.graphs.export import NAMESPACE

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


class Triple(NamedTuple):
    """An edge, with names in UTF-8 for the memory."""

    head: bytes
    relation: bytes
    tail: bytes
    weight: float


class Name(NamedTuple):
    """A name of a node, such as its label in RDF."""

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
    if subject.startswith(f"{NAMESPACE}recipe:"):
        return None
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
