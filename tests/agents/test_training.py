"""The run folder of an agent: what it holds, and what a resumed run ends with; see tests/runs for
its life cycle."""

import json
import re
import shutil
import signal
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
import torch
from helpers import lines_of, resume, split_of, with_other_results, write_graph, write_opened
from safetensors.torch import load_file
from short_fits import short_fits

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    TaskConfig,
    WordCraftConfig,
    load_policy,
    open_agent,
    open_graph,
    train_agent,
)
from wordcraft_kg.agents import agent_training
from wordcraft_kg.agents.agent_config import TABLES
from wordcraft_kg.agents.agent_training import AgentTraining, _warn_of_self_pairs
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.plan_weights import fit_plan_weights
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    TrainingError,
    sha256_of,
)
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.link_training import train_links
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_training import train_recipes


@pytest.fixture
def interrupted(config, tmp_path, monkeypatch):
    """Train into a folder until an update is done, and then press Ctrl-C or raise an error."""
    step = Impala.update

    def interrupted(update=50, error=None, config=config, **options):
        def wrapped(self):
            step(self)
            if self.update_number == update:
                if error is not None:
                    raise error
                signal.raise_signal(signal.SIGINT)

        with monkeypatch.context() as patch:
            patch.setattr(Impala, "update", wrapped)
            with pytest.raises(error or KeyboardInterrupt):
                train_agent(config, tmp_path / "run", **options)
        return tmp_path / "run"

    return interrupted


def assert_same_training(one, other):
    """The same weights, and the same metrics except those that depend on the clock."""
    metrics = []
    for folder in (one, other):
        rows = lines_of(folder / "metrics.jsonl")
        metrics.append(
            [
                {key: row[key] for key in row if key not in ("seconds", "steps_per_second")}
                for row in rows
            ]
        )
    assert metrics[0] == metrics[1]
    assert sha256_of(one / "policy.safetensors") == sha256_of(other / "policy.safetensors")


def test_a_run_folder_holds_what_its_description_says(opened, done):
    tables = {"constants.safetensors", "policy.json", "policy.safetensors"}
    records = {
        "README.md",
        "config.toml",
        "episodes.jsonl",
        "evaluation.json",
        "metrics.jsonl",
        "run.json",
    }
    assert {path.name for path in done.iterdir()} == tables | records
    run = json.loads((done / "run.json").read_text())
    assert (run["kind"], run["status"], run["seed"]) == ("train-agent", "done", 0)
    assert (run["inputs"]["graph"], run["inputs"]["split"]) == (
        opened.graph.hash,
        opened.split.hash,
    )
    assert all(sha256_of(done / name) == value for name, value in run["outputs"].items())
    rows = lines_of(done / "metrics.jsonl")
    assert [row["step"] for row in rows] == [0, *range(160, 1_601, 160)]
    assert [row["step"] for row in rows if "test_success" in row] == [0, 800, 1_600]
    assert {"success", "return", "loss", "entropy", "ratio_mean", "train_success"} <= rows[
        -1
    ].keys()
    assert rows[-1]["ratio_mean"] == pytest.approx(1, abs=1e-5)
    summary = open_agent(done).evaluation
    assert (summary.steps, summary.success["test"].mean) == (1_600, rows[-1]["test_success"])


def test_the_differing_settings_are_those_that_were_changed(config, done):
    changed = {
        "graph",
        "distractors",
        "steps",
        "batch_size",
        "log_every",
        "eval_every",
        "checkpoint_every",
    }
    assert config.differing().keys() == changed
    assert AgentConfig.read(done) == config
    assert replace(config, policy=PolicyConfig(key_size=20)).differing().keys() == {
        *changed,
        "key_size",
    }


def test_an_interrupted_run_is_opened_at_its_checkpoint(interrupted):
    folder = interrupted(30)
    assert open_agent(folder).checkpoint == "step 480"
    with pytest.raises(ArtefactError, match=r"interrupted, not done.*Repeat"):
        load_policy(folder)


def test_metrics_after_the_checkpoint_are_cut_off_when_a_run_goes_on(done, interrupted):
    # As if the power had gone: the checkpoint of update 40 is there, the metrics of update 50 too.
    folder = interrupted(55, RuntimeError)
    with (folder / "metrics.jsonl").open("ab") as file:
        file.write(b'{"step": 88')
    resume(folder)
    assert_same_training(folder, done)


def test_a_loss_that_is_not_finite_keeps_the_last_checkpoint(config, tmp_path, monkeypatch):
    """A loss that is not finite stops the run and keeps the last good checkpoint."""
    collect = Impala._collect

    def poisoned(self, weights):
        unroll = collect(self, weights)
        if self.update_number == 45:
            unroll.rewards[0, 0] = float("nan")
        return unroll

    monkeypatch.setattr(Impala, "_collect", poisoned)
    with pytest.raises(
        TrainingError, match=r"update 46 \(environment steps 720 to 736\).*step 640 is safe"
    ):
        train_agent(config, tmp_path / "run")
    agent = open_agent(tmp_path / "run")
    assert (agent.run.status, agent.checkpoint) == ("failed", "step 640")
    assert all(torch.isfinite(parameter).all() for parameter in agent.policy.parameters())


@pytest.mark.slow
def test_training_leaves_global_generators_and_thread_counts_as_they_were(config, done, tmp_path):
    def states():
        return (
            torch.get_rng_state().tolist(),
            np.random.get_state()[1].tolist(),  # noqa: NPY002
            torch.get_num_threads(),
        )

    torch.manual_seed(7)
    before = states()
    train_agent(config, tmp_path / "run")
    assert states() == before
    assert_same_training(tmp_path / "run", done)
    train_agent(replace(config, trainer=replace(config.trainer, seed=1)), tmp_path / "other")
    assert sha256_of(tmp_path / "other/policy.safetensors") != sha256_of(
        done / "policy.safetensors"
    )


def test_without_held_out_recipes_only_train_tasks_are_evaluated(config, tmp_path):
    graph = str(write_graph(tmp_path / "graph", kind="none"))
    short = replace(config.trainer, steps=160, eval_every=160)
    trained = train_agent(replace(config, graph=graph, trainer=short), tmp_path / "run")
    assert list(trained.summary.success) == ["train"]


def test_settings_that_were_changed_after_the_start_are_refused(config, interrupted):
    path = interrupted() / "policy.json"
    path.write_text(path.read_text().replace("residual", "softmax"))
    for use in (open_agent, lambda folder: train_agent(config, folder)):
        with pytest.raises(ArtefactError, match=r"policy\.json is damaged or was changed"):
            use(path.parent)


@pytest.mark.parametrize(
    "change",
    [
        lambda policy: {"entities": policy["entities"][::-1]},
        lambda policy: {"graph": "0" * len(policy["graph"])},
    ],
    ids=["other entities", "another graph"],
)
def test_a_policy_of_other_entities_than_the_run_is_refused(done, tmp_path, change):
    folder = tmp_path / "forged"
    shutil.copytree(done, folder)
    path = folder / "policy.json"
    policy = json.loads(path.read_text())
    path.write_text(json.dumps(policy | change(policy)))
    run = json.loads((folder / "run.json").read_text())
    # The forger also records the hash of the changed file.
    run["outputs"]["policy.json"] = sha256_of(path)
    (folder / "run.json").write_text(json.dumps(run))
    with pytest.raises(GraphMismatchError, match="has other entities than"):
        open_agent(folder)


SELF_PAIRS = "a,a,c\nb,b,d\na,b,e\n"


@pytest.mark.parametrize(
    ("pairs", "self_edges", "warns"),
    [(SELF_PAIRS, "observed", True), (SELF_PAIRS, "keep", False), ("a,b,c\n", "observed", False)],
)
def test_self_pairs_with_observed_self_edges_give_a_warning(
    config, put, caplog, pairs, self_edges, warns
):
    """A book of self pairs is warned about where only observed self edges are kept."""
    book = put("ingredient_a,ingredient_b,result\n" + pairs)
    config = replace(config, scorer="models/mine", policy=PolicyConfig(self_edges=self_edges))
    _warn_of_self_pairs(open_graph(book).graph, config)
    assert ("67 % of pairs in book combine an entity with itself" in caplog.text) == warns


NAN, INF = float("nan"), float("inf")

COUNTS = ("steps", "batch_size", "unroll", "threads", "log_every", "checkpoint_every")


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        *((name, value) for name in COUNTS for value in (0, -5)),
        *((name, -1) for name in ("policy_lag", "seed", "eval_every")),
        *(
            (name, value)
            for name in ("learning_rate", "rms_epsilon", "clip")
            for value in (0.0, -1.0, NAN, INF)
        ),
        *(
            (name, value)
            for name in ("entropy_cost", "baseline_cost")
            for value in (-0.1, NAN, INF)
        ),
        *((name, value) for name in ("discount", "rms_decay") for value in (-0.1, 1.1, NAN)),
        ("device", "gpu"),
        ("device", ""),
    ],
)
def test_a_setting_out_of_range_is_an_error_that_names_it_and_its_value(setting, value):
    with pytest.raises(ConfigError, match="^" + re.escape(f"`{setting}` {value!r}: expected ")):
        ImpalaConfig(**{setting: value})


def test_the_preset_paper_has_the_papers_values():
    config = ImpalaConfig(preset="paper")
    assert (config.steps, config.batch_size, config.unroll, config.discount) == (
        3_000_000,
        128,
        2,
        0.99,
    )
    assert (config.learning_rate, config.rms_epsilon, config.entropy_cost) == (0.001, 0.01, 0.01)
    # Not in the paper but in its released code.
    assert (config.rms_decay, config.clip, config.baseline_cost) == (0.99, 40.0, 0.5)
    assert config.policy_lag == 0
    agent = AgentConfig("kitchen", "models/x", TaskConfig(depth=2), trainer=config)
    assert (agent.trainer.unroll, agent.policy.scale) == (2, "ranks")
    assert (agent.policy.policy, agent.policy.mixing) == ("attention", "free")
    assert agent.policy.sees_attempts is False
    assert config.memory_cost == 0
    agent.check_preset()
    # Its simple baseline, too.
    AgentConfig("kitchen", policy=PolicyConfig("mlp"), trainer=config).check_preset()


@pytest.mark.parametrize(
    ("tasks", "unroll", "sees_attempts", "scale"),
    [
        (TaskConfig(), 2, False, "ranks"),
        (TaskConfig(max_attempts=2), 4, True, "none"),
        (TaskConfig(depth=3), 6, True, "none"),
    ],
)
def test_the_recommended_preset_follows_the_number_of_attempts(tasks, unroll, sees_attempts, scale):
    config = AgentConfig("kitchen", "models/x", tasks)
    assert (config.trainer.preset, config.trainer.unroll) == ("recommended", unroll)
    assert (config.policy.sees_attempts, config.policy.scale) == (sees_attempts, scale)
    assert (config.policy.policy, config.policy.mixing) == ("pairs", "residual")
    assert config.trainer.memory_cost > 0
    assert not {"policy", "scale", "mixing", "memory_cost"} & config.differing().keys()
    for use, residual in (("u,v", not sees_attempts), ("u,v,w", False), ("p", False)):
        policy = PolicyConfig("attention", use=use)
        knowing = AgentConfig("kitchen", "models/x", tasks, policy)
        assert knowing.policy.mixing == ("residual" if residual else "free")
        assert "mixing" not in knowing.differing()
    for settings in ({"kg_only": True}, {"mixing": "softmax"}):
        only = AgentConfig("kitchen", "models/x", tasks, PolicyConfig(**settings))
        assert only.policy.policy == "attention"
    without = AgentConfig("kitchen", tasks=tasks)
    assert (without.policy.sees_attempts, without.policy.scale) == (sees_attempts, "ranks")
    mlp = AgentConfig("kitchen", tasks=tasks, policy=PolicyConfig("mlp"))
    assert mlp.policy.sees_attempts is False
    assert mlp.differing().keys() == {"graph", "policy", *without.differing()}


def test_tables_recur_where_pairs_are_scored_and_not_in_the_papers_preset():
    def tables(use, **trainer):
        policy = PolicyConfig(use=use)
        trainer = ImpalaConfig(**trainer)
        return AgentConfig("kitchen", "models/x", policy=policy, trainer=trainer).trainer.tables

    assert (tables("u,v"), tables("u,v,w"), tables("p")) == (0, TABLES, TABLES)
    assert (tables("u,v,w", preset="paper"), tables("u,v,w", tables=0)) == (0, 0)
    assert AgentConfig("kitchen").trainer.tables == 0
    config = AgentConfig("kitchen", trainer=ImpalaConfig(batch_size=3, tables=7))
    engine = AgentTraining(config, open_graph("kitchen")).envs.engine
    # Three episodes in each of three environments: as few as hold seven tables.
    assert engine._draws.repeat == 3


def test_a_setting_that_is_given_is_kept_whatever_the_preset():
    for preset in ("recommended", "paper"):
        trainer = ImpalaConfig(preset, unroll=5, learning_rate=0.5, tables=9)
        policy = PolicyConfig(
            "attention", scale="standardise", sees_attempts=True, mixing="softmax"
        )
        config = AgentConfig("kitchen", "models/x", TaskConfig(depth=2), policy, trainer)
        assert (config.trainer.unroll, config.trainer.learning_rate) == (5, 0.5)
        assert config.trainer.tables == 9
        assert (config.policy.scale, config.policy.sees_attempts) == ("standardise", True)
        assert config.policy.mixing == "softmax"
        assert {"unroll", "learning_rate", "scale", "mixing"} <= config.differing().keys()


@pytest.mark.parametrize(
    ("policy", "trainer", "name"),
    [
        ({}, {"unroll": 4}, "unroll"),
        ({}, {"learning_rate": 0.003}, "learning_rate"),
        ({"policy": "pairs"}, {}, "policy"),
        ({}, {"memory_cost": 1.0}, "memory_cost"),
        ({"scale": "none"}, {}, "scale"),
        ({"mixing": "residual"}, {}, "mixing"),
        ({"sees_attempts": True}, {}, "sees_attempts"),
        ({"use": "p", "weigh_plans": True}, {}, "weigh_plans"),
        ({}, {"tables": 9}, "tables"),
    ],
)
def test_a_setting_that_contradicts_the_papers_preset_is_refused(policy, trainer, name, tmp_path):
    def config(preset):
        return AgentConfig(
            "kitchen",
            "models/x",
            TaskConfig(depth=2),
            PolicyConfig(**policy),
            ImpalaConfig(preset, **trainer),
        )

    config("recommended").check_preset()
    with pytest.raises(ConfigError, match=rf"`{name}` .* contradicts `preset` paper"):
        train_agent(config("paper"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_preset_or_attempts_that_do_not_exist_are_refused():
    with pytest.raises(ConfigError, match="`preset` 'papers': expected"):
        ImpalaConfig("papers")
    with pytest.raises(ConfigError, match="`sees_attempts` 'yes': expected true or false"):
        PolicyConfig(sees_attempts="yes")
    with pytest.raises(ConfigError, match="`sees_attempts` needs `policy` pairs or attention"):
        PolicyConfig("mlp", sees_attempts=True)


@pytest.mark.parametrize(("steps", "updates"), [(1, 1), (24, 1), (25, 2), (240, 10), (241, 11)])
def test_steps_are_rounded_up_to_whole_updates(steps, updates):
    config = ImpalaConfig(steps=steps, batch_size=8, unroll=3)
    assert config.steps_per_update == 24
    assert config.updates == updates


def test_the_environment_gets_all_settings_of_the_tasks():
    other = {"depth": 2, "max_attempts": 3, "reward": "official", "distractor_weighting": "uniform"}
    other |= {"pays_held_out": True}
    tasks = TaskConfig(distractors=7, **other)
    assert all(
        getattr(tasks, field.name) != getattr(TaskConfig(), field.name)
        for field in fields(TaskConfig)
    )
    assert tasks.environment("test") == WordCraftConfig(part="test", num_distractors=7, **other)
    assert tasks.environment("train", 0) == WordCraftConfig(
        part="train", num_distractors=0, **other
    )
    assert TaskConfig().environment("train") == WordCraftConfig(part="train")


KINDS = (
    "by-goal",
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("by-recipe", "by-slot")),
)


@pytest.fixture(scope="module", params=KINDS)
def graphs(request, tmp_path_factory):
    """Folders of the kitchen, and of the kitchen with other held-out results."""
    opened = split_of(open_graph("kitchen").graph, request.param)
    both = (opened, with_other_results(opened, 1))
    assert len({each.graph.hash for each in both}) == 2
    parent = tmp_path_factory.mktemp("graphs")
    return [write_opened(each, parent / str(i) / "kitchen") for i, each in enumerate(both)]


@pytest.fixture(scope="module")
def links(graphs, tmp_path_factory):
    """ComplEx on the partial graph, with folds."""
    settings = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)
    return made(
        graphs, tmp_path_factory, lambda graph, out: train_links(LinksConfig(graph, settings), out)
    )


@pytest.fixture(scope="module")
def recipes(graphs, tmp_path_factory):
    settings = RecipeScorerConfig(folds=3, features="one-hot")
    with short_fits():
        return made(
            graphs,
            tmp_path_factory,
            lambda graph, out: train_recipes(RecipesConfig(graph, settings), out),
        )


def made(graphs, tmp_path_factory, train):
    parent = tmp_path_factory.mktemp("trained")
    for i, graph in enumerate(graphs):
        train(str(graph), parent / str(i))
    return [parent / str(i) for i in range(len(graphs))]


def assert_same_tensors(folders, names):
    for name in names:
        one, other = (load_file(folder / name) for folder in folders)
        assert one.keys() == other.keys()
        for key, tensor in one.items():
            # Folds of the recipes, numbered in the book: held-out recipes have the fold -1.
            is_train = tensor >= 0 if key.endswith("of_recipe") else torch.ones_like(tensor) > 0
            in_other = other[key] >= 0 if key.endswith("of_recipe") else is_train
            assert torch.equal(tensor[is_train], other[key][in_other]), (name, key)


@pytest.mark.parametrize("kind", ["links", pytest.param("recipes", marks=pytest.mark.slow)])
def test_no_scorer_depends_on_held_out_results(request, graphs, kind):
    folders = request.getfixturevalue(kind)
    assert_same_tensors(folders, ("model.safetensors", "folds.safetensors"))
    one, other = ((folder / "calibration.json").read_bytes() for folder in folders)
    assert one == other


@pytest.mark.parametrize(
    ("scorer", "use"),
    [("links", "u,v"), pytest.param("recipes", "u,v,w,p", marks=pytest.mark.slow)],
)
def test_no_agent_depends_on_held_out_results(graphs, scorer, use, request, tmp_path, monkeypatch):
    """With p there are weights of plans, which are learned from play."""
    monkeypatch.setattr(agent_training, "MOST_TASKS", 20)
    monkeypatch.setattr(agent_training, "CURVE_TASKS", 20)
    monkeypatch.setattr(agent_training, "fit_plan_weights", partial(fit_plan_weights, tasks=100))
    folders = []
    for i, graph in enumerate(graphs):
        trainer = ImpalaConfig(steps=256, batch_size=16, tables=32, log_every=64)
        tasks = TaskConfig(depth=2, distractors=3)
        model = request.getfixturevalue(scorer)[i]
        config = AgentConfig(str(graph), str(model), tasks, PolicyConfig(use=use), trainer)
        folders.append(train_agent(config, tmp_path / str(i)).folder)
    assert_same_tensors(folders, ("policy.safetensors", "constants.safetensors"))
    logs = []
    for folder in folders:
        lines = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
        apart = ("seconds", "steps_per_second", "test_success")
        logs.append([{k: v for k, v in line.items() if k not in apart} for line in lines])
    assert logs[0] == logs[1]
