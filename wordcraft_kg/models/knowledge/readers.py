"""Read general graphs: ConceptNet assertions, tables of triples, and WordNet's database files.

Assertions and triples are read line by line, plain or gzipped. Memory holds nodes and edges, about
150 bytes for a new node and 30 for an edge, never the lines.

Of WordNet, only nouns have spellings; verbs, adjectives and adverbs link nouns, as *bake* links
*baker* and *bakery*.

The page docs/outside-knowledge.md describes the formats, and says where the files come from.

Source: WordNet 3.0 manual, wndb(5).
"""

import csv
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
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


_Edge = tuple[bytes, bytes, bytes, float]
"""Names of head, relation and tail, and a positive weight."""


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
        yield head, relation, tail, weight


def _network(path: Path, source: str, prefix: str, lines: Iterable[_Edge]) -> Network:
    """Return edges as a network; w, the sum of an edge's weights, becomes log(1 + w).

    Args:
        path: the file, for errors.
        source: name of the network, for reports and errors.
        prefix: beginning of the names of nodes and relations, such as ``wn``.
        lines: an edge of each line; nodes and relations are numbered in this order.

    Raises:
        KnowledgeFileError: if the file has no triple to use, or is not UTF-8.
    """
    numbers: dict[bytes, int] = {}
    relation_numbers: dict[bytes, int] = {}
    # C numbers of 32 bits, for the memory that the module promises.
    ids = array("i")
    sums = array("f")
    for head, relation, tail, weight in lines:
        # A new name gets the next number.
        ids.append(numbers.setdefault(head, len(numbers)))
        ids.append(relation_numbers.setdefault(relation, len(relation_numbers)))
        ids.append(numbers.setdefault(tail, len(numbers)))
        sums.append(weight)
    if not ids:
        raise KnowledgeFileError(f"{path} has no triple to use; expected {source}'s triples.")
    try:
        nodes = [name.decode() for name in numbers]
        relations = [name.decode() for name in relation_numbers]
    except UnicodeDecodeError as error:
        raise KnowledgeFileError(
            f"{path} is not UTF-8: {error.object[:80]!r}. Save it as UTF-8."
        ) from None
    # The names as bytes are no longer needed.
    numbers.clear()
    # Three numbers for each edge, one after another: head, relation and tail.
    edges, weights = unique_edges(
        np.frombuffer(ids, np.int32).reshape(-1, 3).astype(np.int64),
        np.frombuffer(sums, np.float32).astype(np.float64),
        (len(nodes), len(relations)),
    )
    spellings: dict[str, tuple[int, ...]] = {}
    for node, name in enumerate(nodes):
        # ConceptNet's names are folded already, which :func:`plain` would do again for millions.
        is_folded = prefix == "cn"
        text = name.replace("_", " ").replace("'", "") if is_folded else plain(name)
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
_SYMMETRIC_POINTERS = {
    _RELATIONS.index(name) for name in ("relatedForm", "antonym", "attribute", "similar")
}
NEEDED = ("data.noun", "index.noun")
"""Files without which a folder is refused; the others add verbs and irregular plurals."""
_Key = tuple[str, str]
"""Part of speech and offset, which name a synset."""
T = TypeVar("T")


class _Synset(NamedTuple):
    """A line of a data file; a synset is a node.

    Attributes:
        offset: the name of the synset among those of its part of speech.
        lemmas: its names.
        gloss: its definition without examples.
        pointers: relation ids and targets.
    """

    offset: str
    lemmas: list[str]
    gloss: str
    pointers: list[tuple[int, _Key]]


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
                f"{', '.join(NEEDED)} and others (Debian: package wordnet-base)."
            )
    synsets: dict[_Key, _Synset] = {}
    for part, letter in _PARTS.items():
        for synset in _parsed(folder / f"data.{part}", _synset, "a complete synset"):
            synsets[letter, synset.offset] = synset
    edges = _edges(folder, synsets)
    # Several lemmas may have one plain spelling, such as x-ray and x_ray.
    spellings = defaultdict[str, dict[int, None]](dict)
    for lemma, senses in _senses(folder / "index.noun", synsets).items():
        spellings[plain(lemma)] |= dict.fromkeys(senses)
    plurals = _parsed(folder / "noun.exc", _exception, "a plural that has a base form")
    return Network(
        source="WordNet",
        prefix="wn",
        nodes=[f"{offset}-{letter}" for letter, offset in synsets],
        relations=_RELATIONS,
        edges=edges,
        weights=np.ones(len(edges)),
        spellings={text: list(senses) for text, senses in spellings.items()},
        exceptions=dict(plurals),
        lemmas=[synset.lemmas for synset in synsets.values()],
        glosses=[synset.gloss for synset in synsets.values()],
    )


def _edges(folder: Path, synsets: Mapping[_Key, _Synset]) -> Ids:
    """Return the pointers as edges, each symmetric relation in one direction."""
    letters = {letter for letter, _ in synsets}
    nodes = {key: node for node, key in enumerate(synsets)}
    rows = []
    for node, synset in enumerate(synsets.values()):
        for relation, target in synset.pointers:
            letter, offset = target
            if target in nodes:
                ends = (node, nodes[target])
                head, tail = sorted(ends) if relation in _SYMMETRIC_POINTERS else ends
                rows.append((head, relation, tail))
            # Otherwise the folder lacks this part of speech.
            elif letter in letters:
                raise _damage(folder, f"synset {offset}-{letter} does not exist")
    # Without pointers, the reshape makes three columns all the same.
    edges = np.array(rows, dtype=np.int64).reshape(-1, 3)
    # Weights do not matter: equal pointers are one edge of weight 1.
    distinct, _ = unique_edges(edges, np.ones(len(edges)), (len(nodes), len(_RELATIONS)))
    return distinct


def _senses(path: Path, synsets: Mapping[_Key, _Synset]) -> dict[str, list[int]]:
    """Return the noun senses of each lemma (with underscores), most frequent first."""
    node_of = {offset: node for node, (letter, offset) in enumerate(synsets) if letter == "n"}
    senses = {}
    for lemma, offsets in _parsed(path, _entry, "a complete entry"):
        for offset in offsets:
            if offset not in node_of:
                raise _damage(path, f"synset {offset} of '{lemma}' does not exist in data.noun")
        senses[lemma] = [node_of[offset] for offset in offsets]
    # An index that was cut between two lines would hide nouns without an error.
    for (letter, offset), synset in synsets.items():
        for lemma in synset.lemmas if letter == "n" else ():
            if lemma.lower().replace(" ", "_") not in senses:
                raise _damage(path, f"no entry for '{lemma}' of synset {offset}")
    return senses


# --- lines --------------------------------------------------------------------------------------


def _parsed(path: Path, parse: Callable[[str], T], expected: str) -> Iterator[T]:
    """Yield the content of each line below the licence, which begins with blanks.

    Args:
        path: a file of WordNet's folder; one that does not exist has no lines.
        parse: parses a line, or raises an IndexError or ValueError.
        expected: what a line is, for the error.
    """
    if not path.is_file():
        return
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
    columns = synset.split()
    offset, _, _, num_words, *_ = columns
    # A word and its id, for each word; four columns for each pointer, behind their number.
    end = 4 + 2 * int(num_words, 16)
    words = columns[4:end:2]
    first = end + 1
    last = first + 4 * int(columns[end])
    # Cut lines lack columns or the end of the line.
    if not bar or not line.endswith("\n") or not words or last > len(columns):
        raise ValueError
    pointers = []
    for place in range(first, last, 4):
        symbol, target, letter, _ = columns[place : place + 4]
        if symbol in _POINTERS:
            # Satellite adjectives, s, lie in the file of adjectives.
            key = ("a" if letter == "s" else letter, target)
            pointers.append((_RELATIONS.index(_POINTERS[symbol]), key))
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
    lemma, _, count, *fields = line.split()
    num_senses = int(count)
    # All fields but the symbols are counted by `num_senses` and these three numbers.
    if not line.endswith("\n") or len(fields) != int(fields[0]) + 3 + num_senses:
        raise ValueError
    return lemma, fields[len(fields) - num_senses :]


def _exception(line: str) -> tuple[str, list[str]]:
    """Parse an irregular plural with its singulars."""
    plural, *singulars = line.replace("_", " ").split()
    if not singulars:
        raise ValueError
    return plural, singulars
