"""The Python of README and guides, as printed, and the examples."""

import ast
import csv
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
import zipfile
from pathlib import Path

import mlcroissant
import pytest
import yaml

import wordcraft_kg as wk
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.registry import load_plugin
from wordcraft_kg.cli import main, make_app, without_plugins
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import Recipe, RecipeGraph, open_book, open_graph, write_graph_folder
from wordcraft_kg.graphs.export import export_graph
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

ROOT = Path(__file__).parents[1]

PAGES = [
    "README.md",
    *(f"docs/{name}.md" for name in ("agents", "environment", "language-models")),
]

ELSEWHERE = {
    "chat_player",
    "demo",
    "finetune_language_model",
    "finetune_on_gpu",
    "grpo_on_gpu",
    "line_player",
    "impala_single_file",
    "reinforce_language_model",
    "chat_template",
    "transformers_player",
}
"""Examples with tests of their own."""

EXAMPLES = sorted({path.stem for path in (ROOT / "examples").glob("*.py")} - ELSEWHERE)

LONG = (
    "first_steps",
    "own_scorer",
    "own_tracker",
    "pykeen_model",
    "stable_baselines",
)

SHORT = {"ppo": ("--graph", "kitchen", "--steps", "4096")}
"""Options that make an example short."""

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


@pytest.mark.parametrize("page", ["AGENTS.md", "CONTRIBUTING.md", "Makefile", ".ci/run"])
def test_a_test_that_is_named_for_developers_is_there(page):
    named = re.findall(r"tests/[\w/]+\.py", (ROOT / page).read_text())
    assert [name for name in named if not (ROOT / name).is_file()] == []


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder as it is after the commands of README and guides, but with small trainings."""
    home = tmp_path_factory.mktemp("world")
    shutil.copytree(ROOT / "examples", home / "examples")
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
    # Of the guide to Stable-Baselines3, whose training is long enough to learn; chance makes .04.
    assert names.get("success", 1) > 0.2


TUTORIALS = [
    "README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("tutorial*.md")),
]

OMITTED = "..."
"""A line that stands for any number of printed lines."""


def transcript(text):
    """Return the commands of a console block, each with the printed lines that it shows."""
    return re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", text, re.MULTILINE)


SHARE = r"0\.\d{3}"
"""A share as commands print it, such as a trained agent's success."""

TOLERANCE = 0.06
"""Difference between a share on the page and here: rounding, and so training, depends on the
processor."""


def is_shown(shown, printed):
    """Return whether lines are shown as printed, except for those that ``...`` stands for.

    Shares may differ by the tolerance.
    """
    lines = shown.splitlines()
    expected = ""
    for line in lines:
        texts = [re.escape(text) for text in re.split(SHARE, line)]
        expected += "(?:.*\\n)*" if line == OMITTED else f"({SHARE})".join(texts) + "\\n"
    found = re.fullmatch(expected, printed.rstrip("\n") + "\n")
    if found is None:
        return False
    shares = zip(map(float, re.findall(SHARE, shown)), map(float, found.groups()), strict=True)
    return all(abs(here - there) <= TOLERANCE for here, there in shares)


def command_lines(page):
    """Return the arguments of each command of this package in a page's blocks."""
    lines = []
    # All blocks are found first: the end of a block of Python looks like the beginning of another.
    for kind, block in re.findall(r"^```(\w*)\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
        if kind in ("python", "pycon", "toml"):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            program, _, rest = line.removeprefix("$ ").partition(" ")
            # The benchmark's canary begins with the name, too.
            if program == "wordcraft-kg" and " canary " not in rest:
                lines.append(shlex.split(rest, comments=True))
    return lines


PRINTED = [
    (str(path.relative_to(ROOT)), line)
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    for line in command_lines(path.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(
    ("page", "line"), PRINTED, ids=[f"{page}: {' '.join(line)[:60]}" for page, line in PRINTED]
)
def test_a_printed_command_has_existing_options_and_readable_values(page, line, forget_plugins):
    """Tutorials and README run as a whole above; here every command of every page is at least read."""
    if {"--help", "--install-completion", "help", "--version"} & {*line}:
        return
    words, plugins = without_plugins(line)
    for plugin in plugins:
        load_plugin(ROOT / plugin)
    make_app().parse_args(words, exit_on_error=False, print_error=False)


def pages_of(section):
    """Return the paths of a section of the website's menu, notebooks left out."""
    menu = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    (entries,) = [each[section] for each in menu if section in each]
    paths = [path for entry in entries for path in entry.values()]
    return [f"docs/{path}" for path in paths if not path.startswith("notebooks/")]


def words_of(text):
    """Return the words of a page without blocks of code, tables and addresses of links."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith("|")]
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    return [word for word in text.split() if re.search(r"\w", word)]


GENERATED_PAGES = ("terms.md", "leaderboard.md")
"""Pages that a script writes as a whole, besides those that say so in their first line."""

MOST_WORDS = 35_000
"""Of all pages that people write."""


def hand_written(text):
    """Return all words of a page, tables and code included, without the parts that scripts write."""
    if text.startswith("<!-- generated by"):
        return []
    text = re.sub(
        r"<!-- (?!figure:)[^>]*? -->\n.*?<!-- end of [^>]*? -->", "", text, flags=re.DOTALL
    )
    return re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split()


def test_all_guides_together_are_short():
    """README, all pages below docs/, and the text of the notebooks."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    count = sum(
        len(hand_written(path.read_text(encoding="utf-8")))
        for path in pages
        if path.name not in GENERATED_PAGES
    )
    for path in (ROOT / "docs" / "notebooks").glob("*.py"):
        cells = re.findall(r"^# (?!%%)(.*)", path.read_text(encoding="utf-8"), re.MULTILINE)
        count += sum(len(line.split()) for line in cells)
    assert 20_000 < count <= MOST_WORDS


FIGURE = re.compile(r"(?<![\w.])[-+]?0?(\.\d{3})(?!\d)")
"""A share of three digits, as measurements are printed."""

SETTINGS = {
    "docs/explanation/recipe-scorer.md": {".002"},
    "docs/explanation/decisions.md": {".001", ".005", ".008"},
}
"""Shares that are settings, by page."""


def hand_written_figures(text):
    """Return the shares that a person wrote, code left out: a command prints what code shows."""
    if text.startswith("<!-- generated by"):
        return []
    text = re.sub(
        r"<!-- (?!figure:)[^>]*? -->\n.*?<!-- end of [^>]*? -->", "", text, flags=re.DOTALL
    )
    return FIGURE.findall(re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))


GUIDES = ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]

GUIDES += [f"docs/explanation/{path.name}" for path in (ROOT / "docs/explanation").glob("*.md")]

GUIDES = [page for page in GUIDES if Path(page).name not in GENERATED_PAGES]


@pytest.mark.parametrize("page", GUIDES)
def test_a_guide_links_the_page_with_each_figure_that_it_quotes(page):
    """Or shows the command that prints it."""
    text = (ROOT / page).read_text(encoding="utf-8")
    stored = (ROOT / "docs/evidence/tables.csv").read_text(encoding="utf-8").splitlines()
    shown = {
        figure
        for line in stored
        if line.startswith(f"{Path(page).stem},")
        for figure in FIGURE.findall(line)
    }
    shown |= set(
        FIGURE.findall("".join(re.findall(r"^```.*?^```", text, re.DOTALL | re.MULTILINE)))
    )
    for link in re.findall(r"\]\(([^)#\s:]+\.md)", text):
        linked = (ROOT / page).parent / link
        if linked.exists():
            shown |= set(FIGURE.findall(linked.read_text(encoding="utf-8")))
    quoted = set(hand_written_figures(text)) - SETTINGS.get(page, set())
    assert sorted(quoted - shown) == []


HOW_TO, EXPLANATIONS = pages_of("How to"), pages_of("Explanation")

LONGEST = {**dict.fromkeys(EXPLANATIONS, 1_300), **dict.fromkeys(HOW_TO, 600)}
"""Most words of a page."""


@pytest.mark.parametrize("page", LONGEST)
def test_a_page_is_short(page):
    assert len(words_of((ROOT / page).read_text(encoding="utf-8"))) <= LONGEST[page]


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
                # Which of two similar plans a trained agent takes depends on rounding, too.
                if words[0] == "explain":
                    shown = shown[: shown.index("\n", shown.index("Episode"))] + f"\n{OMITTED}\n"
                assert not shown or is_shown(shown, printed), (command, printed)
                commands += 1
    assert commands >= 3


SERVER = "serves until it is stopped; tests of the app start it and talk to it"

NETWORK = "needs the network"

MODEL = "needs the weights of a language model; tests/apps/elicitation runs it on a small one"

WORDNET = (
    "needs WordNet or ConceptNet, or knowledge made of them; tests/models/knowledge has small files"
)

OTHERS = "needs games of a language model in Inspect; tests/apps/text_agents has logs"

RAY = "needs the nodes of a Ray cluster; tests/studies starts one on this machine"

NOT_RUN = {
    "build-graph reactions.json": "needs a published split; tests/cli/test_graph_commands.py has one",
    "books --fetch": NETWORK,
    "evaluate-links models/theirs": NETWORK,
    "encode": MODEL,
    "elicit": MODEL,
    "train-recipes graphs/la2 --features vectors/": MODEL,
    "bench run craft-8-lite --out submission --name": MODEL,
    "bench run craft-8-lite --out submission --weights tuned/model.safetensors": MODEL,
    "import-knowledge graphs/la2 --wordnet": WORDNET,
    "import-knowledge graphs/mine --wordnet": WORDNET,
    "import-knowledge graphs/mine --conceptnet": WORDNET,
    "train-complex graphs/mine --with": WORDNET,
    "bench run craft-8-lite --player inspect:": OTHERS,
    "explore graphs/everyday --model models/everyday-recipes --model": SERVER,
    "mcp": SERVER,
    "serve openenv": SERVER,
    "people serve": SERVER,
    "people summary": "needs a study with people's answers; tests/apps/people has one",
    "play": "waits for keys; tests/cli plays",
    "score models/la2-recipes": "its labels are of Little Alchemy 2, which has no licence",
    "reproduce embeddings": "takes hours; the study of the page is run in its place",
    "reproduce all": "takes hours",
    "reproduce study.toml --out results --engine ray": RAY,
}
"""Beginnings of the how-to pages' commands that no test runs as printed, and why."""

BOOKS_IN_PLACE = {
    "everyday": "kitchen",
    "little-alchemy-2": str(ROOT / "examples/my-book.csv"),
}
"""Small books in place of the printed ones."""

SMALLER = {
    "train-agent": {"--steps": "256", "--eval-every": "0"},
    "train-complex": {"--dim": "4", "--epochs": "1"},
    "train-links": {"--dim": "4", "--epochs": "1"},
    "train-recipes": {"--folds": "3"},
    "discover": {"--attempts": "20", "--runs": "1"},
    "chats": {"--tasks": "5"},
}
"""Options that make a command short, by its name."""


def reason_not_to_run(line):
    """Return why a command is not run; None for one that is run."""
    text = " ".join(line)
    starts = [start for start in NOT_RUN if f"{text} ".startswith(f"{start} ")]
    starts += [start for start in NOT_RUN if start.endswith((":", "/")) and text.startswith(start)]
    return NOT_RUN[starts[0]] if starts else None


def shortened(line):
    """Return a command's words with small books and short trainings."""
    words = [BOOKS_IN_PLACE.get(word, word) for word in line]
    for option, value in SMALLER.get(words[0], {}).items():
        if option in words:
            words[words.index(option) + 1] = value
        else:
            words += [option, value]
    if words[0] == "evaluate-agent" and words[1].startswith("--"):
        words.insert(1, "kitchen")  # in place of the default book
    return words


COMMANDS = {page: [line for printed_on, line in PRINTED if printed_on == page] for page in HOW_TO}
"""Commands of the how-to pages."""


@pytest.mark.parametrize("start", NOT_RUN)
def test_a_reason_not_to_run_belongs_to_a_printed_command(start):
    texts = [" ".join(line) for lines in COMMANDS.values() for line in lines]
    assert any(text.startswith(start) for text in texts)


@pytest.fixture(scope="module")
def wide_world(world, tmp_path_factory):
    """A folder with everything that commands of the how-to pages read and do not make."""
    home = tmp_path_factory.mktemp("wide") / "world"
    shutil.copytree(world, home)
    mine = ROOT / "examples/my-book.csv"
    commands = (
        f"build-graph kitchen --out {home}/graphs/kitchen",
        f"build-graph {mine} --out {home}/graphs/la2",
        f"train-recipes {home}/graphs/everyday --folds 3 --out {home}/models/everyday-recipes --quiet",
    )
    for command in commands:
        assert main(command.split()) == 0
    shutil.copy(mine, home / "recipes.csv")
    shutil.copy(mine, home / "large.csv")
    (home / "triples.tsv").write_text("wheat\tgoes_with\tflour\nflour\tgoes_with\tbread\n")
    study = re.search(r"^```toml\n(.*?)^```", (ROOT / "docs/studies.md").read_text(), re.S | re.M)[
        1
    ]
    for printed, small in (
        ("seeds = 3", "seeds = 1"),
        ("steps = 300_000", "steps = 256"),
        ('"everyday"', '"kitchen"'),
    ):
        assert printed in study
        study = study.replace(printed, small)
    (home / "mine.toml").write_text(study)
    with zipfile.ZipFile(ROOT / "docs/results.zip") as results:
        results.extract("knowledge-little-alchemy-2.json", home)  # a page shows it
    return home


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in HOW_TO if COMMANDS[page]])
def test_the_commands_of_a_how_to_page_run(page, wide_world, tmp_path, monkeypatch, capsys):
    shutil.copytree(wide_world, tmp_path / "world")
    monkeypatch.chdir(tmp_path / "world")
    for line in COMMANDS[page]:
        if reason_not_to_run(line) is not None:
            continue
        words = shortened(line)
        if "--out" in words:
            out = Path(words[words.index("--out") + 1])
            # A page shows alternatives with one output.
            if out.is_dir() and words[0] != "reproduce":
                shutil.rmtree(out)
            elif out.is_file():
                words.append("--force")
        if "--accept" in words:
            # The page's reader ticks a suggestion before.
            table = Path(words[words.index("--accept") + 1])
            heading, first, *others = table.read_text().splitlines()
            table.write_text("\n".join([heading, f"{first}x", *others]))
        code = main(words)
        shown = capsys.readouterr()
        # 1 is the answer of a check that finds a problem in the book.
        assert code == 0 or (code == 1 and words[0] == "check-book"), (words, shown.err)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in EXAMPLES],
)
def test_an_example_runs(name, tmp_path, monkeypatch, capsys):
    if name == "stable_baselines":
        pytest.importorskip("sb3_contrib", reason="needs the extra interop")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("wordcraft_kg.agents.players.PLAYERS", {})
    monkeypatch.setattr("sys.argv", [name, *SHORT.get(name, ())])
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


FRONT_PAGE = runpy.run_path(str(ROOT / "docs/front_page.py"))


@pytest.mark.parametrize("address", ["", "https://example.org/wordcraft-kg"])
def test_the_repository_address_is_set_once_and_followed_by_package_and_citation(address):
    texts = tuple((ROOT / name).read_text() for name in ("pyproject.toml", "CITATION.cff"))
    assert FRONT_PAGE["with_address"](*texts, FRONT_PAGE["repository"]()) == texts
    project, citation = FRONT_PAGE["with_address"](*texts, address)
    urls = tomllib.loads(project)["project"].get("urls", {})
    assert urls == ({"Repository": address} if address else {})
    assert yaml.safe_load(citation).get("repository-code", "") == address
    assert FRONT_PAGE["with_address"](project, citation, "") == texts


def test_each_goal_of_the_landing_page_is_made_by_one_pair_of_its_table():
    tasks = FRONT_PAGE["front_tasks"]()
    assert len(tasks) == 4
    for task in tasks:
        assert len(task["table"]) == len(task["icons"]) == 3
        assert sum(task["goal"] in results for results in task["made"].values()) == 1, task


TEXTS = [
    (
        lambda: wk.open_book("half.csv"),
        "RecipeFileError: half.csv, line 2: 'flour' is the only ingredient, in a book of pairs. "
        "Write it twice, or build the graph with `single_ingredient` self (which reads flour + "
        "flour), alone (a recipe of one ingredient), or the name of what it is combined with. If it "
        "is no ingredient, name the right columns with `columns`.",
    ),
    (
        lambda: wk.SplitConfig("by-goals"),
        "NotRegisteredError: `kind` 'by-goals': expected one of by-recipe, by-recipe-plain, by-slot, "
        "by-goal, by-kind, none. Did you mean 'by-goal'? Name the file that has it with --plugin (in "
        "Python load_plugin), or install its package.",
    ),
    (
        lambda: wk.make_split(wk.RecipeGraph.from_recipes([("a", "b", "c")]), wk.SplitConfig()),
        "SplitError: the test part of a by-recipe split of 1 recipe in 1 group is empty; choose "
        "another `train_ratio` or `valid_ratio`, or `kind` none for the full graph only.",
    ),
    (
        lambda: wk.open_graph("damaged"),
        "ArtefactError: damaged/graph.json is damaged: Input data was truncated. Make it again, or "
        "restore a copy.",
    ),
    (
        lambda: export_graph(wk.open_graph("kitchen"), "owl", Path("graph.owl")),
        "ConfigError: `format` 'owl': expected one of tsv, graphml, nt, parquet, csv, json, hif, sentences.",
    ),
    (
        lambda: WordCraftEnv("kitchen", distractors=2),
        "UnknownSettingError: unexpected keyword argument 'distractors'; expected one of part, "
        "depth, num_distractors, max_attempts, reward, distractor_weighting, pays_held_out, "
        "num_tasks, task_seed. Did you mean 'num_distractors', 'distractor_weighting'?",
    ),
    (
        lambda: wk.ComplExConfig(dim=1.5),
        "ConfigError: `dim` 1.5: expected a whole number, 1 or more.",
    ),
    (
        lambda: wk.PolicyConfig(mixing="fre"),
        "ConfigError: `mixing` 'fre': expected one of softmax, free, residual. Did you mean 'free'?",
    ),
    (
        lambda: wk.load_scorer("model", graph=wk.open_graph("paper-examples").graph),
        "GraphMismatchError: model was trained on graph 43fe37e2e912 (80 entities) but "
        "'paper-examples' is 8e9614822341 (93). Train on this graph, or use the training graph.",
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, opened_kitchen):
    """A folder with a book, a damaged graph folder and an untrained model."""
    home = tmp_path_factory.mktemp("home")
    write_graph_folder(home / "damaged", wk.open_book("kitchen"), opened_kitchen.split)
    (home / "damaged/graph.json").write_text("{")
    (home / "half.csv").write_text("ingredient_a,ingredient_b,result\nflour,,dough\n")
    scorer = FrequencyScorer(opened_kitchen.graph, opened_kitchen.split.partial)
    wk.save_scorer(home / "model", scorer, opened_kitchen, kg="partial")
    return home


@pytest.mark.parametrize(("call", "text"), TEXTS)
def test_an_error_says_what_was_found_what_was_expected_and_what_to_do(
    call, text, folder, monkeypatch
):
    monkeypatch.chdir(folder)
    with pytest.raises(WordCraftKGError) as raised:
        call()
    assert f"{raised.value.kind}: {raised.value}" == text


DATA = ROOT / "data/everyday"

MAKER = runpy.run_path(str(ROOT / "data/make_everyday.py"))


def rows_of(name):
    with (DATA / name).open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_generated_files_are_those_of_the_book(monkeypatch):
    monkeypatch.setattr("sys.argv", ["make_everyday.py", "--check"])
    assert MAKER["main"]() == 0
    kinds = open_book("everyday").kinds
    recipes = {
        Recipe.of(row["ingredient_a"], row["ingredient_b"], row["result"]): row
        for row in rows_of("recipes.csv")
    }
    assert {recipe: row["kind"] for recipe, row in recipes.items()} == kinds


@pytest.mark.slow
def test_croissant_metadata_are_valid_and_their_records_can_be_read():
    dataset = mlcroissant.Dataset(str(DATA / "croissant.json"))
    assert not dataset.metadata.issues.errors
    records = list(dataset.records("recipes"))
    assert len(records) == len(open_book("everyday").recipes)
    assert {key.split("/")[-1] for key in records[0]} == set(rows_of("recipes.csv")[0])


def test_every_thing_has_a_category_and_nearly_every_one_a_sense():
    rows = rows_of("entities.csv")
    assert tuple(row["entity"] for row in rows) == open_book("everyday").entities
    assert sum(not row["wordnet"] for row in rows) == 5


def test_judged_answers_are_not_in_the_book():
    graph = RecipeGraph.from_book(open_book("everyday"))
    rows = rows_of("judged.csv")
    for row in rows:
        pair = row["ingredient_a"], row["ingredient_b"]
        assert len(graph.results(*pair))
        assert row["answer"] not in graph.labels(graph.results(*pair))
    assert len({(row["ingredient_a"], row["ingredient_b"]) for row in rows}) <= 300


def test_the_canary_stands_in_the_book_and_its_datasheet():
    book = (ROOT / "wordcraft_kg/graphs/books/everyday.csv").read_text()
    canary = next(line for line in book.splitlines() if "canary" in line).split()[2]
    assert canary in (DATA / "README.md").read_text()
