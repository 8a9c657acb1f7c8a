"""The Python of README and guides, as printed, and the examples."""

import ast
import doctest
import importlib
import importlib.util
import os
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from wordcraft_kg.cli import main, make_app
from wordcraft_kg.graphs import open_graph

ROOT = Path(__file__).parents[1]
PAGES = [
    "README.md",
    *(
        f"docs/{name}.md"
        for name in ("agents", "environment", "language-models", "link-prediction", "text-agents")
    ),
]
ELSEWHERE = {
    "chat_player",
    "demo",
    "finetune_language_model",
    "line_player",
    "impala_single_file",
    "transformers_player",
}
"""Examples with tests of their own."""
EXAMPLES = sorted({path.stem for path in (ROOT / "examples").glob("*.py")} - ELSEWHERE)
LONG = (
    "first_steps",
    "own_scorer",
    "own_source",
    "own_tracker",
    "pykeen_model",
    "stable_baselines",
)
NOTEBOOKS = sorted(
    f"docs/notebooks/{path.name}" for path in (ROOT / "docs" / "notebooks").glob("*.py")
)
SOURCES = [*PAGES, *(f"examples/{name}.py" for name in EXAMPLES), *NOTEBOOKS]
SMALL = ("--steps", "256", "--eval-every", "0", "--quiet")


def blocks(page):
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def is_there(module, name):
    """A name in a module, or a module in a package, which is no attribute before its first import."""
    return (
        hasattr(importlib.import_module(module), name)
        or importlib.util.find_spec(f"{module}.{name}") is not None
    )


@pytest.mark.parametrize("source", SOURCES)
def test_what_a_page_or_an_example_imports_is_there(source):
    code = "\n".join(blocks(source)) if source.endswith(".md") else (ROOT / source).read_text()
    imported = [
        (node.module, name.name)
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.ImportFrom)
        and node.module
        and node.module.startswith("wordcraft_kg")
        for name in node.names
    ]
    assert imported or "import wordcraft_kg" in code
    assert [(module, name) for module, name in imported if not is_there(module, name)] == []


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder as it is after the commands of README and guides, but with small trainings."""
    home = tmp_path_factory.mktemp("world")
    commands = (
        f"build-graph {ROOT / 'examples/my-book.csv'} --out {home}/graphs/mine",
        f"train-complex {home}/graphs/mine --dim 4 --epochs 1 --out {home}/models/mine --quiet",
        f"train-agent {home}/graphs/mine --scorer {home}/models/mine --out {home}/runs/guided",
        f"build-graph kitchen --out {home}/graphs/everyday",
        f"train-complex {home}/graphs/everyday --dim 4 --epochs 1 --out "
        f"{home}/models/everyday-partial --quiet",
        f"train-agent {home}/graphs/everyday --scorer {home}/models/everyday-partial --out "
        f"{home}/runs/partial",
    )
    for command in commands:
        small = SMALL if command.startswith("train-agent") else ()
        assert main([*command.split(), *small]) == 0
    return home


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_python_of_a_page_runs_as_printed(page, world, tmp_path, monkeypatch):
    if page == "docs/environment.md":
        pytest.importorskip("sb3_contrib", reason="needs the extra interop")
    shutil.copytree(world, tmp_path / "world")
    monkeypatch.chdir(tmp_path / "world")
    assert blocks(page)
    names = {"__name__": "page"}
    for block in blocks(page):
        # Minutes, a model from a hub, or a server: PyKEEN's pipeline, TRL's trainer and OpenEnv's
        # client have their own tests.
        if not any(name in block for name in ("pipeline(", "GRPOTrainer(", "GenericEnvClient(")):
            exec(compile(block, page, "exec"), names)


TUTORIALS = [
    "README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("tutorial*.md")),
]
OMITTED = "..."
"""A line that stands for any number of printed lines."""


def transcript(text):
    """Return the commands of a console block, each with the printed lines that it shows."""
    return re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", text, re.MULTILINE)


def is_shown(shown, printed):
    """Return whether lines are shown as printed, except for those that ``...`` stands for."""
    expected = [
        "(?:.*\\n)*" if line == OMITTED else re.escape(line) + "\\n" for line in shown.splitlines()
    ]
    return re.fullmatch("".join(expected), printed.rstrip("\n") + "\n") is not None


def test_omitted_lines_of_a_transcript_may_be_any_and_others_may_not():
    ((command, shown), second) = transcript("$ one\na\n...\nd\n...\n$ two\n")
    assert (command, second) == ("one", ("two", ""))
    assert is_shown(shown, "a\nb\nc\nd\ne\n")
    assert is_shown(shown, "a\nd\n")
    assert not is_shown(shown, "a\nb\nc\nx\n")
    assert not is_shown(shown, "b\nd\n")
    assert not is_shown("a\n", "a\nb\n")


def command_lines(page):
    """Return the arguments of each command of this package in a page's blocks."""
    lines = []
    for block in re.findall(
        r"^```(?!python|pycon|toml)\w*\n(.*?)^```", page, re.DOTALL | re.MULTILINE
    ):
        for line in block.replace("\\\n", " ").splitlines():
            program, _, rest = line.removeprefix("$ ").partition(" ")
            # The benchmark's canary begins with the name, too.
            if program == "wordcraft-kg" and " canary " not in rest:
                lines.append(shlex.split(rest, comments=True))
    return lines


def test_command_lines_are_read_from_blocks_with_their_continuations():
    text = "```\nwordcraft-kg books  # all\n$ wordcraft-kg score a \\\n  b + c\nls\n```\n"
    assert command_lines(text) == [["books"], ["score", "a", "b", "+", "c"]]


PRINTED = [
    (str(path.relative_to(ROOT)), line)
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if path.name != "commands.md"  # generated from the commands themselves
    for line in command_lines(path.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(
    ("page", "line"), PRINTED, ids=[f"{page}: {' '.join(line)[:60]}" for page, line in PRINTED]
)
def test_a_printed_command_has_existing_options_and_readable_values(page, line):
    """Tutorials and README run as a whole above; here every command of every page is at least read."""
    if {"--help", "--install-completion", "help", "--version"} & {*line}:
        return
    make_app().parse_args(line, exit_on_error=False, print_error=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_the_commands_of_readme_and_tutorials_print_what_they_show(
    page, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    names = {}
    commands = 0
    for kind, text in re.findall(
        r"^```(\w*)\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE
    ):
        saved = re.match(r"# (\w+\.py)\n", text)
        if kind == "python" and saved:
            Path(saved[1]).write_text(text)
        elif kind == "pycon":
            test = doctest.DocTestParser().get_doctest(text, names, page, page, 0)
            assert doctest.DocTestRunner().run(test, clear_globs=False).failed == 0
            names = test.globs
        elif kind == "console":
            for command, shown in transcript(text):
                program, *words = shlex.split(command)
                if program == "cp":
                    shutil.copy(ROOT / words[0], words[1])
                    continue
                assert program == "wordcraft-kg"
                assert main(words) == 0, command
                printed = capsys.readouterr().out
                assert not shown or is_shown(shown, printed), (command, printed)
                commands += 1
    assert commands >= 4


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in EXAMPLES],
)
def test_an_example_runs(name, tmp_path, monkeypatch, capsys):
    if name == "stable_baselines":
        pytest.importorskip("sb3_contrib", reason="needs the extra interop")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("wordcraft_kg.agents.players.PLAYERS", {})
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")
    assert capsys.readouterr().out


@pytest.mark.slow
def test_the_demo_ends_in_a_table_and_a_solved_unseen_task(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["demo.py", "--book", "kitchen", "--steps", "2000"])
    runpy.run_path(str(ROOT / "examples" / "demo.py"), run_name="__main__")
    shown = capsys.readouterr()
    stages, table, about, explained, *steps, following = shown.out.rstrip().split("\n\n")
    assert all(re.fullmatch(r" +\d+\.\d s  \S.*", line) for line in stages.splitlines())
    assert len(table.splitlines()) == 10
    # Chance comes first, then words, and the oracle last. Agents of 2,000 steps may be below chance.
    rates = [float(re.search(r"\d\.\d{3}", line)[0]) for line in table.splitlines()[1:]]
    assert rates[0] < rates[1] < rates[-1] == max(rates) == 1
    assert "8 distractors" in about
    assert "no scorer and no agent has learned this recipe" in explained
    (solved,) = re.findall(r"Episode 1: make .*\((.* -> .*)\)", "\n".join(steps))
    assert steps[-1].endswith("made it")
    opened = open_graph("demo/graphs/kitchen")
    unseen = opened.graph.recipe_labels(opened.split.recipes("test"))
    assert solved in {f"{a} + {b} -> {result}" for a, b, result in unseen}
    assert "reports/agents/index.html" in following
    assert "$ wordcraft-kg explain" in Path("demo/commands.txt").read_text()
    assert shown.err == ""


def test_the_citation_has_the_fields_of_a_release_and_those_of_the_package():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {
        "cff-version",
        "message",
        "title",
        "abstract",
        "type",
        "date-released",
        "references",
    } <= cited.keys()
    assert (cited["version"], cited["license"]) == (package["version"], package["license"])
    assert cited["authors"] == package["authors"]
    assert set(package["keywords"]) <= set(cited["keywords"])
