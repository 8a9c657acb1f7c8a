"""Write the tables of docs/partial-graph.md and its picture from docs/partial-graph.json.

    python docs/make_partial_graph.py [--check]

The figures are those of ``benchmarks/partial_graph.py --json``. With ``--check`` nothing is written, and the exit code
is 1 if something would be.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
SOURCE, PAGE, PICTURE = HERE / "partial-graph.json", HERE / "partial-graph.md", HERE / "images" / "partial_graph.svg"
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->"
BOOKS = {
    "alchemy2": "Little Alchemy 2",
    "little-alchemy-2": "Little Alchemy 2",
    "everyday": "`everyday`",
    "everyday-700": "700 recipes of `everyday`",
}
NAMES = {
    "no graph": "no graph",
    "facts, u v": "facts, u v",
    "neighbours, u v": "neighbour rule, u v",
    "kernel, u v": "recipe kernel, u v",
    "ComplEx in-sample, u v": "ComplEx in-sample, u v",
    "ComplEx, u v": "ComplEx, u v",
    "recipes, u v": "recipe scorer, u v",
    "recipes, u v w": "**recipe scorer, u v w**",
    "recipes, w alone": "recipe scorer, w alone",
}
SHOWN = ("no graph", "ComplEx in-sample, u v", "ComplEx, u v", "recipes, u v w")
"""What the picture shows."""
LEGEND = (
    "Pale bars: intervals over trainings; without a bar: one training.",
    "u: does the pair combine? v: is it part of the goal?",
    "w: does the pair make the goal?",
    "In-sample: scores of recipes that the scorer has learned.",
    "Split by-goal: no train recipe makes the goal; by-slot: no",
    "train recipe makes it with one of these ingredients.",
)
"""Lines in the cell after the last panel."""
COLOURS = {8: "#0072b2", 1: "#d55e00"}
Row = dict[str, Any]


def groups(rows: list[Row]) -> dict[tuple[str, str, int], list[Row]]:
    """Return the rows of each book, split and number of steps."""
    found: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        found.setdefault((row["book"], row["split"], row["steps"]), []).append(row)
    return found


def tables(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of all tables."""
    for (book, split, steps), of in groups(rows).items():
        amounts = list(dict.fromkeys(row["distractors"] for row in of))
        trainings = max(row["trainings"] for row in of)
        yield f"{BOOKS[book]}, {split}, {steps:,} steps, {trainings} training{'s' * (trainings > 1)} of each:"
        yield ""
        yield "| | MRR |" + "".join(f" {amount} distractor{'s' * (amount > 1)} | more |" for amount in amounts)
        yield "|---|---|" + "---|---|" * len(amounts)
        for variant in dict.fromkeys(row["variant"] for row in of):
            cells = [row for row in of if row["variant"] == variant]
            mrr = cells[0]["mrr"]
            line = f"| {NAMES[variant]} | {'' if mrr is None else _figure(mrr)} |"
            for row in cells:
                more = "" if variant == "no graph" else f"{row['more_than_no_graph']:+.3f}".replace("0.", ".")
                line += f" {_with_interval(row)} | {more} |"
            yield line
        yield ""


def _figure(value: float) -> str:
    return f"{value:.3f}".removeprefix("0")


def _with_interval(row: Row) -> str:
    interval = row["interval"]
    ends = f" [{_figure(interval[0])}, {_figure(interval[1])}]" if interval else ""
    return _figure(row["success"]) + ends


def mark(x: float, y: float, interval: tuple[float, float], colour: str) -> list[str]:
    """Return a figure as a line across, and its interval as a pale bar."""
    low, high = interval
    return [
        f'<rect x="{low:.1f}" y="{y - 6}" width="{high - low:.1f}" height="12" fill="{colour}" fill-opacity=".3"/>',
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 7}" y2="{y + 7}" stroke="{colour}" stroke-width="1.5"/>',
    ]


def picture(rows: list[Row]) -> str:
    """Return a panel for each book and split: success with 8 and with 1 distractor, a line for each variant."""
    panels = {key: [row for row in of if row["variant"] in SHOWN] for key, of in groups(rows).items()}
    panels = {key: of for key, of in panels.items() if len({row["variant"] for row in of}) == len(SHOWN)}
    width, left, top, line, columns = 430, 176, 64, 28, 2
    height = line * len(SHOWN) + 60
    total = top + height * -(-len(panels) // columns)
    cells = [(width * (n % columns), top + height * (n // columns)) for n in range(len(panels) + 1)]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width * columns} {total}" '
        'font-family="system-ui, sans-serif" font-size="12">',
        "<title>Success on test tasks with and without knowledge from a partial graph</title>",
        f'<rect width="{width * columns}" height="{total}" fill="#ffffff"/>',
        '<text x="14" y="24" font-size="16" fill="#1b1f24">Success on the tasks of unseen recipes</text>',
    ]
    for place, (amount, colour) in enumerate(COLOURS.items()):
        x = 14 + 150 * place
        parts += mark(x + 6, 44, (x, x + 12), colour)
        parts.append(f'<text x="{x + 18}" y="48" fill="#1b1f24">{amount} distractor{"s" * (amount > 1)}</text>')
    for line_number, text in enumerate(LEGEND):
        x, y = cells[-1]
        parts.append(f'<text x="{x + 14}" y="{y + 42 + 20 * line_number}" fill="#57606a">{text}</text>')
    for ((book, split, _), of), (x0, y0) in zip(panels.items(), cells, strict=False):
        scale = width - left - 40
        title = f"{BOOKS[book].strip('`')}, {split}"
        parts.append(f'<text x="{x0 + 14}" y="{y0 + 14}" font-weight="600" fill="#1b1f24">{title}</text>')
        for tick in (0, 0.25, 0.5, 0.75, 1):
            x = x0 + left + scale * tick
            bottom = y0 + 28 + line * len(SHOWN)
            parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y0 + 22}" y2="{bottom}" stroke="#d0d7de"/>')
            parts.append(f'<text x="{x:.1f}" y="{bottom + 13}" text-anchor="middle" fill="#57606a">{tick:g}</text>')
        for row in of:
            y = y0 + 42 + line * SHOWN.index(row["variant"])
            low, high = (x0 + left + scale * end for end in row["interval"] or [row["success"]] * 2)
            parts += mark(x0 + left + scale * row["success"], y, (low, high), COLOURS[row["distractors"]])
            others = [other["success"] for other in of if other["variant"] == row["variant"] and other is not row]
            # The lower figure stands on the left of its mark, so that near figures do not touch.
            x, anchor = (low - 5, "end") if others and row["success"] < min(others) else (high + 5, "start")
            parts.append(
                f'<text x="{x:.1f}" y="{y + 4}" text-anchor="{anchor}" font-size="10" '
                f'fill="{COLOURS[row["distractors"]]}">{_figure(row["success"])}</text>'
            )
        for place, variant in enumerate(SHOWN):
            name = NAMES[variant].strip("*")
            y = y0 + 46 + line * place
            parts.append(f'<text x="{x0 + left - 24}" y="{y}" text-anchor="end" fill="#1b1f24">{name}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    figures = json.loads(SOURCE.read_text(encoding="utf-8"))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    page = before + BEGIN + "\n" + "\n".join(tables(figures)) + END + rest.partition(END)[2]
    for path, text in ((PAGE, page), (PICTURE, picture(figures))):
        if "--check" not in sys.argv:
            path.write_text(text, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            sys.exit(f"{path.name} is not up to date; run `make docs`")
