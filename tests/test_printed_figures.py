"""Figures that a page shows a second time equal those of the page that has them first."""

import json
import re
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NUMBER = r"(?<![\d.])[-+]?(?:\d*\.\d+|\d+)"


def tables(name):
    """Return a page's tables: for each its heading and the text cells of its rows."""
    found, rows = [], []
    for line in [*(DOCS / name).read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif rows:
            found.append((rows[0], rows[2:]))
            rows = []
    return found


def table(name, *heads):
    """Return the rows of the page's only table whose heading has these cells."""
    (rows,) = [rows for head, rows in tables(name) if set(heads) <= {*head}]
    return rows


def number(cell):
    """Return the first number of a cell, such as `.836` of `**.836** [.802, .870]`."""
    return float(re.search(NUMBER, cell)[0])


STUDIED = {
    "no graph": "no graph",
    "the paper's settings, in-sample": "partial, as published, u v",
    "**the paper's settings, cross-fitted**": "as published, cross-fitted, u v",
    "our settings, in-sample": "partial, in-sample, u v",
    "our settings, cross-fitted": "partial, u v",
}


def test_the_explanation_of_cross_fitting_prints_the_figures_of_the_study():
    page = (DOCS / "evidence/knowledge.md").read_text(encoding="utf-8")
    blocks = re.split(r"^<summary>", page, flags=re.MULTILINE)[1:]
    found = [
        {
            cells[0]: cells[3]
            for cells in (line.strip("|").split(" | ") for line in block.splitlines())
            if len(cells) == 7
        }
        for of_book in blocks
        for block in of_book.split(" test tasks:")[1:]
    ]
    assert len(found) == 4
    rows = table("explanation/cross-fitting.md", "success with unseen recipes")
    assert [cells[0] for cells in rows] == [*STUDIED]
    for name, *cells in rows:
        expected = [number(point[f" {STUDIED[name]}"]) for point in found]
        assert list(map(number, cells)) == expected, name


def archived_means(player):
    """Success of a player's submissions to `depth-2-lite` of the second edition."""
    with zipfile.ZipFile(ROOT / "leaderboard" / "archive" / "everyday-v2.zip") as archive:
        names = [name for name in archive.namelist() if re.match("depth-2-lite/.*sion.json", name)]
        submissions = [json.loads(archive.read(name)) for name in names]
    return [each["figures"]["mean"] for each in submissions if each["player"] == player]


def test_the_evidence_on_language_models_prints_the_leaderboard():
    """Each cell is a row of its track on the leaderboard."""
    names = {
        "recipe scorer with GloVe": "recipe scorer, GloVe",
        "Qwen2.5-Coder-1.5B, by recipes": "Qwen2.5-Coder-1.5B-Instruct, by recipes",
        "Qwen2.5-Coder-0.5B, by recipes": "Qwen2.5-Coder-0.5B-Instruct, by recipes",
        "SmolLM2-135M, by recipes": "SmolLM2-135M-Instruct, untuned, by recipes",
        "nearest words (MiniLM; of made-up words GloVe)": "nearest words (minilm)",
        "SmolLM2-135M, probabilities": "SmolLM2-135M-Instruct, probabilities",
        "SmolLM2-135M, probabilities and a look-up": (
            "SmolLM2-135M-Instruct, probabilities, look-ups"
        ),
        "Qwen2.5-Coder-1.5B, constrained": "Qwen2.5-Coder-1.5B-Instruct, constrained",
        "Qwen2.5-Coder-0.5B, constrained": "Qwen2.5-Coder-0.5B-Instruct, constrained",
    }
    archived = "Qwen2.5-Coder-0.5B, generation (everyday-v2)"
    page = (DOCS / "leaderboard.md").read_text(encoding="utf-8")
    (head, rows), *_ = tables("evidence/language-models.md")
    drawn = "random pair of different items"
    assert {name for name, *_ in rows} == {*names, "chance", drawn, archived}
    for name, *cells in rows:
        if name in (drawn, archived):
            continue
        for track, cell in zip(head[1:], cells, strict=True):
            _, _, of_track = page.partition(f"<summary>{track.strip('`')}: ")
            of_track = of_track.partition("</details>")[0]
            if name == "chance":
                assert number(re.search(r"chance (\S+)", of_track)[1]) == number(cell), track
                continue
            player = names[name]
            if track.strip("`").endswith("made-up"):
                player = player.replace("minilm", "glove")
            printed = re.search(rf"\| {re.escape(player)} \| (.*?) <span", of_track)
            if track == "`depth-2-lite`" and printed is None and cell:
                player = player.removesuffix(", look-ups")
                assert number(cell) in archived_means(player), name  # as the page's method says
                continue
            assert (printed is None) == (cell == ""), (name, track)
            if printed:
                figures = [float(value) for value in re.findall(NUMBER, cell)]
                assert [float(value) for value in re.findall(NUMBER, printed[1])] == figures, name
