"""Own ideas in a file: from training to a comparison, and nothing runs that the user did not name."""

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    SplitConfig,
    TaskConfig,
    WordCraftConfig,
    World,
    load_plugin,
    load_policy,
    make_split,
    open_agent,
    open_book,
    open_graph,
    plugins,
    save_policy,
    train_agent,
    write_graph_folder,
)
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.base import ConfigError, NotRegisteredError, registry, sha256_of
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.graphs.splits import SPLITS
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.runs.record import read_run
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.study import Study, parse_study

EXAMPLES = Path(__file__).parents[1] / "examples" / "plugins"
FILES = {name: EXAMPLES / f"{name}.py" for name in ("network", "letters", "haste", "initials")}


pytestmark = pytest.mark.usefixtures("forget_plugins")


def config_on(graph):
    """Settings of an agent with an own network, source and reward."""
    tasks = TaskConfig(reward="haste", distractors=2)
    policy = PolicyConfig("bilinear", use="letters")
    return AgentConfig(graph, None, tasks, policy, ImpalaConfig(steps=512, eval_every=0))


@pytest.fixture
def folder(forget_plugins, tmp_path):
    """A run with all four, whose plugins are forgotten afterwards."""
    for file in FILES.values():
        load_plugin(file)
    split = make_split(open_graph("kitchen").graph, SplitConfig("by-initial", seed=1))
    write_graph_folder(tmp_path / "graph", open_book("kitchen"), split)
    trained = train_agent(config_on(str(tmp_path / "graph")), tmp_path / "run")
    forget_plugins()
    return trained.folder


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_an_own_idea_has_at_most_25_lines(file):
    assert len(file.read_text().splitlines()) <= 25


def test_a_run_records_its_plugins_and_opens_with_them_alone(folder, tmp_path):
    hashes = {file.name: sha256_of(file) for file in FILES.values()}
    assert read_run(folder).plugins == hashes
    asked = ".*".join(f"'{name}' with SHA-256 {hashes[name]}" for name in read_run(folder).plugins)
    for open_it in (open_agent, load_policy):
        with pytest.raises(NotRegisteredError, match=f"{asked}.*--plugin network.py --plugin"):
            open_it(folder)
    for file in FILES.values():
        load_plugin(file)
    agent = open_agent(folder)
    assert list(agent.policy.sources) == ["letters"]
    copy = load_policy(save_policy(tmp_path / "copy", agent.policy))
    assert copy.act("bread", ["flour", "water"]) == agent.policy.act("bread", ["flour", "water"])
    assert read_run(tmp_path / "copy").plugins == {
        name: hashes[name] for name in ("network.py", "letters.py")
    }
    assert Explored.open(str(tmp_path / "graph"), runs=[folder]).runs


def test_a_changed_plugin_is_refused_with_both_hashes(folder, put):
    changed = put(FILES["network"].read_text() + "\n# changed\n", "network.py")
    load_plugin(changed)
    with pytest.raises(
        NotRegisteredError, match=f"{sha256_of(FILES['network'])}.*{sha256_of(changed)}"
    ):
        open_agent(folder)


def test_a_graph_folder_asks_for_the_plugin_of_its_split(folder):
    with pytest.raises(NotRegisteredError, match=r"'initials.py' with SHA-256"):
        open_graph(folder.parent / "graph")


def test_commands_take_plugins_before_and_after_their_name(run, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = [word for file in FILES.values() for word in ("--plugin", file)]
    assert run(*options, "explain", folder, "--episodes", 1).out.count("letters") > 1
    assert run("compare", folder, *options, "--out", "c").code == 0
    player = f"--plugin={EXAMPLES / 'longest.py'}"
    few = ("--distractors", 1, "--distractor-seeds", 1)
    assert "longest names" in run("evaluate-agent", "kitchen", *few, player).out


@pytest.mark.parametrize("where", ["before", "after"])
def test_without_its_plugin_a_command_says_which_one_is_needed(refused, folder, where):
    words = ["explain", folder]
    other = ["--plugin", FILES["haste"]]
    command = other + words if where == "before" else words + other
    refused(*command, says="needs the plugin 'network.py'")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 / 0\n", "line 1 cannot be run (ZeroDivisionError"),
        ("def broken(:\n", "cannot be run (SyntaxError"),
        (
            "from wordcraft_kg.plugins import reward\nreward('sparse')(print)\n",
            "'sparse' is built in",
        ),
        ("from wordcraft_kg.plugins import source\nsource('plan')(print)\n", "'plan' is built in"),
        ("from wordcraft_kg.plugins import policy\npolicy('mlp')(print)\n", "'mlp' is built in"),
        ("from wordcraft_kg.plugins import player\nplayer('random')(print)\n", "is built in"),
        ("from wordcraft_kg.plugins import source\nsource('a,b')(print)\n", "registers 'a,b'"),
        (
            "from wordcraft_kg.plugins import policy\n@policy('mine')\nclass Mine:\n"
            "    def __init__(self):\n        pass\n",
            "'mine' cannot be called with (dim): too many positional arguments",
        ),
        ("from wordcraft_kg.plugins import reward\nreward('mine')(lambda step: 1)\n", "(before, "),
        ("import sys\nsys.exit(0)\n", "line 2 cannot be run (SystemExit"),
        (None, "no such file"),
    ],
)
def test_a_faulty_plugin_is_refused_without_a_traceback(refused, tmp_path, text, says):
    file = tmp_path / "mine.py"
    if text is not None:
        file.write_text(text)
    refused("books", "--plugin", file, says=says)


def test_a_plugin_without_a_file_is_no_folder(refused):
    refused("books", "--plugin", says="plugin '': no such file")


NETWORK = """
import torch
from torch import nn
from wordcraft_kg.plugins import policy

@policy("mine")
class Mine(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.layer = nn.Linear(dim, 1)
        self.scale = torch.full((), 2.0)
        {extra}

    def forward(self, states, vectors):
        logits = self.scale * self.layer(vectors[states.table])[..., 0]
        value = self.layer(vectors[states.goal])
        return {result}
"""
FAULTS = {
    "reward": """
from wordcraft_kg.plugins import reward

@reward("mine")
def mine(before, after, step):
    return {result}
""",
    "split": """
from wordcraft_kg.plugins import split

@split("mine")
def mine(graph):
    return {result}
""",
    "use": """
from wordcraft_kg.plugins import source

@source("mine")
def mine(labels):
    return {result}
""",
}


@pytest.mark.parametrize(
    ("setting", "result", "says"),
    [
        ("reward", "1.0", "--reward mine gives float of shape none"),
        ("reward", "step.reward[:3]", "of shape (3,)"),
        ("reward", "step.reward / 0", "--reward mine gives NaN or infinity"),
        ("reward", "step.nothing", "plugin 'mine.py', line 6 cannot be run (AttributeError"),
        ("split", "[0.5] * graph.num_recipes", "a whole number for each recipe"),
        ("split", "[1, 2, 3]", "gives groups of shape (3,)"),
        ("use", "['a']", "expected (80, 80), by goal and entity"),
    ],
)
def test_a_part_that_returns_something_else_is_refused(
    refused, put, tmp_path, setting, result, says
):
    file = put(FAULTS[setting].format(result=result), "mine.py")
    command = ["train-agent", "kitchen", "--steps", 64, f"--{setting}", "mine"]
    if setting == "split":
        command = ["build-graph", "kitchen", "--split", "mine"]
    refused(*command, "--out", tmp_path / "out", "--plugin", file, says=says)


@pytest.mark.parametrize(
    ("extra", "result", "says"),
    [
        ("", "logits, value", r"expected logits and values, \[\(1, 2\), \(1,\)\]"),
        ("", "logits", "expected logits and values"),
        ("self.drop = nn.Dropout()", "logits, value[:, 0]", "has a Dropout"),
        ("self.norm = nn.BatchNorm1d(dim)", "logits, value[:, 0]", "has a BatchNorm1d"),
        ("del self.layer", "logits, value[:, 0]", "a module of torch with parameters"),
    ],
)
def test_a_network_of_another_form_is_refused(put, extra, result, says):
    file = put(NETWORK.format(extra=extra, result=result), "mine.py")
    load_plugin(file)
    graph = open_graph("kitchen").graph
    with pytest.raises(ConfigError, match=says):
        make_policy(PolicyConfig("mine"), graph, 2)[0].act("bread", ["flour", "water"])


def test_tensors_of_a_network_that_are_no_buffers_survive_its_folder(put, tmp_path):
    file = put(NETWORK.format(extra="", result="logits, value[:, 0]"), "mine.py")
    load_plugin(file)
    policy, _ = make_policy(PolicyConfig("mine"), open_graph("kitchen").graph, 2)
    copy = load_policy(save_policy(tmp_path / "copy", policy))
    tasks = [(goal, ["flour", "water", "egg"]) for goal in ("bread", "dough", "cake")]
    assert [copy.act(*task) for task in tasks] == [policy.act(*task) for task in tasks]


def test_files_of_one_name_are_refused_because_records_could_not_tell_them_apart(tmp_path):
    load_plugin(FILES["haste"])
    (tmp_path / "haste.py").write_text("")
    with pytest.raises(ConfigError, match="Rename one"):
        load_plugin(tmp_path / "haste.py")


def test_a_worker_refuses_a_plugin_that_was_changed_meanwhile(put, forget_plugins):
    file = put("", "mine.py")
    plugin = load_plugin(file)
    forget_plugins()
    registry.load_again([plugin])
    file.write_text("# changed")
    with pytest.raises(ConfigError, match="was changed while the study ran"):
        registry.load_again([plugin])


def test_nothing_that_a_stranger_gives_loads_a_plugin(run, folder, put, tmp_path):
    evil = put(f"open({str(tmp_path / 'ran')!r}, 'w')\n", "evil.py")
    (tmp_path / "c.toml").write_text(f"[explain]\nplugin = {json.dumps(str(evil))}\n")
    failed = run("explain", folder, "--config", tmp_path / "c.toml")
    assert (failed.code, "names no program to run" in failed.err) == (1, True)
    with pytest.raises(ConfigError, match="unknown setting"):
        parse_study(f"title = 'x'\n[settings]\nplugin = '{evil}'\n[variants.a]\n", "study")
    # A run folder and a graph folder that name the file, as a plugin and among the settings.
    for path, key in ((folder / "run.json", "plugins"), (tmp_path / "graph/split.json", "plugins")):
        content = json.loads(path.read_text())
        content[key] = {str(evil): sha256_of(evil)}
        path.write_text(json.dumps(content))
    config = folder / "config.toml"
    config.write_text(config.read_text() + f"plugin = {json.dumps(str(evil))}\n")
    for words in (("explain", folder), ("describe", tmp_path / "graph")):
        assert run(*words).code == 1
    assert not (tmp_path / "ran").exists()


def test_a_corrected_file_takes_the_place_of_the_earlier_one(tmp_path):
    file = tmp_path / "mine.py"
    for factor in (2, 3):
        file.write_text(
            "from wordcraft_kg.plugins import reward\n\n\n@reward('more')\n"
            f"def more(before, after, step):\n    return {factor} * step.reward\n"
        )
        assert load_plugin(file).sha256 == load_plugin(file).sha256 == sha256_of(file)
    assert registry.loaded_plugins() == (load_plugin(file),)
    engine = BatchEngine(World.open("kitchen", WordCraftConfig(reward="more")), 512)
    state = engine.reset(0)
    rewards = []
    for _ in range(10):
        state, step = engine.step(state, state.random_actions(np.full(512, 0.3)))
        rewards += step.reward[step.outcome == GOAL].tolist()
    assert set(rewards) == {3.0}


def test_a_study_knows_the_content_of_a_plugin(monkeypatch):
    load_plugin(FILES["haste"])
    values = {"book": "kitchen", "steps": 64, "reward": "haste"}
    study = Study("An own reward", {"a": {}}, seeds=1, settings=values)
    (address,) = make_plan(study, "own").runs
    assert make_plan(study, "own").tasks[address].settings["plugins"] == [sha256_of(FILES["haste"])]


def test_a_package_cannot_replace_what_is_built_in(monkeypatch):
    def load(self):
        plugins.split("by-goal")(len)

    monkeypatch.setattr(EntryPoint, "load", load)
    point = EntryPoint("other", "other_package", registry.PLUGINS)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [point] * (group == registry.PLUGINS)
    )
    monkeypatch.setattr(SPLITS, "_points", None)
    with pytest.raises(ConfigError, match=r"'other_package': 'by-goal' is built in.*uninstall"):
        "mine" in SPLITS  # noqa: B015


def test_one_hot_vectors_of_a_network_are_refused():
    load_plugin(FILES["network"])
    with pytest.raises(ConfigError, match="takes no one-hot vectors"):
        make_policy(PolicyConfig("bilinear", features="one-hot"), open_graph("kitchen").graph, 2)


@pytest.mark.slow
def test_workers_of_a_study_load_the_plugins(run, put, tmp_path):
    study = put(
        "title = 'Own'\nseeds = 1\n[settings]\nbook = 'kitchen'\nsteps = 256\n"
        "[variants.theirs]\n[variants.mine]\npolicy = 'bilinear'\nreward = 'haste'\n",
        "study.toml",
    )
    options = [word for file in FILES.values() for word in ("--plugin", file)]
    done = run("reproduce", study, *options, "--jobs", 2, "--out", tmp_path / "results", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["studies"]["study"]["failed"] == {}


@pytest.mark.slow
def test_an_own_network_learns(tmp_path):
    load_plugin(FILES["network"])
    config = AgentConfig(
        open_graph("kitchen"),
        tasks=TaskConfig(distractors=2),
        policy=PolicyConfig("bilinear"),
        trainer=ImpalaConfig(steps=100_000, eval_every=0),
    )
    summary = train_agent(config, tmp_path / "run").summary
    # Chance is .2 on these tables.
    assert summary.success["train"].mean > 0.6


def test_functions_take_an_opened_graph(tmp_path):
    graph = open_graph("kitchen").graph
    opened = open_graph(graph, SplitConfig("by-goal", seed=3))
    trainer = ImpalaConfig(steps=64, eval_every=0)
    run = train_agent(AgentConfig(opened, trainer=trainer), tmp_path / "run").folder
    assert open_agent(run, opened).opened is opened
    with pytest.raises(ConfigError, match="`graph` 5"):
        open_graph(5)
