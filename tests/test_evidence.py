"""The evidence pages keep to one template, and their figures show their tables."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [DOCS / "partial-graph.md", *sorted((DOCS / "evidence").glob("*.md"))]


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
def test_a_page_has_question_answer_figure_short_table_and_method(page):
    text = shown(page.read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if line and not line.startswith("<!--")]
    assert re.fullmatch(r"# [A-Z].*\?", lines[0])
    assert lines[1].startswith("**Answer.** ")
    assert re.findall(r"^## (.*)", text, re.MULTILINE) == ["Method", "Caveats", "Command"]
    assert len(re.findall(r"^!\[.+?\]\(.*?\.svg\)$", text, re.MULTILINE)) == 1
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
    assert len((DOCS.parent / "README.md").read_text(encoding="utf-8").split()) <= 900


def test_a_figure_shows_the_named_columns_of_the_first_table(script):
    text = (
        "# Is `a` better?\n\n**Answer.** Yes. No.\n\n![Success of a](images/evidence-a.svg)\n\n<!-- figure: b; wide = c [95 %] -->\n\n"
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
        script.figure(text.replace("figure: b;", "figure: split; b;"))


@pytest.mark.parametrize(
    ("answer", "short"),
    [
        ("No: scores help in all conditions.", "No: scores help in all conditions."),
        (f"Hardly, so far: the difference is {'-.009 to +.020, ' * 8}[.0, .1].", "Hardly, so far."),
        (
            f"A whole sentence of {'many ' * 20}words. A second.",
            f"A whole sentence of {'many ' * 20}words.",
        ),
    ],
)
def test_the_index_has_the_words_before_the_figures_of_a_long_answer(script, answer, short):
    assert script.answer(f"# Why?\n\n**Answer.** {answer}\n\nMore.\n") == short


IN_THE_TABLE = [
    *("finetuned", "intervals", "joint-training", "penalty", "people-pairs", "plan-weights"),
    *("planning-agents", "presets", "untrained", "words", "worlds"),
]
"""Pages with a written answer, all of whose figures stand in the page's table."""


@pytest.mark.parametrize("name", IN_THE_TABLE)
def test_each_figure_of_an_answer_is_in_the_pages_table(name):
    """The tables follow from files, so an answer that was not mended after a new measurement fails."""
    text = shown((DOCS / "evidence" / f"{name}.md").read_text(encoding="utf-8"))
    (answer,) = re.findall(r"^\*\*Answer\.\*\* (.*?)\n\n", text, re.DOTALL | re.MULTILINE)
    rows = "\n".join(line for line in text.splitlines() if line.startswith("|"))
    figures = re.findall(r"(?<!\d)\.\d{3}", answer)
    assert len(figures) >= 4
    assert set(figures) <= set(re.findall(r"(?<!\d)\.\d{3}", rows))
