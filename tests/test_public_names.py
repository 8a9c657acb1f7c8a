"""What `from wordcraft_kg import ...` gives: names, types, and an example of each that runs."""

import doctest
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import wordcraft_kg

IN_ORDER = (
    *(
        "open_book",
        "RecipeGraph",
        "open_graph",
        "SplitConfig",
        "make_split",
        "write_graph_folder",
        "load_plugin",
        "WordCraftConfig",
        "World",
    ),
    *(
        "ComplExConfig",
        "LinkModelConfig",
        "LinksConfig",
        "train_links",
        "Tracker",
        "open_model",
        "save_scorer",
    ),
    *(
        "from_pykeen",
        "load_scorer",
        "cross_fit",
        "RecipeScorerConfig",
        "RecipesConfig",
        "train_recipes",
    ),
    *(
        "make_sources",
        "TaskConfig",
        "PolicyConfig",
        "ImpalaConfig",
        "AgentConfig",
        "train_agent",
        "open_agent",
    ),
    *("load_policy", "save_policy", "evaluate", "read_study", "Study", "run_study"),
)
"""Each example may use what those before it have written."""


def test_every_public_name_is_there_and_listed_once():
    assert sorted(wordcraft_kg.__all__) == sorted(IN_ORDER)
    assert set(dir(wordcraft_kg)) == {*IN_ORDER, "__version__"}
    assert all(getattr(wordcraft_kg, name).__name__ == name for name in IN_ORDER)
    with pytest.raises(AttributeError, match="attribute nonsense"):
        _ = wordcraft_kg.nonsense


def examples():
    names = {name: getattr(wordcraft_kg, name) for name in IN_ORDER}
    read = doctest.DocTestParser().get_doctest
    return [
        read(inspect.getdoc(value) or "", dict(names), name, None, None)
        for name, value in names.items()
    ]


def test_every_public_name_has_an_example_that_uses_it():
    for example in examples():
        code = "".join(line.source for line in example.examples)
        compile(code, example.name, "exec")
        assert code, example.name


@pytest.mark.slow
def test_the_example_of_every_public_name_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for example in examples():
        said = []
        assert runner.run(example, out=said.append).failed == 0, "".join(said)


def test_the_reference_has_every_public_name():
    page = (Path(__file__).parents[1] / "docs" / "reference.md").read_text()
    shown = re.findall(r"\]\[(.+?)\]", page)
    assert {f"wordcraft_kg.{name}" for name in IN_ORDER} <= set(shown)
    assert len(shown) == len(set(shown))


VECTOR = (
    "gym.make_vec('WordCraft-v0', num_envs=2, vectorization_mode='vector_entry_point', "
    "graph='kitchen').reset()"
)
LIGHT = {
    "import sys, wordcraft_kg": {"torch", "pykeen", "gymnasium", "pandas"},
    "import wordcraft_kg.models": {"torch", "pykeen"},
    "import gymnasium as gym; gym.make('WordCraft-v0', graph='kitchen').reset()": {
        "torch",
        "pykeen",
    },
    VECTOR: {"torch", "pykeen"},
    "from wordcraft_kg.apps.text_agents.benchmark_players import KINDS; list(KINDS)": {"torch"},
    "from wordcraft_kg.models.scorers.features import make_features as m; m('glove', ['sea'])": {
        "torch"
    },
}
"""Steps of one process, and what is not imported after each."""


@pytest.mark.slow
def test_what_only_some_need_is_imported_by_them_alone():
    code = "\n".join(f"{step}\nprint({heavy} & {{*sys.modules}})" for step, heavy in LIGHT.items())
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["set()"] * len(LIGHT)
