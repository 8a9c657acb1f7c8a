"""The evidence pages keep to one template, and their figures show their tables."""

import importlib.util
import json
import re
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

DOCS = Path(__file__).parents[1] / "docs"

PAGES = sorted((DOCS / "evidence").glob("*.md"))


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_evidence", DOCS / "make_evidence.py")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(DOCS))
    spec.loader.exec_module(module)
    sys.path.remove(str(DOCS))
    return module


def shown(text):
    """The part of a page that a reader sees without unfolding."""
    return re.sub(r"<details.*?</details>", "", text, flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_question_answer_figure_short_table_and_method(page, script):
    text = shown(page.read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if line and not line.startswith("<!--")]
    assert re.fullmatch(r"# [A-Z].*\?", lines[0])
    assert lines[1].startswith("**Answer.** ")
    assert re.findall(r"^## (.*)", text, re.MULTILINE) == ["Method", "Caveats", "Command"]
    assert len(script.FIGURE.findall(text)) == 1
    heads = re.findall(r"^\|[-:| ]+\|$", text, re.MULTILINE)
    rows = [line for line in lines if line.startswith("|")]
    assert len(heads) == 1
    assert 2 <= len(rows) - 2 <= 12
    method = text.partition("## Method")[2].partition("## Caveats")[0]
    assert len(method.split()) <= 150
    assert "0.1.0" in text
    assert "2026" in text


def test_all_generated_parts_are_up_to_date(script):
    old = [
        path.name
        for path, text in script.files()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    assert old == []


def test_the_readme_is_short():
    assert len((DOCS.parent / "README.md").read_text(encoding="utf-8").split()) <= 700


def test_a_figure_shows_the_named_columns_of_the_first_table(script):
    text = (
        "# Is `a` better?\n\n**Answer.** Yes. No.\n\n<!-- figure: Success of a | b; wide = c [95 %] -->\n\n"
        "| book | split | b | c [95 %] |\n|---|---|---|---|\n"
        "| first | by goal | .5 | 1,000 [900, 1,100] |\n| | by slot | **.25** (.2 .3) | |\n"
    )
    picture = script.figure(text)
    assert "<title>Success of a</title>" in picture
    words = re.findall(r"<text [^>]*>(.*?)</text>", picture)
    assert words == [
        *("Success of a", "b", "wide"),
        *("first, by goal", ".5", "1,000"),
        *("first, by slot", ".25"),
    ]
    assert script.answer(text) == "Yes."
    with pytest.raises(ValueError, match="'Success of a' has 3 series; expected one or two"):
        script.figure(text.replace("| b;", "| split; b;", 1))


def test_a_table_has_the_columns_of_all_its_rows(script, tmp_path, monkeypatch):
    (tmp_path / "evidence").mkdir()
    (tmp_path / "evidence/tables.csv").write_text(
        "page,table,row,column,value,low,high\n"
        "mine,first,a | 1,success,0.5,0.4,0.6\n"
        'mine,first,b | 2,tasks,"1,000",,\n'
    )
    monkeypatch.setattr(script, "TABLES", tmp_path / "evidence/tables.csv")
    script.tables.cache_clear()
    text = "Before\n<!-- table: first; rows: book | depth -->\nold\n<!-- end of table -->\nAfter\n"
    filled = script.with_tables("mine", text)
    script.tables.cache_clear()
    assert filled.splitlines()[1:-1] == [
        "<!-- table: first; rows: book | depth -->",
        "",
        "| book | depth | success | tasks |",
        "|---|---|---|---|",
        "| a | 1 | .5 [.4, .6] |  |",
        "| b | 2 |  | 1,000 |",
        "",
        "<!-- end of table -->",
    ]


FIGURE = re.compile(r"(?<!\d)\.\d{3}(?!\d)")
"""A share of three digits, as measurements are printed."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_figure_of_a_pages_sentences_is_among_its_stored_figures(page, script):
    """An answer that was not mended after a new measurement fails."""
    whole = page.read_text(encoding="utf-8")
    shown_tables = [place[0] for place in script.TABLE.finditer(whole)]
    sentences = script.tables().get((page.stem, "text"), {})
    quoted = [cell for columns in sentences.values() for cell in columns.values()]
    text = re.sub(r"^```.*?^```", "", script.TABLE.sub("", whole), flags=re.DOTALL | re.MULTILINE)
    assert set(FIGURE.findall(text)) <= set(FIGURE.findall(" ".join(shown_tables + quoted)))


def test_each_stored_table_stands_on_its_page(script):
    places = {
        (page.stem, place[2])
        for page in DOCS.rglob("*.md")
        for place in script.TABLE.finditer(page.read_text(encoding="utf-8"))
    }
    assert {key for key in script.tables() if key[1] != "text"} <= places


def test_each_stored_measurement_is_named_by_a_page():
    with zipfile.ZipFile(DOCS / "evidence" / "measurements.zip") as archive:
        names = archive.namelist()
    texts = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    named = [name.replace("*", ".*") for name in re.findall(r"`([\w*-]+\.(?:json|csv))`", texts)]
    assert [name for name in names if not any(re.fullmatch(each, name) for each in named)] == []


MOST_EVIDENCE_WORDS = 20_000
"""Of all pages of evidence, tables included."""


def test_the_evidence_is_fourteen_short_pages():
    assert len(PAGES) <= 14
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES) <= (
        MOST_EVIDENCE_WORDS
    )


def headings(page):
    """Anchors of a page: its headings, and the ids of its folded parts."""
    text = page.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.*)", text, re.MULTILINE)
    anchors = [re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-") for title in titles]
    return {*anchors, *re.findall(r'id="([\w-]+)"', text)}


def test_addresses_of_earlier_pages_lead_to_pages_of_today():
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    moved = yaml.safe_load(text)["extra"]["moved"]
    assert moved
    for old, new in moved.items():
        assert not (DOCS / old).exists(), old
        name, _, anchor = new.partition("#")
        page = DOCS / name
        # The website makes the pages of notebooks.
        assert page.exists() or page.with_suffix(".ipynb").exists(), new
        assert not anchor or anchor in headings(page), new


def test_the_website_shows_a_figure_in_place_of_its_comment(script):
    page = SimpleNamespace(file=SimpleNamespace(src_uri="evidence/planning.md"))
    shown = script.on_page_markdown("a\n<!-- figure: Success | b -->\n", page=page)
    assert shown == "a\n![Success](../images/evidence-planning.svg)\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_figure_of_a_page_follows_the_colour_scheme(page, script):
    light, dark = script.figure(page.read_text(encoding="utf-8")).split(
        "(prefers-color-scheme: dark)"
    )
    for rule in (r"\.ground {[^}]*fill: (#\w+)", r"(?<!\S)text {[^}]*fill: (#\w+)"):
        assert re.search(rule, light)[1] != re.search(rule, dark)[1]


ROOT = Path(__file__).parents[1]

PRINTED_FIGURES_DOCS = ROOT / "docs"

NUMBER = r"(?<![\d.])[-+]?(?:\d*\.\d+|\d+)"


def tables(name):
    """Return a page's tables: for each its heading and the text cells of its rows."""
    found, rows = [], []
    for line in [*(PRINTED_FIGURES_DOCS / name).read_text(encoding="utf-8").splitlines(), ""]:
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
    page = (PRINTED_FIGURES_DOCS / "leaderboard.md").read_text(encoding="utf-8")
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
