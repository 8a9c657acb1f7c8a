"""The agent report: numbers of the evaluation, a whole page, and no comparison of what cannot be
compared."""

import importlib.util
import itertools
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from report_helpers import Page

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    SplitConfig,
    TaskConfig,
    World,
    open_agent,
    open_graph,
    train_agent,
)
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base import ConfigError, GraphMismatchError, as_values, schema_of
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.cli.compare import rows_of_agents
from wordcraft_kg.evaluation.agent_metrics import AgentSuccess
from wordcraft_kg.evaluation.agents import AgentsView, by_success, group_agents, view_agents
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, with_letters
from wordcraft_kg.reports.agent_report import make_agent_report
from wordcraft_kg.reports.pages import GLOSSARY, render

TRAINER = ImpalaConfig(steps=640, batch_size=8, log_every=160, eval_every=320)

TASKS = TaskConfig(distractors=2)


def trained(home, runs, scorer=None):
    for name, settings in runs.items():
        train_agent(AgentConfig("kitchen", scorer, TASKS, *settings), home / name)
    return [open_agent(home / name) for name in runs]


def report_of(groups, **settings):
    return make_agent_report(view_agents(groups, **settings))


@pytest.fixture(scope="module")
def agents(tmp_path_factory):
    """Two seeds of an attention agent and one run of an mlp."""
    plain = {f"plain-{seed}": (PolicyConfig(), replace(TRAINER, seed=seed)) for seed in (0, 1)}
    return trained(
        tmp_path_factory.mktemp("runs"), {**plain, "mlp": (PolicyConfig(policy="mlp"), TRAINER)}
    )


@pytest.fixture(scope="module")
def report(agents):
    return report_of(group_agents(agents), distractor_seeds=2)


@pytest.fixture(scope="module")
def entry(report):
    """The entry of the attention agent."""
    return report.view.agents[0]


@pytest.fixture(scope="module")
def world(agents):
    return World(agents[0].opened, TASKS.environment("test"))


def test_the_table_and_the_text_begin_with_the_best_agent(agents):
    groups = group_agents(agents)
    view = view_agents(dict(reversed(groups.items())), distractor_seeds=1)
    best, other = by_success(view, view.headline)
    amount = str(view.headline)
    assert best.success[amount].mean >= other.success[amount].mean
    assert rows_of_agents(view)[0]["agent"] == by_success(view, view.distractors[0])[0].name
    page = render(make_agent_report(view))
    rows = re.findall(rf'<th scope="row">(\w+)</th><td>{amount}</td>', page)
    assert rows[:2] == [best.name, other.name]


def test_runs_that_differ_in_the_seed_are_one_agent(agents):
    groups = {
        name: [agent.name for agent in members] for name, members in group_agents(agents).items()
    }
    assert groups == {"plain": ["plain-0", "plain-1"], "mlp": ["mlp"]}


def test_the_numbers_are_those_of_the_evaluation(agents, entry):
    for amount in (1, 2, 8):
        evaluator = Evaluator(
            World(agents[0].opened, TASKS.environment("test", amount)), distractor_seeds=2
        )
        found = [evaluator(PolicyPlayer(agent.policy)) for agent in agents[:2]]
        figures = entry.success[str(amount)]
        assert figures.seeds == tuple(result.success.mean() for result in found)
        assert figures.mean == pytest.approx(np.mean(figures.seeds))
        assert figures.seed_ci == student_interval(figures.seeds)
        outcomes = entry.outcomes[str(amount)]
        assert outcomes["goal"] == pytest.approx(figures.mean)
        assert sum(outcomes.values()) == pytest.approx(1)


def test_an_mlp_is_judged_with_its_own_number_of_distractors_only(report):
    assert report.view.agents[1].success.keys() == {"2"}


def test_players_that_learn_nothing_stand_beside_the_agents(report):
    players = ("random", "fewest uses", "nearest words (minilm)", "recipe oracle")
    rows = [(row.player, row.distractors) for row in report.view.baselines]
    assert rows == list(itertools.product(players, (1, 2, 8)))
    assert all(row.by_plan <= row.success for row in report.view.baselines)


def test_slices_hold_every_task_once_and_average_to_the_whole(report, entry):
    for name in ("train_recipes", "layer"):
        rows = entry.slices[name]
        assert sum(row.tasks for row in rows) == report.view.tasks
        mean = sum(row.tasks * row.success for row in rows) / report.view.tasks
        assert mean == pytest.approx(entry.success["2"].mean)


def test_tasks_are_sliced_by_the_train_recipes_of_their_goal(agents, entry, world):
    results = world.graph.recipes[agents[0].opened.split.is_in("train"), 2].tolist()
    alone = sum(results.count(goal) == 1 for goal in world.tasks.goals.tolist())
    row = next((row for row in entry.slices["train_recipes"] if row.slice == "1"), None)
    assert (row.tasks if row else 0) == alone


def test_each_training_has_a_curve_of_each_figure_that_it_logged(agents, report, entry):
    for figure in ("loss", "entropy", "return", "grad_norm", "baseline_loss", "test_success"):
        curves = entry.training[figure]
        assert [curve.seed for curve in curves] == [0, 1]
        for agent, curve in zip(agents[:2], curves, strict=True):
            logged = [
                (row.step, row.figures[figure]) for row in agent.metrics if figure in row.figures
            ]
            assert list(curve.points) == logged
    (axes,) = report.figures["training/loss"].get_axes()
    assert len(axes.get_lines()) == len(agents)


def test_the_provenance_of_each_run_has_its_command_versions_and_hashes(agents, report, entry):
    facts = entry.provenance["plain-1"]
    run = agents[1].run
    assert facts["trained by"] == " ".join(run.argv)
    assert run.outputs["policy.safetensors"] in facts["weights"]
    assert facts["graph"] == agents[1].opened.graph.hash
    assert f"torch {run.versions['torch']}" in facts["versions"]
    page = render(report)
    assert all(
        value in page for value in (run.outputs["policy.safetensors"], run.versions["torch"])
    )


def test_it_follows_its_schema_and_is_the_same_each_time(agents, report):
    jsonschema.Draft202012Validator.check_schema(schema_of(AgentsView, "urn:x", "x"))
    jsonschema.validate(as_values(report.view), schema_of(AgentsView, "urn:x", "x"))
    again = report_of(group_agents(agents), distractor_seeds=2)
    assert again.view == report.view
    assert render(again) == render(report)


def test_the_page_is_whole_needs_no_network_and_escapes_names(agents):
    odd = replace(agents[0], name="<b>odd & name</b>")
    page = render(report_of({odd.name: [odd]}, distractor_seeds=1))
    assert (Page(page).faults, Page(page).open) == ([], [])
    assert len(re.findall("<script", page)) == 1
    assert "://" not in page.replace("http://www.w3.org", "")
    assert "<b>odd" not in page
    assert "&lt;b&gt;odd &amp; name" in page


def test_agents_of_another_split_or_depth_cannot_be_compared(agents):
    elsewhere = replace(agents[1], opened=open_graph("kitchen", SplitConfig(seed=5)))
    deeper = replace(
        agents[1], config=replace(agents[1].config, tasks=TaskConfig(depth=2, distractors=2))
    )
    for other, error, why in (
        (elsewhere, GraphMismatchError, "split"),
        (deeper, ConfigError, "plays with depth 2"),
    ):
        with pytest.raises(error, match=why):
            report_of({"a": [agents[0]], "b": [other]})


@pytest.mark.parametrize(
    ("of_seeds", "of_tasks", "widest"),
    [
        (None, (0.4, 0.6), (0.4, 0.6)),
        ((0.5, 0.5), (0.4, 0.6), (0.4, 0.6)),
        ((0.3, 0.7), (0.4, 0.6), (0.3, 0.7)),
    ],
)
def test_the_headline_has_the_wider_interval_as_seeds_may_be_alike(of_seeds, of_tasks, widest):
    success = AgentSuccess(mean=0.5, seed_ci=of_seeds, task_ci=of_tasks, seeds=(0.5,), by_plan=0.5)
    assert success.widest_ci == widest


ROOT = Path(__file__).parents[2]


def test_every_word_that_a_template_explains_is_in_the_glossary():
    folders = [
        files(f"wordcraft_kg.{package}") / "templates"
        for package in ("reports", "studies", "apps.explorer")
    ]
    templates = [
        path.read_text(encoding="utf-8") for folder in folders for path in folder.iterdir()
    ]
    keys = {key for text in templates for key in re.findall(r'\bterm\("(\w+)"', text)}
    assert len(keys) > 20
    assert keys <= GLOSSARY.keys()


def test_every_source_of_knowledge_is_explained_under_its_symbol():
    for label in (ALPHA, *BUILT_IN.values()):
        term = GLOSSARY[label.name]
        assert term.symbol == label.symbol
        assert term.meaning.startswith(label.meaning)
        assert label is ALPHA or f"settings: {with_letters([label.name])}." in term.meaning


def test_no_two_terms_share_a_name_or_symbol():
    """No two terms have the same name or symbol and each meaning is a sentence."""
    names = [term.name for term in GLOSSARY.values()]
    symbols = [term.symbol for term in GLOSSARY.values() if term.symbol]
    assert len(set(names)) == len(names)
    assert len(set(symbols)) == len(symbols)
    assert all(
        term.meaning.endswith(".") and term.meaning[0].isupper() for term in GLOSSARY.values()
    )


def test_the_page_of_concepts_is_up_to_date():
    found = importlib.util.spec_from_file_location("make_terms", ROOT / "docs" / "make_terms.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    written = (ROOT / "docs" / "terms.md").read_text(encoding="utf-8")
    assert written == module.page(), "docs/terms.md is not up to date; run `make docs`"
