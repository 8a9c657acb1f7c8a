"""Tables for papers: the same results as LaTeX, CSV and Markdown."""

import csv

import pytest

from wordcraft_kg.base.errors import OutputExistsError
from wordcraft_kg.cli.console import write_table

ROWS = [
    {"agent": "a_1 & b", "success": 0.12345, "interval": (0.1, 0.25), "difference": None},
    {"agent": "c", "success": 0.5, "interval": (0.4, 0.6), "difference": 0.25},
]


def test_a_table_is_latex_csv_or_markdown_by_its_ending(tmp_path):
    for ending in ("tex", "csv", "md"):
        out = tmp_path / f"table.{ending}"
        assert write_table(out, ROWS) == [f"wrote {out}"]
        with pytest.raises(OutputExistsError):
            write_table(out, ROWS)
    latex = (tmp_path / "table.tex").read_text()
    assert r"a\_1 \& b & 0.123 & [0.100, 0.250] &  \\" in latex
    (first, second) = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert (first["success"], first["difference"], second["difference"]) == ("0.12345", "", "0.25")
    assert "| a_1 & b" in (tmp_path / "table.md").read_text()
    assert write_table(None, ROWS) == []


def test_names_in_markdown_are_neither_numbers_nor_markup(tmp_path):
    out = tmp_path / "table.md"
    write_table(out, [{"agent": name, "success": 0.5} for name in ("1e5", "a|b", "<b>")])
    assert [line.split()[1] for line in out.read_text().splitlines()[2:]] == [
        "1e5",
        "a\\|b",
        "&lt;b>",
    ]


@pytest.mark.parametrize("sign", ["=", "+", "-", "@"])
def test_a_name_in_csv_is_no_formula_of_a_spreadsheet(tmp_path, sign):
    out = tmp_path / "table.csv"
    write_table(out, [{"agent": f"{sign}1+1", "success": -0.5}])
    with out.open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row == {"agent": f"'{sign}1+1", "success": "-0.5"}


def test_names_in_latex_are_no_commands(tmp_path):
    out = tmp_path / "table.tex"
    write_table(out, [{"agent": r"50% #1 $x_1 & {a} ~b ^c \d", "success": 0.5}])
    escaped = r"50\% \#1 \$x\_1 \& \{a\} \textasciitilde b \textasciicircum c \textbackslash d"
    assert f"{escaped} & 0.500" in out.read_text()


def test_an_existing_table_is_named_by_its_option_before_any_work(refused, tmp_path):
    (tmp_path / "t.tex").touch()
    error = refused("evaluate-agent", "kitchen", "--table", tmp_path / "t.tex")
    assert error.startswith("error: --table")
    assert "--out" not in error


@pytest.mark.parametrize(
    "command",
    [
        ("compare", "plain", "guided", "--out", "report"),
        ("evaluate-agent", "plain/seed-0"),
        ("evaluate-agent", "graph"),
        pytest.param(("evaluate-links", "scorer", "--out", "report"), marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
def test_commands_that_measure_write_a_table(run, refused, world, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    name, path, *rest = command
    paths = [str(world / word) if (world / word).exists() else word for word in (path, *rest)]
    few = ("--distractors", 2, "--distractor-seeds", 1) if name != "evaluate-links" else ()
    done = run(name, *paths, *few, "--table", "table.csv")
    assert done.code == 0, done.err
    assert "wrote table.csv" in done.out
    assert "interval" in (tmp_path / "table.csv").read_text() or name == "compare"
    refused(name, *paths, *few, "--table", "table.txt", says="ends in .tex, .csv, .md")
