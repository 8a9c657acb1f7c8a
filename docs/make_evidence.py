"""Write README's finding with its picture, and the figures of the hand-written evidence pages.

    python docs/make_evidence.py [--check]

The finding is from docs/results/. The figure of an evidence page shows columns of the page's first
table, named in a comment: ``<!-- figure: COLUMN; COLUMN -->``, or ``Title = COLUMN`` for another
name in the legend. So a figure cannot differ from its table. With ``--check`` nothing is written,
and the exit code is 1 if something would be.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

from make_results import without_agent

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.records import read_record
from wordcraft_kg.studies.claims import share, signed, view_claims
from wordcraft_kg.studies.results import StudyResults
from wordcraft_kg.studies.view import view_study

HERE = Path(__file__).parent
STUDY = HERE / "results" / "knowledge-little-alchemy-2.json"
FINDING = "<!-- finding -->\n", "<!-- end of finding -->"
CLAIM = "Cross-fitted scores alone improve the agent as published."
SHOWN = {
    "*no agent: random pairs*": "two items at random",
    "no graph": "agent without a graph",
    "partial, as published, u v": "the paper's agent: scores of recipes seen in training",
    "as published, cross-fitted, u v": "the same agent: out-of-sample scores",
    "partial, u v w": "agent with scores of whole recipes",
}
"""Rows of the picture of the finding, by their names in the study."""
FIGURE = re.compile(r"<!-- figure: (.*?) -->")
NUMBER = r"(?<![\d.])[-+]?(?:\d*\.\d+|\d+)"
INTERVAL = re.compile(rf"({NUMBER})\**(?: \[({NUMBER}), ({NUMBER})\])?")
WIDTH, LINE, LONGEST = 400, 16, 44
"""Units of the picture (a phone shows most of them as a pixel), and letters of a label's line."""
STYLE = """
.ground { fill: #ffffff; } text { fill: #1b1f24; font-size: 13px; } .grid { stroke: #d0d7de; }
.s0 { fill: #0072b2; stroke: #0072b2; } .s1 { fill: #b84700; stroke: #b84700; }
text.s0, text.s1 { stroke: none; font-weight: 600; }
@media (prefers-color-scheme: dark) {
.ground { fill: #1e2129; } text { fill: #e6edf3; } .grid { stroke: #444c56; }
.s0 { fill: #6cb8f0; stroke: #6cb8f0; } .s1 { fill: #ffa657; stroke: #ffa657; } }
"""
"""Colours of the picture; its own ground keeps it readable where a page has another scheme."""


class Mark(NamedTuple):
    """A value with its interval; the ends equal the value without one."""

    value: float
    low: float
    high: float
    text: str


def read_mark(cell: str) -> Mark | None:
    """Return the first value of a table's cell; None if the cell has no number."""
    found = INTERVAL.search(cell)
    if found is None:
        return None
    value, low, high = (
        float(part) for part in (found[1], found[2] or found[1], found[3] or found[1])
    )
    return Mark(value, min(low, value), max(high, value), found[1])


def wrapped(label: str) -> list[str]:
    """Return a label in lines that fit above its marks."""
    lines = [""]
    for word in label.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > LONGEST:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def chart(
    title: str, series: Sequence[str], rows: Sequence[tuple[str, Sequence[Mark | None]]]
) -> str:
    """Return a picture of values with intervals: a label above each row, a line for each series.

    Labels stand above their marks, so that a narrow screen shows both in a readable size.
    """
    marks = [mark for _, row in rows for mark in row if mark]
    low = min(0.0, *(mark.low for mark in marks))
    high = max(mark.high for mark in marks)
    high = 1.0 if 0.5 < high <= 1 and low == 0 else high
    left, right = 14, WIDTH - 62
    scale = (right - left) / (high - low)
    y = 26 + LINE * len(wrapped(title))
    parts: list[str] = []
    if len(series) > 1:
        x = left
        for number, name in enumerate(series):
            parts.append(f'<text x="{x}" y="{y}" class="s{number}">{escape(name)}</text>')
            x += 9 * len(name) + 16
        y += LINE
    for label, row in rows:
        for line in wrapped(label):
            parts.append(f'<text x="{left}" y="{y + 4}">{escape(line)}</text>')
            y += LINE
        for number, mark in enumerate(row):
            if mark is None:
                continue
            at, first, last = (
                left + scale * (end - low) for end in (mark.value, mark.low, mark.high)
            )
            zero = left + scale * (0 - low)
            begin, end = sorted((zero, at))
            parts.append(
                f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="{y - 8}" y2="{y + 8}" class="grid"/>'
            )
            parts.append(
                f'<rect x="{begin:.1f}" y="{y - 5}" width="{end - begin:.1f}" height="10" class="s{number}" '
                'style="stroke: none" fill-opacity=".35"/>'
            )
            if last > first:
                parts.append(
                    f'<line x1="{first:.1f}" x2="{last:.1f}" y1="{y}" y2="{y}" class="s{number}" stroke-width="2"/>'
                )
            parts.append(f'<circle cx="{at:.1f}" cy="{y}" r="3" class="s{number}"/>')
            parts.append(
                f'<text x="{max(last, at) + 8:.1f}" y="{y + 4}" class="s{number}">{escape(mark.text)}</text>'
            )
            y += LINE + 2
        y += 8
    heading = [
        f'<text x="{left}" y="{20 + LINE * number}" style="font-weight: 600">{escape(line)}</text>'
        for number, line in enumerate(wrapped(title))
    ]
    whole = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" width="{WIDTH * 1.3:.0f}" '
        f'height="{y * 1.3:.0f}" role="img" font-family="system-ui, sans-serif">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}</style>",
        f'<rect class="ground" width="{WIDTH}" height="{y}"/>',
        *heading,
        *parts,
        "</svg>",
    ]
    return "\n".join(whole) + "\n"


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
    """Return the figure of an evidence page: the named columns of its first table."""
    found = FIGURE.search(text)
    if found is None:
        raise ValueError("no figure is named")
    head, rows = first_table(text)
    named = [part.partition(" = ") for part in found[1].split("; ")]
    columns = [
        head.index((column if is_named else name).strip()) for name, is_named, column in named
    ]
    title = plain(text.partition("# ")[2].partition("\n")[0])
    shown = [
        (plain(cells[0]), [read_mark(cells[column]) for column in columns])
        for cells in rows
        if any(read_mark(cells[column]) for column in columns)
    ]
    return chart(title, [plain(name) for name, *_ in named], shown)


def plain(text: str) -> str:
    """Return a text without the marks of Markdown."""
    return re.sub(r"\[(.*?)\]\(.*?\)", r"\1", text).replace("*", "").replace("`", "").strip()


def finding() -> tuple[list[str], str]:
    """Return the lines of README's finding, and its picture."""
    results = read_record(STUDY, StudyResults)
    point = view_study(results).points[0]
    claim = next(claim for claim in view_claims(results) if claim.text == CLAIM)
    measured = claim.measured[0]
    low, high = signed(measured.low), signed(measured.high)
    rows: dict[str, Mark] = {}
    for name, text, _ in without_agent(results, point):
        mark = read_mark(text)
        assert mark is not None
        rows[name] = mark
    for entry in point.variants:
        rows[entry.variant] = Mark(entry.mean, *entry.interval, share(entry.mean))
    title = "Goals made with recipes never seen in training (Little Alchemy 2, 8 distractors)"
    picture = chart(title, [""], [(label, [rows[name]]) for name, label in SHOWN.items()])
    before, after = (rows[name] for name in (claim.sides[1], claim.sides[0]))
    sentence = (
        f"**The finding.** With unseen recipes the paper's own agent makes {before.text} of the goals, "
        f"no more than an agent without a graph ({rows['no graph'].text}). It makes **{after.text}** if it "
        "learns from scores of recipes that its scorer has *not* seen: a gain of "
        f"{signed(measured.difference)}, 95 % interval [{low}, {high}] ({measured.seeds} trainings each, "
        f"{measured.tasks} tasks; [why](docs/partial-graph.md))."
    )
    alt = f"Success on unseen recipes: {before.text} with scores seen in training, {after.text} with out-of-sample scores"
    return [sentence, "", f"![{alt}](docs/images/finding.svg)", ""], picture


def between(text: str, marks: tuple[str, str], lines: Iterable[str]) -> str:
    """Return a text with new lines between two marks."""
    before, begin, rest = text.partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not begin or not end:
        sys.exit(f"no place between {marks[0].strip()} and {marks[1]}")
    return before + begin + "\n".join(lines) + "\n" + end + after


def files() -> Iterator[tuple[Path, str]]:
    """Yield each file and its content."""
    readme = HERE.parent / "README.md"
    lines, picture = finding()
    yield readme, between(readme.read_text(encoding="utf-8"), FINDING, lines)
    yield HERE / "images" / "finding.svg", picture
    for page in sorted((HERE / "evidence").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if FIGURE.search(text):
            yield HERE / "images" / f"evidence-{page.stem}.svg", figure(text)


def main() -> None:
    """Write the files, or check them."""
    for path, text in files():
        if "--check" not in sys.argv:
            write_atomically(path, text)
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            sys.exit(f"{path.name} is not up to date; run `make docs`")


if __name__ == "__main__":
    main()
