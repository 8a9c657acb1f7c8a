"""Read WordNet's database files: a folder with ``data.noun``, ``index.noun``, ``noun.exc`` and others.

Only nouns have spellings; verbs, adjectives and adverbs link nouns, as *bake* links *baker* and *bakery*.

Source: WordNet 3.0 manual, wndb(5) for the formats and senseidx(5) for the sense keys in ``cntlist.rev``.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.network import Network, plain, unique_edges

_PARTS = {"noun": "n", "verb": "v", "adj": "a", "adv": "r"}
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
"""Relations by pointer symbol; the rest are inverses, which would be duplicates, or say nothing about things."""
_RELATIONS = tuple(dict.fromkeys(_POINTERS.values()))
_SYMMETRIC = {_RELATIONS.index(name) for name in ("relatedForm", "antonym", "attribute", "similar")}
_FIELDS = [f"{number:02d}" for number in range(45)]
_MOST_OCCURRENCES = 10**9
"""More than any sense-tagged corpus has words; sums of counts stay exact."""
NEEDED = ("data.noun", "index.noun")


def read_wordnet(folder: Path) -> Network:
    """Read WordNet's database files; KnowledgeFileError if one is missing, cut, or names a missing offset."""
    for name in NEEDED:
        if not (folder / name).is_file():
            raise KnowledgeFileError(
                f"{folder / name} is not a file; expected a folder with WordNet's database files, {', '.join(NEEDED)} "
                "and others (Debian: package wordnet-base)."
            )
    reader = _Reader(folder)
    for part in _PARTS:
        reader.read_data(part)
    edges = reader.edges()
    senses = reader.read_index()
    spellings: dict[str, list[int]] = {}
    for lemma, nodes in senses.items():  # such as x-ray and x_ray
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
    def __init__(self, folder: Path):
        self.folder = folder
        self.places: dict[tuple[str, str], int] = {}
        self.lemmas: list[list[str]] = []
        self.glosses: list[str] = []
        self.fields: list[int] = []
        self.pointers: list[tuple[int, int, tuple[str, str], str, int]] = []

    def lines(self, name: str) -> Iterator[tuple[int, str]]:
        """Yield numbered lines below the licence, which begins with blanks; nothing if the file is missing."""
        path = self.folder / name
        if path.is_file():
            with path.open(encoding="utf-8", errors="replace") as file:
                for number, line in enumerate(file, 1):
                    if not line.startswith("  "):
                        yield number, line

    def fault(self, name: str, line: int, problem: str) -> KnowledgeFileError:
        return KnowledgeFileError(
            f"{self.folder / name}, line {line}: {problem}. The file is damaged or cut; install WordNet again."
        )

    def read_data(self, part: str) -> None:
        """Add the synsets of a part of speech, and their pointers to synsets that may come later."""
        name = f"data.{part}"
        for number, line in self.lines(name):
            synset, bar, gloss = line.partition("|")
            try:
                if not bar or not line.endswith("\n"):
                    raise IndexError
                fields = synset.split()
                end = 4 + 2 * int(fields[3], 16)
                words, field = fields[4:end:2], _FIELDS.index(fields[1])
                node = self.places.setdefault((_PARTS[part], fields[0]), len(self.lemmas))
                first, last = end + 1, end + 1 + 4 * int(fields[end])
                if last > len(fields) or node < len(self.lemmas) or not words:
                    raise IndexError
                for place in range(first, last, 4):
                    if fields[place] in _POINTERS:
                        target = (
                            "a" if fields[place + 2] == "s" else fields[place + 2],
                            fields[place + 1],
                        )
                        relation = _RELATIONS.index(_POINTERS[fields[place]])
                        self.pointers.append((node, relation, target, name, number))
            except (IndexError, ValueError):
                raise self.fault(
                    name, number, f"'{line.strip()[:60]}' is not a complete synset"
                ) from None
            self.lemmas.append([word.partition("(")[0].replace("_", " ") for word in words])
            self.glosses.append(gloss.partition('; "')[0].strip())  # without examples
            self.fields.append(field)

    def edges(self) -> Ids:
        """Return the pointers as edges, each symmetric relation in one direction."""
        parts = {part for part, _ in self.places}
        rows = []
        for head, relation, target, name, number in self.pointers:
            tail = self.places.get(target)
            if tail is None:
                if target[0] in parts:
                    raise self.fault(name, number, f"synset {target[1]}-{target[0]} does not exist")
                continue  # the folder lacks this part of speech
            rows.append(
                (tail, relation, head)
                if relation in _SYMMETRIC and tail < head
                else (head, relation, tail)
            )
        edges = np.array(rows, dtype=np.int64).reshape(-1, 3)
        return unique_edges(edges, np.ones(len(edges)), (len(self.places), len(_RELATIONS)))[0]

    def read_index(self) -> dict[str, list[int]]:
        """Return the noun senses of each lemma (with underscores), most frequent first."""
        senses, name, number = {}, "index.noun", 0
        for number, line in self.lines(name):
            try:
                lemma, _, count, *fields = line.split()
                offsets = fields[len(fields) - int(count) :]
                if (
                    not line.endswith("\n")
                    or len(fields) < int(count) + 3
                    or int(fields[0]) + 3 + int(count) != len(fields)
                ):
                    raise ValueError
            except ValueError:
                raise self.fault(
                    name, number, f"'{line.strip()[:60]}' is not a complete entry"
                ) from None
            for offset in offsets:
                if ("n", offset) not in self.places:
                    raise self.fault(
                        name, number, f"synset {offset} of '{lemma}' does not exist in data.noun"
                    )
            senses[lemma] = [self.places["n", offset] for offset in offsets]
        for (part, offset), node in self.places.items():
            for lemma in self.lemmas[node] if part == "n" else ():
                if lemma.lower().replace(" ", "_") not in senses:
                    raise self.fault(name, number + 1, f"no entry for '{lemma}' of synset {offset}")
        return senses

    def read_exceptions(self) -> dict[str, list[str]]:
        """Return irregular plurals with their singulars."""
        exceptions = {}
        for number, line in self.lines("noun.exc"):
            plural, *singulars = line.replace("_", " ").split() or [""]
            if not singulars:
                raise self.fault("noun.exc", number, f"'{plural}' has no base form")
            exceptions[plural] = singulars
        return exceptions

    def read_counts(self, senses: dict[str, list[int]]) -> dict[tuple[str, int], int]:
        """Return how often each sense occurs in sense-tagged text, from ``cntlist.rev`` if it is there."""
        counts = {}
        for number, line in self.lines("cntlist.rev"):
            try:
                key, sense, count = line.split()
                lemma, kind = key.split("%")
                nodes = senses.get(lemma, ()) if kind[0] == "1" else ()
                place, occurrences = int(sense) - 1, int(count)
                if place < 0 or not 0 <= occurrences <= _MOST_OCCURRENCES:
                    raise ValueError
                if place < len(nodes):  # Debian's file names a few senses of old versions
                    counts[plain(lemma), nodes[place]] = occurrences
            except (ValueError, IndexError):
                raise self.fault(
                    "cntlist.rev", number, f"'{line.strip()[:60]}' is not a sense with its count"
                ) from None
        return counts
