"""Recipe books with spoilt bytes, spoilt structure, and such as are sound but odd."""

import csv
import io
import json
import random
from functools import cache

from wordcraft_kg.graphs import SPLITS, open_book
from wordcraft_kg.graphs.book_files.words import CSV_HEADER
from wordcraft_kg.graphs.export import EXPORTERS

from .harness import IN, Trial
from .spoiling import ODD_LABELS, as_json, spoilt_bytes, spoilt_lines, spoilt_value

MAX_BYTES = 10_000_000
ENDINGS = {".csv": ",", ".tsv": "\t", ".json": ""}


def trial(number, home, sandbox):
    """Write a book into the sandbox and choose what is done with it."""
    rng = random.Random(f"books {number}")
    ending = rng.choice((".csv", ".csv", ".tsv", ".json", ".json"))
    rows, oddities = _rows(rng)
    what, data = _spoilt(_written(rows, ending, rng), ending, rng)
    if rng.random() < 0.02:
        ending = rng.choice((".txt", "", ".CSV", ".Json", ".tab"))
    (sandbox / IN).mkdir()
    (sandbox / IN / f"book{ending}").write_bytes(data)
    return Trial(
        f"{ending} of {len(rows)} recipes; {oddities}; {what}", _commands(f"{IN}/book{ending}", rng)
    )


def _commands(book, rng):
    build = ["build-graph", book, "--out", "out-graph", "--quiet"]
    if rng.random() < 0.6:
        build += ["--split", rng.choice(list(SPLITS)), f"--seed={rng.randrange(9)}"]
    if rng.random() < 0.3:
        build += [
            f"--train-ratio={rng.choice((0.01, 0.5, 0.99))}",
            f"--valid-ratio={rng.choice((0.0, 0.005, 0.3))}",
        ]
    if rng.random() < 0.2:
        build.append(f"--base={rng.choice(('water', 'water,flour', 'é', '?'))}")
    if rng.random() < 0.2:
        build.append("--keep-self-results")
    json_too = ("--json",) * (rng.random() < 0.5)
    exports = (
        ("export", book, "--format", kind, "--out", f"out-{kind}")
        for kind in rng.sample(list(EXPORTERS), 2)
    )
    return (
        ("check-book", book, *json_too),
        (*build, *json_too),
        *exports,
        ("describe", "out-graph", *json_too),
    )


def _rows(rng):
    """Return some recipes, in most cases with odd labels among them."""
    rows = [tuple(recipe) for recipe in _kitchen().recipes]
    rows = rng.sample(rows, rng.choice((1, 2, 5, 20, 60, len(rows))))
    oddities = []
    for _ in range(rng.choice((0, 0, 1, 3))):
        kind = rng.choice(("label", "self", "twice", "turned", "loop", "chain"))
        at = rng.randrange(len(rows))
        a, b, result = rows[at]
        if kind == "label":
            known, odd = rng.choice((a, b, result)), rng.choice(ODD_LABELS)
            rows = [tuple(odd if label == known else label for label in row) for row in rows]  # type: ignore[misc]
            kind = f"{odd[:20]!r}"
        elif kind == "chain":
            rows += [
                (f"link {i}", f"link {i}", f"link {i + 1}") for i in range(rng.choice((3, 300)))
            ]
        else:
            new = {
                "self": (a, b, a),
                "twice": (a, b, result),
                "turned": (b, a, result),
                "loop": (result, result, a),
            }
            rows.append(new[kind])
        oddities.append(kind)
    return rows, " ".join(oddities) or "sound"


@cache
def _kitchen():
    return open_book("kitchen")


def _written(rows, ending, rng):
    """Return a book as text, or as the value of a JSON file in one of its two layouts."""
    labels = sorted({label for row in rows for label in row})
    if ending != ".json":
        buffer = io.StringIO()
        writer = csv.writer(
            buffer, delimiter=ENDINGS[ending], lineterminator=rng.choice(("\n", "\n", "\r\n"))
        )
        writer.writerows([CSV_HEADER, *rows])
        head = f"# base: {','.join(rng.sample(labels, min(3, len(labels))))}\n" * (
            rng.random() < 0.3
        )
        return head + buffer.getvalue()
    if rng.random() < 0.5:
        return {
            "entities": {
                label: {"recipes": [row[:2] for row in rows if row[2] == label]} for label in labels
            }
        }
    base = rng.choice((None, [], labels[:3], labels))
    return {
        "format": "wordcraft-kg recipe book 1",
        "name": "x",
        "base": base,
        "entities": labels,
        "recipes": rows,
    }


def _spoilt(book, ending, rng):
    done = []
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        what, book = spoilt_value(book, rng) if ending == ".json" else spoilt_lines(book, rng)
        done.append(what)
    data = as_json(book) if ending == ".json" else book.encode("utf-8", "surrogatepass")
    if rng.random() < 0.35:
        what, data = spoilt_bytes(data, rng)
        done.append(what)
    elif ending == ".json" and rng.random() < 0.1:
        data = json.dumps(book).encode()  # surrogates as escapes
        done.append("escaped")
    return "; ".join(done) or "as it is", data[:MAX_BYTES]
