"""Archives and compressed files whose bytes were spoilt: each reader refuses them by an error of the
package, or reads them."""

import gzip
import io
import json
import random
import struct
import tempfile
import traceback
import zipfile
from pathlib import Path

from .spoiling import spoilt_bytes

CELLS = tuple(f"runs/{number:016x}.json" for number in range(3))
BOOK = "ingredient_a,ingredient_b,result\n" + "".join(
    f"a{number},b{number},c{number}\n" for number in range(60)
)
GLOVE = "".join(f"{word} {number}.5 -1 2e-1\n" for number, word in enumerate(("sea", "iron") * 40))
TRIPLES = "flour\tmakes\tdough\t2\nwater\tmakes\tdough\n" * 30
ASSERTIONS = "".join(
    f'/a/x{number}\t/r/IsA\t/c/en/bread/n\t/c/en/food{number}\t{{"weight": 2.0}}\n'
    for number in range(30)
)
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)


def _zipped(names, rng, content):
    buffer = io.BytesIO()
    method = rng.choice((zipfile.ZIP_DEFLATED, *METHODS))
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name in names:
            archive.writestr(name, content)
    return buffer.getvalue()


def _read_submission(path):
    from wordcraft_kg.apps.text_agents.submission import read_submission_file

    for name in ("submission.json", "games.jsonl"):
        read_submission_file(path, name)


def _read_book(path):
    from wordcraft_kg.graphs.book_files import read_book

    read_book(path)


def _read_vectors(path):
    from wordcraft_kg.models.scorers.features import make_features

    make_features(str(path), ["sea", "iron"])


def _read_triples(path):
    from wordcraft_kg.models.knowledge.readers import read_triples

    read_triples(path)


def _read_conceptnet(path):
    from wordcraft_kg.models.knowledge.readers import read_conceptnet

    read_conceptnet(path)


READERS = {
    "submission.zip": (_read_submission, ("submission.json", "games.jsonl"), "{}\n" * 50),
    "book.zip": (_read_book, ("book.csv",), BOOK),
    "recipes.zip": (
        _read_book,
        tuple(f"data/x/recipes/{number}.json" for number in range(3)),
        json.dumps({"type": "minecraft:crafting_shapeless", "ingredients": [{"item": "x:a"}]}),
    ),
    "book.csv.gz": (_read_book, None, BOOK),
    "vectors.txt.gz": (_read_vectors, None, GLOVE),
    "triples.tsv.gz": (_read_triples, None, TRIPLES),
    "conceptnet.csv.gz": (_read_conceptnet, None, ASSERTIONS),
}
"""By file name: a reader, names of members (None for gzip), and the content of each."""
_NUMBERS = (0, 1, 2, 0x41, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1)


def _with_field(data, rng):
    """Change two or four bytes of a header, where sizes, places, flags and methods are."""
    signatures = (b"PK\1\2", b"PK\3\4", b"PK\5\6", b"\x1f\x8b")
    starts = [
        at for mark in signatures for at in range(len(data)) if data[at : at + len(mark)] == mark
    ]
    changed = bytearray(data + bytes(8))
    at = rng.choice(starts or [0]) + rng.randrange(2, 50)
    form = rng.choice(("<H", "<I"))
    if at + struct.calcsize(form) <= len(data):
        limit = 2 ** (8 * struct.calcsize(form))
        struct.pack_into(form, changed, at, rng.choice((*_NUMBERS, rng.randrange(limit))) % limit)
    return f"a field at {at}", bytes(changed[: len(data)])


def problems_of_archive(number):
    """Spoil an archive, give it to its reader, and return what is wrong, if anything."""
    from wordcraft_kg.base.errors import WordCraftKGError

    rng = random.Random(f"archives {number}")
    name = list(READERS)[number % len(READERS)]
    read, members, content = READERS[name]
    if members is None:
        data = gzip.compress(content.encode(), mtime=0)
    else:
        data = _zipped(members, rng, content)
    done = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        spoil = rng.choice((_with_field, _with_field, spoilt_bytes))
        what, data = spoil(data, rng)
        done.append(what)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        try:
            read(path)
        except WordCraftKGError:
            return []
        except Exception:
            return [f"archives:{number}: {name}, {done}: {traceback.format_exc(limit=-6)}"]
    return []
