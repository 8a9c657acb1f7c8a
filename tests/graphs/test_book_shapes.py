"""Files as people have them: read as downloaded, or refused with what is missing."""

import re
from pathlib import Path

import pytest
from book_shapes import SHAPES

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import read_book
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.book_files import rows as words

ROOT = Path(__file__).parents[2]
READ = [shape for shape in SHAPES if not shape.says]
REFUSED = [shape for shape in SHAPES if shape.says]


def put(shape, folder):
    """Write a shape's files, and return the path of the book."""
    for name, data in shape.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder if len(shape.files) > 1 else folder / next(iter(shape.files))


def expected(rows):
    return {(tuple(sorted(set(parts))), result) for *parts, result in rows}


@pytest.mark.parametrize("shape", READ, ids=lambda shape: shape.name)
def test_a_shape_is_read_as_it_is_downloaded(tmp_path, shape):
    path = put(shape, tmp_path)
    book = read_book(path, **shape.options)
    assert expected(book.recipes) == expected(shape.rows)
    reading = book.reading
    assert reading.rows == reading.kept + sum(reading.left_out.values())
    assert reading.kept == len(shape.rows)
    assert reading.line().startswith(f"read as {reading.shape}")
    checked = check_book(path, **shape.options)
    assert checked.book.recipes == book.recipes
    assert checked.reading == reading


@pytest.mark.parametrize("shape", REFUSED, ids=lambda shape: shape.name)
def test_a_refusal_names_what_is_missing_and_the_guide(tmp_path, shape):
    path = put(shape, tmp_path)
    with pytest.raises(RecipeFileError, match=shape.says) as caught:
        read_book(path, **shape.options)
    assert "docs/your-file.md#" in str(caught.value)
    assert not check_book(path, **shape.options).passed


def test_at_least_42_shapes_are_read():
    assert len(READ) >= 42


def test_each_refusal_leads_to_a_section_of_the_guide():
    text = (Path(__file__).parents[2] / words.GUIDE).read_text()
    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert set(words.SHAPES) <= {heading.lower().replace(" ", "-") for heading in headings}


def examples_of_the_guide():
    """Yield the files that the guide shows: a block each, and a line each of JSON."""
    text = (ROOT / "docs" / "your-file.md").read_text(encoding="utf-8")
    for section in text.split("\n## ")[1:]:
        title = section.splitlines()[0]
        files = []
        for language, block in re.findall(r"```(\w*)\n(.*?)```", section, re.DOTALL):
            if language == "json":
                files += block.splitlines()
            elif title in ("Table", "Lines"):
                files.append(block)
        yield from ((f"{title} {number}", file) for number, file in enumerate(files, 1))


EXAMPLES = dict(examples_of_the_guide())


@pytest.mark.parametrize("title", EXAMPLES)
def test_the_guides_examples_are_read(tmp_path, title):
    path = tmp_path / "book.txt"
    path.write_text(EXAMPLES[title], encoding="utf-8")
    labels = {label.lower() for label in read_book(path).entities}
    assert labels & {"mud", "lake"}


def test_the_guide_shows_an_example_of_each_shape():
    assert {title.rstrip(" 0123456789") for title in EXAMPLES} == {
        "Table",
        "Lines",
        "JSON",
        "Infinite Craft",
    }
    assert len(EXAMPLES) >= 6
