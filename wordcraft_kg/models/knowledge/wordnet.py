"""Read WordNet's database files, such as ``data.noun``, ``index.noun`` and ``noun.exc``.

Only nouns have spellings; verbs, adjectives and adverbs link nouns, as *bake* links *baker* and
*bakery*.

The page docs/outside-knowledge.md says where the files come from.

Source: WordNet 3.0 manual, wndb(5) for the formats and senseidx(5) for the sense keys in
``cntlist.rev``.
"""

from collections.abc import Iterator
from pathlib import Path

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
_FIELDS = [f"{number:02d}" for number in range(45)]
"""Numbers of the lexicographer files: broad fields, such as food or feeling."""
_MOST_OCCURRENCES = 10**9
"""More than any sense-tagged corpus has words; sums of counts stay exact."""
NEEDED = ("data.noun", "index.noun")
"""Files without which a folder is refused; the others add verbs, irregular plurals and counts."""


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
    reader = _Reader(folder)
    for part in _PARTS:
        reader.read_data(part)
    edges = reader.edges()
    senses = reader.read_index()
    spellings: dict[str, list[int]] = {}
    for lemma, nodes in senses.items():
        # Several lemmas may have one plain spelling, such as x-ray and x_ray.
        before = spellings.setdefault(plain(lemma), [])
        before += [node for node in nodes if node not in before]
    return Network(
        source="WordNet",
        prefix="wn",
        nodes=[f"{offset}-{part}" for part, offset in reader.places],
        relations=_RELATIONS,
        edges=edges,
        weights=np.ones(len(edges)),
        spellings=spellings,
        exceptions=reader.read_exceptions(),
        lemmas=reader.lemmas,
        glosses=reader.glosses,
        fields=reader.fields,
        counts=reader.read_counts(senses),
    )


class _Reader:
    """Synsets and pointers read so far; a synset is a node, by part of speech and offset."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.places: dict[tuple[str, str], int] = {}
        self.lemmas: list[list[str]] = []
        self.glosses: list[str] = []
        self.fields: list[int] = []
        self.pointers: list[tuple[int, int, tuple[str, str], str, int]] = []

    def lines(self, name: str) -> Iterator[tuple[int, str]]:
        """Yield numbered lines below the licence, which begins with blanks, if the file exists."""
        path = self.folder / name
        if path.is_file():
            with path.open(encoding="utf-8", errors="replace") as file:
                for number, line in enumerate(file, 1):
                    if not line.startswith("  "):
                        yield number, line

    def fault(self, name: str, line: int, problem: str) -> KnowledgeFileError:
        return KnowledgeFileError(
            f"{self.folder / name}, line {line}: {problem}. The file is damaged or cut; install "
            "WordNet again."
        )

    def no(self, name: str, line: int, text: str, expected: str) -> KnowledgeFileError:
        beginning = text.strip()[:60]
        return self.fault(name, line, f"'{beginning}' is not {expected}")

    def read_data(self, part: str) -> None:
        """Add the synsets of a part of speech, and pointers, also to synsets that come later.

        A line has offset, field, type, number of words (hexadecimal), words with ids, number of
        pointers, pointers of four columns each (symbol, offset, part of speech, words), and the
        gloss behind a bar.
        """
        name = f"data.{part}"
        for number, line in self.lines(name):
            synset, bar, gloss = line.partition("|")
            try:
                if not bar or not line.endswith("\n"):
                    raise IndexError
                columns = synset.split()
                offset, field, _, num_words, *_ = columns
                # A word and its id, for each word.
                end = 4 + 2 * int(num_words, 16)
                words = columns[4:end:2]
                field_number = _FIELDS.index(field)
                synset_key = (_PARTS[part], offset)
                node = self.places.setdefault(synset_key, len(self.lemmas))
                # Four columns for each pointer, behind their number.
                first = end + 1
                last = first + 4 * int(columns[end])
                # Cut lines lack columns; a repeated offset has an earlier node.
                is_cut = last > len(columns) or not words
                if is_cut or node < len(self.lemmas):
                    raise IndexError
                for place in range(first, last, 4):
                    symbol, target_offset, kind, _ = columns[place : place + 4]
                    if symbol in _POINTERS:
                        relation = _RELATIONS.index(_POINTERS[symbol])
                        # Satellite adjectives, s, lie in the file of adjectives.
                        target_part = "a" if kind == "s" else kind
                        target = (target_part, target_offset)
                        self.pointers.append((node, relation, target, name, number))
            except (IndexError, ValueError):
                raise self.no(name, number, line, "a complete synset") from None
            lemmas = []
            for word in words:
                # Some adjectives end with a mark for their position, such as (p).
                lemma, _, _ = word.partition("(")
                lemmas.append(lemma.replace("_", " "))
            # The definition without the examples, which begin with quotes.
            definition, _, _ = gloss.partition('; "')
            self.lemmas.append(lemmas)
            self.glosses.append(definition.strip())
            self.fields.append(field_number)

    def edges(self) -> Ids:
        """Return the pointers as edges, each symmetric relation in one direction."""
        parts = {part for part, _ in self.places}
        rows = []
        for head, relation, target, name, number in self.pointers:
            tail = self.places.get(target)
            if tail is None:
                part, offset = target
                if part in parts:
                    raise self.fault(name, number, f"synset {offset}-{part} does not exist")
                # The folder lacks this part of speech.
                continue
            if relation in _SYMMETRIC:
                head, tail = sorted((head, tail))
            rows.append((head, relation, tail))
        # Without pointers, the reshape makes three columns all the same.
        edges = np.array(rows, dtype=np.int64).reshape(-1, 3)
        # Weights do not matter: equal pointers are one edge of weight 1.
        weights = np.ones(len(edges))
        sizes = (len(self.places), len(_RELATIONS))
        distinct_edges, _ = unique_edges(edges, weights, sizes)
        return distinct_edges

    def read_index(self) -> dict[str, list[int]]:
        """Return the noun senses of each lemma (with underscores), most frequent first."""
        senses = {}
        name = "index.noun"
        number = 0
        for number, line in self.lines(name):
            try:
                # After the number of senses: number of pointer symbols, the symbols, numbers of
                # senses and of tagged senses, and an offset for each sense.
                lemma, _, count, *fields = line.split()
                num_senses = int(count)
                offsets = fields[len(fields) - num_senses :]
                # All of them but the symbols are counted by `num_senses` and these three numbers.
                num_counted = 3 + num_senses
                is_cut = not line.endswith("\n") or len(fields) < num_counted
                if is_cut or int(fields[0]) + num_counted != len(fields):
                    raise ValueError
            except ValueError:
                raise self.no(name, number, line, "a complete entry") from None
            for offset in offsets:
                if ("n", offset) not in self.places:
                    raise self.fault(
                        name, number, f"synset {offset} of '{lemma}' does not exist in data.noun"
                    )
            senses[lemma] = [self.places["n", offset] for offset in offsets]
        # An index that was cut between two lines would hide nouns without an error.
        for (part, offset), node in self.places.items():
            if part != "n":
                continue
            for lemma in self.lemmas[node]:
                spelled = lemma.lower().replace(" ", "_")
                if spelled not in senses:
                    problem = f"no entry for '{lemma}' of synset {offset}"
                    raise self.fault(name, number + 1, problem)
        return senses

    def read_exceptions(self) -> dict[str, list[str]]:
        """Return irregular plurals with their singulars."""
        exceptions = {}
        for number, line in self.lines("noun.exc"):
            # A blank line is a plural without letters: refused below, with its number.
            plural, *singulars = line.replace("_", " ").split() or [""]
            if not singulars:
                raise self.fault("noun.exc", number, f"'{plural}' has no base form")
            exceptions[plural] = singulars
        return exceptions

    def read_counts(self, senses: dict[str, list[int]]) -> dict[tuple[str, int], int]:
        """Return counts of noun senses in sense-tagged text; empty without ``cntlist.rev``."""
        counts = {}
        name = "cntlist.rev"
        for number, line in self.lines(name):
            try:
                key, sense, count = line.split()
                lemma, kind = key.split("%")
                # A sense key begins with the part of speech: 1 for nouns.
                is_noun = kind[0] == "1"
                place = int(sense) - 1
                occurrences = int(count)
                if place < 0 or not 0 <= occurrences <= _MOST_OCCURRENCES:
                    raise ValueError
                nodes = senses.get(lemma, [])
                # Debian's file names a few senses of old versions, which are skipped.
                if is_noun and place < len(nodes):
                    counts[plain(lemma), nodes[place]] = occurrences
            except (ValueError, IndexError):
                raise self.no(name, number, line, "a sense with its count") from None
        return counts
