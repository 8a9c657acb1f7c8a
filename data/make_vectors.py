"""Write the built-in vectors of all-MiniLM-L6-v2 for the labels of the built-in books.

    python data/make_vectors.py ENCODER [--check]

ENCODER is the folder of sentence-transformers/all-MiniLM-L6-v2 (Apache-2.0). With ``--check``
nothing is written, and the exit code is 1 if something would be.
"""

import sys
from pathlib import Path

import numpy as np

from wordcraft_kg.apps.elicitation.encoder import encode_labels, vector_files
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs.library import known_books, open_book
from wordcraft_kg.models.scorers.features import BUILT_IN, ENCODED

WEIGHTS = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
"""SHA-256 hash of ``model.safetensors``."""


def main(encoder: str, is_check: bool) -> int:
    """Make the vectors; return the exit code."""
    books = [open_book(book.name) for book in known_books() if book.origin == "built in"]
    labels = sorted({label for book in books for label in book.entities})
    vectors, hashes = encode_labels(labels, Path(encoder))
    if hashes.get("model.safetensors") != WEIGHTS:
        sys.exit(
            f"'{encoder}' has other weights: {hashes}; expected model.safetensors with SHA-256 "
            f"{WEIGHTS}"
        )
    files = vector_files(labels, vectors)
    if not is_check:
        for name, content in files.items():
            write_atomically(BUILT_IN.parent / name, content)
        print(f"wrote {len(labels):,} vectors, {sum(map(len, files.values())):,} bytes")
        return 0
    del files[ENCODED]  # another processor rounds the last bits differently
    is_equal = all(
        (BUILT_IN.parent / name).read_bytes() == content for name, content in files.items()
    )
    is_equal = is_equal and np.allclose(np.load(BUILT_IN), vectors, rtol=0, atol=1e-3)
    print(
        "up to date"
        if is_equal
        else "the built-in vectors are not up to date; run data/make_vectors.py"
    )
    return 0 if is_equal else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], "--check" in sys.argv))
