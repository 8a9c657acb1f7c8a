"""Write the tables of the evidence pages, README's finding and the questions of docs/results.md; a hook
for the website draws the pages' figures.

    python docs/make_evidence.py [--check]

All tables lie in docs/evidence/tables.csv, a cell a line: page, table, row, column, value, low, high;
those of studies come from their results (make_results.py). A page marks the place of a table with
``<!-- table: NAME; rows: HEADS -->`` ... ``<!-- end of table -->``; HEADS are the headings of the cells
that name a row, and may be missing. README shows what each part adds from the pages ``parts`` and
``planning``.

The website shows a figure in place of ``<!-- figure: TITLE | COLUMN; COLUMN -->``: these columns of the
page's first table, or ``Name = COLUMN`` for another name in the legend. So a figure cannot differ
from its table. The questions are the titles and answers of the evidence
pages in the order of the website's menu. With ``--check`` nothing is written, and the exit code is 1
if something would be.
"""

import csv
import io
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from charts import Mark, chart, plain, read_mark

from wordcraft_kg.base.artefacts import write_atomically

HERE = Path(__file__).parent
QUESTIONS = "<!-- questions -->\n", "<!-- end of questions -->"
FINDING = "<!-- finding -->\n", "<!-- end of finding -->"
LONGEST = 90
"""Letters of an answer that the index shows with its figures."""
TABLE = re.compile(
    r"(<!-- table: (.*?)(?:; rows: (.*?))? -->\n).*?(<!-- end of table -->)", re.DOTALL
)
FIGURE = re.compile(r"<!-- figure: (.*?) \| (.*?) -->")
ZERO = re.compile(r"(?<![\d.])0(?=\.\d)")
"""The zero before a decimal point, which the pages leave out."""
MARK = "†"
"""A mark of a value that stands behind its interval."""


class Cell(NamedTuple):
    """A line of tables.csv; ``low`` and ``high`` are empty without an interval."""

    page: str
    table: str
    row: str
    column: str
    value: str
    low: str
    high: str

    @property
    def text(self) -> str:
        """The cell as a page shows it, such as ``.852 [.829, .873]``."""
        if not self.low:
            return ZERO.sub("", self.value)
        value, mark, _ = self.value.partition(MARK)
        return ZERO.sub("", f"{value} [{self.low}, {self.high}]{mark}")


TABLES = HERE / "evidence" / "tables.csv"
FINDING_COLUMNS = {
    "unseen recipes": ("parts", "success, 8 distractors", "Little Alchemy 2, unseen recipes"),
    "unseen goals": ("parts", "success, 8 distractors", "Little Alchemy 2, unseen goals"),
    "two attempts": ("planning", "success", "Little Alchemy 2, unseen recipes"),
    "two, unseen goals": ("planning", "success", "Little Alchemy 2, unseen goals"),
}
"""Page, table and column of each column of README's finding."""
FINDING_ROWS = {
    "random pair": ("two items at random",),
    "nearest words": ("nearest words, GloVe", "nearest words"),
    "plain PPO": ("plain PPO",),
    "learner, no graph": ("the learner, no graph",),
    "learner with ComplEx": ("learner with ComplEx",),
    "recipe scorer alone": ("recipe scorer alone",),
    "learner with recipe scorer": ("learner with recipe scorer",),
    "planner alone": ("planner alone",),
    "learner with plans": ("learner with plans",),
}
"""Rows of README's finding, each with the names that the pages give it."""


def read_cells() -> list[Cell]:
    """Return the lines of tables.csv."""
    with TABLES.open(encoding="utf-8", newline="") as file:
        _, *lines = csv.reader(file)
    return [Cell(*line) for line in lines]


def as_csv(cells: Iterable[Cell]) -> str:
    """Return the text of tables.csv."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([Cell._fields, *cells])
    return text.getvalue()


@cache
def tables() -> dict[tuple[str, str], dict[str, dict[str, str]]]:
    """Return the texts of all cells by page and table, by row, by column."""
    texts: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for cell in read_cells():
        rows = texts.setdefault((cell.page, cell.table), {})
        rows.setdefault(cell.row, {})[cell.column] = cell.text
    return texts


def table(page: str, name: str, heads: str) -> Iterator[str]:
    """Yield the lines of a page's table.

    Args:
        page: the page's name without its folder and suffix.
        name: the table's name.
        heads: headings of the cells that name a row, separated by a vertical bar.
    """
    rows = tables()[page, name]
    columns = list(dict.fromkeys(column for cells in rows.values() for column in cells))
    yield f"| {heads} | {' | '.join(columns)} |".replace("|  |", "| |", 1)
    yield "|" + "---|" * (heads.count(" | ") + 1 + len(columns))
    for row, cells in rows.items():
        yield f"| {row} | {' | '.join(cells.get(column, '') for column in columns)} |"


def first_table(text: str) -> tuple[list[str], list[list[str]]]:
    """Return the heading and the rows of a page's first table."""
    rows: list[list[str]] = []
    for line in text.splitlines():
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif rows:
            break
    return rows[0], rows[2:]


def figure(text: str) -> str:
    """Return the figure of an evidence page: the named columns of its first table.

    Raises:
        ValueError: if the page names no column.
    """
    comment = FIGURE.search(text)
    if comment is None:
        raise ValueError("no figure is named")
    head, rows = first_table(text)
    named = [part.partition(" = ") for part in comment[2].split("; ")]
    columns = [
        head.index((column if is_named else name).strip()) for name, is_named, column in named
    ]
    bars: list[tuple[str, list[Mark | None]]] = []
    first_label = ""
    for cells in rows:
        first_label = cells[0] or first_label
        label = [first_label]
        for name, cell in list(zip(head, cells, strict=True))[1 : min(columns)]:
            if re.search("[A-Za-z]", cell):
                label.append(cell)
            elif name == "distractors":
                label.append(f"{cell} distractor{'s' * (cell != '1')}")
        marks = [read_mark(cells[column]) for column in columns]
        if any(marks):
            bars.append((plain(", ".join(label)), marks))
    return chart(comment[1], [plain(name) for name, *_ in named], bars)


def finding() -> Iterator[str]:
    """Yield the lines of README's finding: what each part adds on the paper's book."""
    yield (
        "**What each part adds.** Goals made on Little Alchemy 2, with 8 *distractors* (further "
        "items; intervals: [one attempt](docs/evidence/parts.md), "
        "[two, with 4](docs/evidence/planning.md)):"
    )
    yield ""
    yield f"| player | {' | '.join(FINDING_COLUMNS)} |"
    yield "|---" * (len(FINDING_COLUMNS) + 1) + "|"
    for title, names in FINDING_ROWS.items():
        texts = [success(place, names) for place in FINDING_COLUMNS.values()]
        yield f"| {title} | {' | '.join(texts)} |"
    yield ""
    yield (
        "The scores must come from a scorer that has *not* seen the practised recipes "
        "([why](docs/explanation/cross-fitting.md))."
    )
    yield ""


def success(place: tuple[str, str, str], names: Iterable[str]) -> str:
    """Return a cell without its interval, or an empty text if no row has one of the names."""
    page, name, column = place
    rows = tables()[page, name]
    texts = [rows[row].get(column, "") for row in names if row in rows]
    return texts[0].partition(" [")[0] if texts else ""


def questions() -> Iterator[str]:
    """Yield the questions and answers of all evidence pages, by the themes of the menu."""
    menu = yaml.safe_load((HERE.parent / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    (evidence,) = [section["Evidence"] for section in menu if "Evidence" in section]
    for entry in evidence:
        for theme, pages in entry.items():
            if isinstance(pages, str):
                continue
            yield f"### {theme}"
            yield ""
            for page in pages:
                (path,) = page.values()
                text = (HERE / path).read_text(encoding="utf-8")
                title = text.partition("# ")[2].partition("\n")[0]
                yield f"- [{title}]({path}) {answer(text)}"
            yield ""


def answer(text: str) -> str:
    """Return a page's answer in short: its first sentence, or the words before the figures.

    Raises:
        ValueError: if the page has no answer.
    """
    paragraph = re.search(r"^\*\*Answer\.\*\* (.*?)\n\n", text, re.DOTALL | re.MULTILINE)
    if paragraph is None:
        raise ValueError("a page of evidence has no answer")
    whole = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", " ".join(paragraph[1].split()))
    sentence = re.split(r"(?<=\.) (?=[A-Z`*])", whole, maxsplit=1)[0]
    words = re.split("[:;] ", sentence, maxsplit=1)[0]
    return sentence if len(sentence) <= LONGEST or words == sentence else f"{words}."


def between(text: str, marks: tuple[str, str], lines: Iterable[str]) -> str:
    """Return a text with new lines between two marks."""
    before, begin, rest = text.partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not begin or not end:
        sys.exit(f"no place between {marks[0].strip()} and {marks[1]}")
    return before + begin + "\n".join(lines) + "\n" + end + after


def with_tables(page: str, text: str) -> str:
    """Return a page's text with its tables of today."""

    def filled(place: re.Match[str]) -> str:
        begin, name, heads, end = place.groups(default="")
        return "\n".join([begin, *table(page, name, heads), "", end])

    return TABLE.sub(filled, text)


def files() -> Iterator[tuple[Path, str]]:
    """Yield each file and its content."""
    readme = HERE.parent / "README.md"
    yield readme, between(readme.read_text(encoding="utf-8"), FINDING, finding())
    guides = [HERE / "limits.md"]
    for page in (*guides, *sorted((HERE / "evidence").glob("*.md"))):
        text = with_tables(page.stem, page.read_text(encoding="utf-8"))
        yield page, text
    # The last: it quotes the answers of the pages above.
    results = HERE / "results.md"
    text = with_tables(results.stem, results.read_text(encoding="utf-8"))
    yield results, between(text, QUESTIONS, ["", *questions()])


def on_files(files: Any, *, config: Any) -> Any:
    """Add the figures of all evidence pages to the website."""
    from mkdocs.structure.files import File

    for page in (HERE / "evidence").glob("*.md"):
        picture = figure(page.read_text(encoding="utf-8"))
        files.append(File.generated(config, f"images/evidence-{page.stem}.svg", content=picture))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: object) -> str:
    """Show the page's figure in place of its comment."""
    source = Path(page.file.src_uri)
    folder = "../" * (len(source.parts) - 1)
    return FIGURE.sub(rf"![\1]({folder}images/evidence-{source.stem}.svg)", markdown)


def main() -> None:
    """Write the files, or check them."""
    for path, text in files():
        if "--check" not in sys.argv:
            write_atomically(path, text)
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            sys.exit(f"{path.name} is not up to date; run `make docs`")


if __name__ == "__main__":
    main()
