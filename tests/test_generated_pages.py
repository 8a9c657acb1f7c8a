"""Pages and notebooks that scripts write: results from fabricated figures, evidence from its tables."""

import importlib.util
import json
import re
import runpy
import shutil
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from fabricated import fabricate

from wordcraft_kg.studies.results import Missing, results_text
from wordcraft_kg.studies.study import Claim, built_in, parse_study

DOCS = Path(__file__).parents[1] / "docs"
HEAD = "# Results\n\n<!-- results -->\nold\n<!-- end of results -->\n\nThe end.\n"


@pytest.fixture(autouse=True)
def beside_each_other(monkeypatch):
    """The generators of the guides import each other."""
    monkeypatch.syspath_prepend(str(DOCS))


def generator(name):
    """Import a script of docs/, whose neighbours it imports as a script does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def script():
    return generator("make_results")


def results_of(won, *, study=None, mrr=None, **changed):
    """Return results of 100 tasks; ``won`` has, for each variant and seed, the share of five draws
    that won, as 0-5."""
    points = won if isinstance(won, list) else [({"distractors": 8}, won)]
    cells = [
        {name: [str(digit) * 100 for digit in digits] for name, digits in won.items()}
        for _, won in points
    ]
    points = [(values, digits) for (values, _), digits in zip(points, cells, strict=True)]
    results = fabricate(points, mrr=mrr or {"guided": 0.25}, title="A fabricated study")
    fields = {
        "scorers": {"partial": {"command": "train-complex"}},
        "settings": {"book": "everyday"},
        "grid": {"distractors": [8, 1]},
        "claims": [
            Claim(text="Guided is better.", left="guided", right="none", source="paper, Somewhere")
        ],
    }
    changed["study"] = msgspec.structs.replace(results.study, **fields | (study or {}))
    graphs = (msgspec.structs.replace(results.graphs[0], name="everyday"),)
    return msgspec.structs.replace(
        results, **{"name": "fabricated-everyday", "graphs": graphs, **changed}
    )


SOME = {"none": [1, 1], "guided": [3, 3]}


def archived(path):
    """Write an archive with the results of a fabricated study, and return its path."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("fabricated-everyday.json", results_text(results_of(SOME)))
    return path


def text_of(script, *results):
    """The page of the claims, and the evidence page of the study."""
    files = script.written(list(results), HEAD)
    return files["results.md"] + files.get("evidence/fabricated.md", "")


def test_the_pages_have_claims_metrics_of_each_variant_and_a_figure(script):
    files = script.written([results_of(SOME)], HEAD)
    lines = files["evidence/fabricated.md"].splitlines()
    assert "<!-- figure: Success, everyday, 8 distractors | success = 8 distractors -->" in lines
    assert lines[1] == "# A fabricated study"
    figures = "*guided* .600 against *none* .200: +.400 [+.362, +.438] (2 seeds, 100 tasks)"
    assert lines[3] == f"**Answer.** Guided is better. `everyday`, 8 distractors: {figures}."
    assert "| guided | .600 [.502, .691] |" in lines
    guided = lines.index(
        "| guided | 2 | .255 | .600 [.502, .691] | +.400 [+.362, +.438] | .300 | .500 |"
    )
    assert "8 distractors, 100 test tasks:" in lines[guided - 5]
    assert lines.index("<details markdown>") < guided
    verdict = "**reproduced**: more (provisional: 2 seeds)"
    assert (
        f"| Guided is better. *(paper, Somewhere)* | 8 distractors | {figures} | {verdict} |"
        in lines
    )
    text = files["results.md"]
    row = "| [A fabricated study](evidence/fabricated.md) | `everyday` | 2,000 | 2 | 4 |"
    assert text.index("## Claims of the paper") < text.index(row)
    assert "1 reproduced (1 provisional), 1 not run." in text
    assert "| [Guided is better.](evidence/fabricated.md) *(Somewhere)* | " in text


def test_what_is_missing_is_named_with_the_reason(script):
    lost = tuple(
        Missing("guided", {"distractors": 1}, seed, "the disk was full") for seed in range(3)
    )
    text = text_of(script, results_of(SOME, missing=lost))
    assert "| 2,000 | 2 | 4 | 3 |" in text
    assert (
        "Missing: 3 trainings (the disk was full), the first guided, 1 distractor, seed 0." in text
    )
    assert "**not run**: no runs for 'guided', distractors 1: the disk was full" in text


def test_no_path_of_the_machine_is_kept(script):
    study = {"settings": {"book": "/home/somebody/mine.json"}}
    command = (
        "wordcraft-kg reproduce all --book /home/somebody/mine.json --out /tmp/results --seeds 3"
    )
    lost = Missing(
        "guided",
        {"distractors": 1},
        0,
        "/home/somebody/results/runs/1/run.json is damaged: train again.",
    )
    results = results_of(SOME, study=study, command=command, missing=(lost,))
    text = results_text(script.without_paths(results))
    assert '"run.json is damaged: train again."' in text
    assert "/home" not in text
    assert "/tmp" not in text
    assert "--book mine.json --out results --seeds 3" in text


def test_the_study_of_the_guide_is_one_and_all_built_in_studies_have_a_page(script):
    guide = (DOCS / "studies.md").read_text(encoding="utf-8")
    study = parse_study(guide.partition("```toml\n")[2].partition("```")[0], "docs/studies.md")
    assert len(study.variants) * 2 * study.seeds == 18
    assert set(built_in()) <= set(script.ORDER)


def test_the_check_finds_a_page_that_is_out_of_date(tmp_path, monkeypatch):
    shutil.copytree(DOCS, tmp_path / "docs")
    script = tmp_path / "docs" / "make_results.py"
    archived(tmp_path / "docs" / "results.zip")
    monkeypatch.setattr(sys, "argv", [str(script), "--check"])
    with pytest.raises(SystemExit, match=r"results.md is not up to date"):
        runpy.run_path(str(script), run_name="__main__")
    for argv in ([str(script)], [str(script), "--check"]):
        monkeypatch.setattr(sys, "argv", argv)
        runpy.run_path(str(script), run_name="__main__")


SCRIPT = Path(__file__).parents[1] / "docs" / "make_notebooks.py"
SOURCE = "# %% [markdown]\n# # A title\n#\n# Text.\n\n# %%\nsorted([2, 1])\n"


@pytest.fixture
def notebook_script(tmp_path, monkeypatch):
    """The script on a folder with a source and a stored notebook."""
    pytest.importorskip("nbformat", reason="needs nbformat")
    names = runpy.run_path(str(SCRIPT))
    monkeypatch.setitem(names["main"].__globals__, "HERE", tmp_path)
    (tmp_path / "one.py").write_text(SOURCE)
    executed = names["read_source"](tmp_path / "one.py")
    printed = {"output_type": "stream", "name": "stdout", "text": "[1, 2]\n"}
    log = {"output_type": "stream", "name": "stderr", "text": "/home/somebody took 3 seconds\n"}
    executed.cells[1].outputs = [names["nbformat"].from_dict(output) for output in (printed, log)]
    notebook = names["with_outputs"](names["read_source"](tmp_path / "one.py"), executed)
    (tmp_path / "one.ipynb").write_text(names["text_of"](notebook))

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["make_notebooks.py", *arguments])
        names["main"]()

    return call


def test_a_stored_notebook_has_its_sources_cells_and_stdout(notebook_script, tmp_path):
    """A stored notebook has the cells of its source and the outputs of stdout."""
    notebook_script("--check")
    stored = json.loads((tmp_path / "one.ipynb").read_text())
    assert ["".join(cell["source"]) for cell in stored["cells"]] == [
        "# A title\n\nText.",
        "sorted([2, 1])",
    ]
    assert [output["name"] for output in stored["cells"][1]["outputs"]] == ["stdout"]


def test_changed_code_is_refused_until_the_notebook_is_run_again(notebook_script, tmp_path):
    (tmp_path / "one.py").write_text(SOURCE.replace("[2, 1]", "[3, 1]"))
    for mode in ("--check", "--text"):
        with pytest.raises(
            SystemExit, match=r"one.ipynb was made by other code than one.py. Run it: .* one$"
        ):
            notebook_script(mode)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [path.stem for path in sorted((SCRIPT.parent / "notebooks").glob("*.py"))]
)
def test_a_notebook_runs_and_gives_the_kinds_of_outputs_that_are_stored(name):
    for module in ("nbformat", "nbclient", "ipykernel", "sb3_contrib", "transformers"):
        pytest.importorskip(module, reason="needs the extras docs, interop and text")
    names, source = runpy.run_path(str(SCRIPT)), SCRIPT.parent / "notebooks" / f"{name}.py"
    new, old = (
        names["code_cells"](one.cells)
        for one in (names["run"](source), names["read_stored"](source))
    )
    kinds = [
        [[output.output_type for output in cell.outputs] for cell in cells] for cells in (new, old)
    ]
    assert kinds[0] == kinds[1]


PAGES = [DOCS / "partial-graph.md", *sorted((DOCS / "evidence").glob("*.md"))]


@pytest.fixture(scope="module")
def evidence_script():
    return generator("make_evidence")


def shown(text):
    """The part of a page that a reader sees without unfolding."""
    return re.sub(r"<details.*?</details>", "", text, flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_question_answer_figure_short_table_and_method(page, evidence_script):
    text = shown(page.read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if line and not line.startswith("<!--")]
    assert re.fullmatch(r"# [A-Z].*\?", lines[0])
    assert lines[1].startswith("**Answer.** ")
    assert re.findall(r"^## (.*)", text, re.MULTILINE) == ["Method", "Caveats", "Command"]
    assert len(evidence_script.FIGURE.findall(text)) == 1
    heads = re.findall(r"^\|[-:| ]+\|$", text, re.MULTILINE)
    rows = [line for line in lines if line.startswith("|")]
    assert len(heads) == 1
    assert 2 <= len(rows) - 2 <= 12
    method = text.partition("## Method")[2].partition("## Caveats")[0]
    assert len(method.split()) <= 150
    assert "0.1.0" in text
    assert "2026" in text


def test_all_generated_parts_are_up_to_date(evidence_script):
    old = [
        path.name
        for path, text in evidence_script.files()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    assert old == []


def test_the_readme_is_short():
    assert len((DOCS.parent / "README.md").read_text(encoding="utf-8").split()) <= 700


def test_a_figure_shows_the_named_columns_of_the_first_table(evidence_script):
    text = (
        "# Is `a` better?\n\n**Answer.** Yes. No.\n\n<!-- figure: Success of a | b; wide = c [95 %] -->\n\n"
        "| book | split | b | c [95 %] |\n|---|---|---|---|\n"
        "| first | by goal | .5 | 1,000 [900, 1,100] |\n| | by slot | **.25** (.2 .3) | |\n"
    )
    picture = evidence_script.figure(text)
    assert "<title>Success of a</title>" in picture
    words = re.findall(r"<text [^>]*>(.*?)</text>", picture)
    assert words == [
        *("Success of a", "b", "wide"),
        *("first, by goal", ".5", "1,000"),
        *("first, by slot", ".25"),
    ]
    assert evidence_script.answer(text) == "Yes."
    with pytest.raises(ValueError, match="'Success of a' has 3 series; expected one or two"):
        evidence_script.figure(text.replace("| b;", "| split; b;", 1))


def test_a_table_has_the_columns_of_all_its_rows(evidence_script, tmp_path, monkeypatch):
    (tmp_path / "evidence").mkdir()
    (tmp_path / "evidence/tables.csv").write_text(
        "page,table,row,column,value,low,high\n"
        "mine,first,a | 1,success,0.5,0.4,0.6\n"
        'mine,first,b | 2,tasks,"1,000",,\n'
    )
    monkeypatch.setattr(evidence_script, "HERE", tmp_path)
    evidence_script.tables.cache_clear()
    text = "Before\n<!-- table: first; rows: book | depth -->\nold\n<!-- end of table -->\nAfter\n"
    filled = evidence_script.with_tables("mine", text)
    evidence_script.tables.cache_clear()
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

WRITTEN = [
    page
    for page in PAGES
    if page.stem != "parts" and "<!-- generated by" not in page.read_text(encoding="utf-8")
]
"""Pages whose sentences people write; the answer of the others follows from their figures."""


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_each_figure_of_a_pages_sentences_is_among_its_stored_figures(page, evidence_script):
    """An answer that was not mended after a new measurement fails."""
    text = evidence_script.TABLE.sub("", page.read_text(encoding="utf-8"))
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    cells = [
        cell
        for (name, _), rows in evidence_script.tables().items()
        if name == page.stem
        for columns in rows.values()
        for cell in columns.values()
    ]
    assert set(FIGURE.findall(text)) <= set(FIGURE.findall(" ".join(cells)))


def test_the_website_shows_a_figure_in_place_of_its_comment(evidence_script):
    page = SimpleNamespace(file=SimpleNamespace(src_uri="evidence/acting.md"))
    shown = evidence_script.on_page_markdown("a\n<!-- figure: Success | b -->\n", page=page)
    assert shown == "a\n![Success](../images/evidence-acting.svg)\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_figure_of_a_page_follows_the_colour_scheme(page, evidence_script):
    light, dark = evidence_script.figure(page.read_text(encoding="utf-8")).split(
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


STUDIED = {
    "no graph": "agent without a graph",
    "the paper's settings, scores of learned recipes": (
        "ComplEx, scores of learned recipes, the paper's equations"
    ),
    "**the paper's settings, scores of unseen recipes**": (
        "ComplEx, scores of unseen recipes, the paper's equations"
    ),
    "our settings, scores of learned recipes": "ComplEx, scores of learned recipes",
    "our settings, scores of unseen recipes": "ComplEx, scores of unseen recipes",
}


def test_the_explanation_of_cross_fitting_prints_the_figures_of_the_study():
    page = (PRINTED_FIGURES_DOCS / "evidence/knowledge.md").read_text(encoding="utf-8")
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
