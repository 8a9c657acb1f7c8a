"""Read WordNet's database files, such as ``data.noun``, ``index.noun`` and ``noun.exc``.

Only nouns have spellings; verbs, adjectives and adverbs link nouns, as *bake* links *baker* and
*bakery*.

The page docs/outside-knowledge.md says where the files come from.

Source: WordNet 3.0 manual, wndb(5).
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.network import Network, plain, unique_edges

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
    nodes: dict[_Key, int] = {}
    synsets: list[_Synset] = []
    # File and line of each synset, for errors.
    origins: list[tuple[str, int]] = []
    for part, letter in _PARTS.items():
        name = f"data.{part}"
        for number, synset in _parsed(folder, name, _synset, "a complete synset"):
            if nodes.setdefault((letter, synset.offset), len(synsets)) < len(synsets):
                raise _fault(folder, name, number, f"synset {synset.offset} is repeated")
            synsets.append(synset)
            origins.append((name, number))
    edges = _edges(folder, nodes, synsets, origins)
    senses = _senses(folder, nodes, synsets)
    spellings: dict[str, list[int]] = {}
    for lemma, senses_of_lemma in senses.items():
        # Several lemmas may have one plain spelling, such as x-ray and x_ray.
        spelled = spellings.setdefault(plain(lemma), [])
        spelled += [node for node in senses_of_lemma if node not in spelled]
    plurals = _parsed(folder, "noun.exc", _exception, "a plural that has a base form")
    return Network(
        source="WordNet",
        prefix="wn",
        nodes=[f"{offset}-{letter}" for letter, offset in nodes],
        relations=_RELATIONS,
        edges=edges,
        weights=np.ones(len(edges)),
        spellings=spellings,
        exceptions={plural: singulars for _, (plural, singulars) in plurals},
        lemmas=[synset.lemmas for synset in synsets],
        glosses=[synset.gloss for synset in synsets],
    )


def _edges(
    folder: Path,
    nodes: dict[_Key, int],
    synsets: Sequence[_Synset],
    origins: Sequence[tuple[str, int]],
) -> Ids:
    """Return the pointers as edges, each symmetric relation in one direction."""
    letters = {letter for letter, _ in nodes}
    rows = []
    for node, synset in enumerate(synsets):
        for relation, target in synset.pointers:
            if target in nodes:
                ends = (node, nodes[target])
                head, tail = sorted(ends) if relation in _SYMMETRIC else ends
                rows.append((head, relation, tail))
                continue
            letter, offset = target
            # Otherwise the folder lacks this part of speech.
            if letter in letters:
                problem = f"synset {offset}-{letter} does not exist"
                raise _fault(folder, *origins[node], problem)
    # Without pointers, the reshape makes three columns all the same.
    edges = np.array(rows, dtype=np.int64).reshape(-1, 3)
    # Weights do not matter: equal pointers are one edge of weight 1.
    distinct, _ = unique_edges(edges, np.ones(len(edges)), (len(nodes), len(_RELATIONS)))
    return distinct


def _senses(
    folder: Path,
    nodes: dict[_Key, int],
    synsets: Sequence[_Synset],
) -> dict[str, list[int]]:
    """Return the noun senses of each lemma (with underscores), most frequent first."""
    name = "index.noun"
    senses = {}
    number = 0
    for number, (lemma, offsets) in _parsed(folder, name, _entry, "a complete entry"):
        for offset in offsets:
            if ("n", offset) not in nodes:
                problem = f"synset {offset} of '{lemma}' does not exist in data.noun"
                raise _fault(folder, name, number, problem)
        senses[lemma] = [nodes["n", offset] for offset in offsets]
    # An index that was cut between two lines would hide nouns without an error.
    for (letter, offset), node in nodes.items():
        for lemma in synsets[node].lemmas if letter == "n" else ():
            if lemma.lower().replace(" ", "_") not in senses:
                problem = f"no entry for '{lemma}' of synset {offset}"
                raise _fault(folder, name, number + 1, problem)
    return senses


# --- lines ----------------------------------------------------------------------------------------


def _parsed(
    folder: Path, name: str, parse: Callable[[str], T], expected: str
) -> Iterator[tuple[int, T]]:
    """Yield number and content of each line below the licence, which begins with blanks.

    Args:
        folder: WordNet's folder.
        name: name of the file; a file that does not exist has no lines.
        parse: parses a line, or raises an IndexError or ValueError.
        expected: what a line is, for the error.
    """
    path = folder / name
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            if line.startswith("  "):
                continue
            try:
                content = parse(line)
            except (IndexError, ValueError):
                problem = f"'{line.strip()[:60]}' is not {expected}"
                raise _fault(folder, name, number, problem) from None
            yield number, content


def _fault(folder: Path, name: str, line: int, problem: str) -> KnowledgeFileError:
    return KnowledgeFileError(
        f"{folder / name}, line {line}: {problem}. The file is damaged or cut; install WordNet "
        "again."
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
    is_whole = len(fields) == int(fields[0]) + 3 + num_senses
    if not line.endswith("\n") or not is_whole:
        raise ValueError
    return lemma, fields[len(fields) - num_senses :]


def _exception(line: str) -> tuple[str, list[str]]:
    """Parse an irregular plural with its singulars."""
    plural, *singulars = line.replace("_", " ").split()
    if not singulars:
        raise ValueError
    return plural, singulars
