"""Read general graphs: ConceptNet assertions, tables of triples, and WordNet's database files.

Assertions and triples are read line by line, plain or gzipped. Memory holds nodes and edges, up to
300 bytes for a new node and 150 for an edge, never the lines.

Of WordNet, only nouns have spellings; verbs, adjectives and adverbs link nouns, as *bake* links
*baker* and *bakery*.

The page docs/outside-knowledge.md describes the formats, and says where the files come from.

Source: WordNet 3.0 manual, wndb(5).
"""

import csv
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar

import msgspec
import numpy as np

from wordcraft_kg.base.artefacts import read_lines
from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.graphs.arrays import Ids
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
_ENGLISH = b"/c/en/"
_USELESS = (b"/r/ExternalURL", b"/r/FormOf", b"/r/Etymologically", b"/r/dbpedia/")
"""Beginnings of the names of relations about words or web pages, not about things."""
_SYMMETRIC_ASSERTIONS = {
    "Antonym",
    "DistinctFrom",
    "LocatedNear",
    "RelatedTo",
    "SimilarTo",
    "Synonym",
}
"""Relations whose edges are stored in one direction, so that two assertions are not two edges."""
_Edge = tuple[str, str, str, float]
"""Names of head, relation and tail, and a positive weight."""
_NUMBERED = np.dtype([("ids", np.int64, 3), ("weight", np.float32)])
"""Ids of head, relation and tail, and the weight of a line."""


class _Assertion(msgspec.Struct):
    """The last column of an assertion, JSON with many more keys, which are skipped."""

    weight: Annotated[float, msgspec.Meta(lt=HEAVIEST)]


def read_conceptnet(path: Path) -> Network:
    """Read assertions about English words, whose senses are one node.

    Raises:
        KnowledgeFileError: if the file cannot be read, has no English assertion, or has a wrong
            line (the error names the line).
    """
    return _network(path, "ConceptNet", "cn", _assertions(path))


def _assertions(path: Path) -> Iterator[_Edge]:
    decode = msgspec.json.Decoder(_Assertion).decode
    for number, line in read_lines(path, KnowledgeFileError):
        if line.isspace():
            continue
        try:
            _, relation, start, end, about = line.split(b"\t")
            # Before the JSON is decoded: most of the 34 million lines are about other languages.
            is_english = start.startswith(_ENGLISH) and end.startswith(_ENGLISH)
            if not is_english or relation.startswith(_USELESS):
                continue
            weight = decode(about).weight
            name = relation.decode().removeprefix("/r/")
            # /c/en/word/n/sense: the word alone.
            head, tail = (uri.decode().split("/")[3] for uri in (start, end))
        except (ValueError, RecursionError, msgspec.DecodeError):
            raise _fault(
                path,
                number,
                line,
                "expected uri, relation, start, end, and JSON with a weight below "
                f"{HEAVIEST:g}, with tabs between them, in UTF-8",
            ) from None
        if name in _SYMMETRIC_ASSERTIONS:
            head, tail = sorted((head, tail))
        if weight > 0:
            yield head, name, tail, weight


def read_triples(path: Path) -> Network:
    """Read a table of triples: tabs between head, relation and tail, or a header with these names.

    A header may have the columns in any order, and a weight. Its columns are separated by tabs, or
    by commas with quotation marks where a cell holds a comma.

    Raises:
        KnowledgeFileError: if the file cannot be read, has no triple, or has a wrong line (the
            error names the line).
    """
    # The name of the file, without .tsv and .gz, is the source's.
    source, _, _ = path.name.partition(".")
    return _network(path, source or "triples", "other", _rows(path))


def _rows(path: Path) -> Iterator[_Edge]:
    header: list[str] = []
    has_tabs = False
    for number, line in read_lines(path, KnowledgeFileError):
        if line.isspace():
            continue
        try:
            text = line.decode()
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
            raise _fault(path, number, line, EXPECTED) from None
        yield by_name["head"], by_name["relation"], by_name["tail"], weight


def _fault(path: Path, number: int, line: bytes, expected: str) -> KnowledgeFileError:
    shown = line[:80].decode(errors="replace").strip()
    return KnowledgeFileError(
        f"{path}, line {number:,}: '{shown}'; {expected}. Restore a copy of the file, or correct "
        "the line."
    )


def _network(path: Path, source: str, prefix: str, lines: Iterator[_Edge]) -> Network:
    """Return edges as a network; w, the sum of an edge's weights, becomes log(1 + w).

    Args:
        path: the file, for errors.
        source: name of the network, for reports and errors.
        prefix: beginning of the names of nodes and relations, such as ``cn``.
        lines: an edge of each line; nodes and relations are numbered in this order.

    Raises:
        KnowledgeFileError: if the file has no triple to use.
    """
    if not path.is_file():
        raise KnowledgeFileError(
            f"{path} is not a file; expected a file of triples or assertions, plain or gzipped."
        )
    numbers: dict[str, int] = {}
    relation_numbers: dict[str, int] = {}

    def numbered() -> Iterator[tuple[tuple[int, int, int], float]]:
        for head_name, relation_name, tail_name, weight in lines:
            # A new name gets the next number.
            head = numbers.setdefault(head_name, len(numbers))
            relation = relation_numbers.setdefault(relation_name, len(relation_numbers))
            tail = numbers.setdefault(tail_name, len(numbers))
            yield (head, relation, tail), weight

    rows = np.fromiter(numbered(), _NUMBERED)
    if not len(rows):
        raise KnowledgeFileError(f"{path} has no triple to use; expected {source}'s triples.")
    sizes = (len(numbers), len(relation_numbers))
    edges, weights = unique_edges(rows["ids"], rows["weight"].astype(np.float64), sizes)
    nodes = [*numbers]
    relations = [*relation_numbers]
    # No longer needed: with millions of names, memory counts.
    numbers.clear()
    spellings: dict[str, tuple[int, ...]] = {}
    for node, name in enumerate(nodes):
        text = plain(name)
        spellings[text] = (*spellings.get(text, ()), node)
    return Network(source, prefix, nodes, relations, edges, np.log1p(weights), spellings)


# --- WordNet --------------------------------------------------------------------------------------

_PARTS = {"noun": "n", "verb": "v", "adj": "a", "adv": "r"}
"""Parts of speech by the ending of a file's name."""
_POINTERS = {
    "@": "isA",
    "@i": "isA",
    "#p": "partOf",
    "#s": "substanceOf",
    "#m": "memberOf",
    "+": "relatedForm",
    "!": "antonym",
    "=": "attribute",
    ";c": "topic",
    ";r": "region",
    "*": "entails",
    ">": "causes",
    "&": "similar",
    "\\": "pertainsTo",
}
"""Relations by pointer symbol.

The rest are inverses, which would be duplicates, or say nothing about things.
"""
_RELATIONS = tuple(dict.fromkeys(_POINTERS.values()))
_SYMMETRIC = {_RELATIONS.index(name) for name in ("relatedForm", "antonym", "attribute", "similar")}
"""Relations whose edges are stored in one direction, so that two pointers are not two edges."""
NEEDED = (*(f"data.{part}" for part in _PARTS), "index.noun", "noun.exc")
"""Files without which a folder is refused."""
T = TypeVar("T")


class _Synset(NamedTuple):
    """A line of a data file; a synset is a node.

    Attributes:
        offset: the name of the synset among those of its part of speech.
        lemmas: its names.
        gloss: its definition without examples.
        pointers: relation ids, and names of the target nodes.
    """

    offset: str
    lemmas: list[str]
    gloss: str
    pointers: list[tuple[int, str]]


def read_wordnet(folder: Path) -> Network:
    """Read WordNet's database files.

    Raises:
        KnowledgeFileError: if a needed file is missing, or a file is cut or names a synset that
            does not exist.
    """
    for name in NEEDED:
        if not (folder / name).is_file():
            raise KnowledgeFileError(
                f"{folder / name} is not a file; expected a folder with WordNet's database files, "
                f"{', '.join(NEEDED)} (Debian: package wordnet-base)."
            )
    # By the name of the node, which ends with the letter of the part of speech.
    synsets: dict[str, _Synset] = {}
    for part, letter in _PARTS.items():
        for synset in _parsed(folder / f"data.{part}", _synset, "a complete synset"):
            synsets[f"{synset.offset}-{letter}"] = synset
    numbers = {name: node for node, name in enumerate(synsets)}
    edges = _edges(folder, synsets, numbers)
    return Network(
        source="WordNet",
        prefix="wn",
        nodes=[*synsets],
        relations=_RELATIONS,
        edges=edges,
        weights=np.ones(len(edges)),
        spellings=_spellings(folder / "index.noun", synsets, numbers),
        exceptions=dict(_parsed(folder / "noun.exc", _exception, "a plural that has a base form")),
        lemmas=[synset.lemmas for synset in synsets.values()],
        glosses=[synset.gloss for synset in synsets.values()],
    )


def _edges(folder: Path, synsets: Mapping[str, _Synset], numbers: Mapping[str, int]) -> Ids:
    """Return the pointers as edges, each symmetric relation in one direction."""
    rows = []
    for node, synset in enumerate(synsets.values()):
        for relation, target in synset.pointers:
            if target not in numbers:
                raise _damage(folder, f"synset {target} does not exist")
            ends = (node, numbers[target])
            head, tail = sorted(ends) if relation in _SYMMETRIC else ends
            rows.append((head, relation, tail))
    # Without pointers, the reshape makes three columns all the same.
    edges = np.array(rows, dtype=np.int64).reshape(-1, 3)
    # Weights do not matter: equal pointers are one edge of weight 1.
    distinct, _ = unique_edges(edges, np.ones(len(edges)), (len(numbers), len(_RELATIONS)))
    return distinct


def _spellings(
    path: Path, synsets: Mapping[str, _Synset], numbers: Mapping[str, int]
) -> dict[str, list[int]]:
    """Return the noun senses of each :func:`plain` lemma, most frequent first."""
    # Several lemmas may have one plain spelling, such as x-ray and x_ray.
    spellings = defaultdict[str, dict[int, None]](dict)
    for lemma, offsets in _parsed(path, _entry, "a complete entry"):
        for offset in offsets:
            if f"{offset}-n" not in numbers:
                raise _damage(path, f"synset {offset} of '{lemma}' does not exist in data.noun")
            spellings[plain(lemma)][numbers[f"{offset}-n"]] = None
    # An index that was cut between two lines would hide nouns without an error.
    for name, synset in synsets.items():
        for lemma in synset.lemmas if name.endswith("-n") else ():
            if plain(lemma) not in spellings:
                raise _damage(path, f"no entry for '{lemma}' of synset {synset.offset}")
    return {text: list(senses) for text, senses in spellings.items()}


# --- lines --------------------------------------------------------------------------------------


def _parsed(path: Path, parse: Callable[[str], T], expected: str) -> Iterator[T]:
    """Yield the content of each line below the licence, which begins with blanks.

    Args:
        path: a file of WordNet's folder.
        parse: parses a line, or raises an IndexError or ValueError.
        expected: what a line is, for the error.
    """
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            if line.startswith("  "):
                continue
            try:
                yield parse(line)
            except (IndexError, ValueError):
                problem = f"line {number}: '{line.strip()[:60]}' is not {expected}"
                raise _damage(path, problem) from None


def _damage(path: Path, problem: str) -> KnowledgeFileError:
    return KnowledgeFileError(
        f"{path}, {problem}. The file is damaged or cut; install WordNet again."
    )


def _synset(line: str) -> _Synset:
    """Parse a line of a data file.

    It has offset, field, type, number of words (hexadecimal), words with ids, number of pointers,
    pointers of four columns each (symbol, offset, part of speech, words), and the gloss behind a
    bar.
    """
    synset, bar, gloss = line.partition("|")
    offset, _, _, num_words, *columns = synset.split()
    # A word and its id, for each word; four columns for each pointer, behind their number.
    end = 2 * int(num_words, 16)
    words = columns[:end:2]
    num_pointers, *targets = columns[end:]
    # Cut lines lack columns or the end of the line.
    if not bar or not line.endswith("\n") or not words or len(targets) < 4 * int(num_pointers):
        raise ValueError
    pointers = []
    for place in range(0, 4 * int(num_pointers), 4):
        symbol, target, letter, _ = targets[place : place + 4]
        if symbol in _POINTERS:
            # Satellite adjectives, s, lie in the file of adjectives.
            name = f"{target}-{letter.replace('s', 'a')}"
            pointers.append((_RELATIONS.index(_POINTERS[symbol]), name))
    # Some adjectives end with a mark for their position, such as (p).
    lemmas = [word.partition("(")[0].replace("_", " ") for word in words]
    # The definition without the examples, which begin with quotes.
    definition, _, _ = gloss.partition('; "')
    return _Synset(offset, lemmas, definition.strip(), pointers)


def _entry(line: str) -> tuple[str, list[str]]:
    """Parse a line of the index: a lemma and the offsets of its senses.

    After the number of senses it has the number of pointer symbols, the symbols, numbers of senses
    and of tagged senses, and an offset for each sense.
    """
    lemma, _, num_senses, num_symbols, *fields = line.split()
    offsets = fields[int(num_symbols) + 2 :]
    if not line.endswith("\n") or len(offsets) != int(num_senses):
        raise ValueError
    return lemma, offsets


def _exception(line: str) -> tuple[str, list[str]]:
    """Parse an irregular plural with its singulars."""
    plural, singular, *more = line.replace("_", " ").split()
    return plural, [singular, *more]
