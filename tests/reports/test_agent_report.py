"""The agent report: numbers of the evaluation, a whole page, and no comparison of what cannot be
compared."""

import re
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from report_helpers import Page, text_of

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import ExplainedSlot, ExplainedStep
from wordcraft_kg.agents.players import knowledge_player
from wordcraft_kg.agents.records import MetricsRow
from wordcraft_kg.agents.training import train_agent
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.records import as_values, schema_of
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.cli.compare import _agents_text
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agent_metrics import AgentSuccess
from wordcraft_kg.evaluation.agents import AgentsView, by_success, group_agents, view_agents
from wordcraft_kg.graphs import SplitConfig, open_graph
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import train_links
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.reports.agent_report import make_agent_report, slot_rows
from wordcraft_kg.reports.pages import render

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


def test_the_table_and_the_text_begin_with_the_best_agent_and_name_the_reference(agents):
    groups = group_agents(agents)
    view = view_agents(dict(reversed(groups.items())), distractor_seeds=1, episodes=0)
    best, other = by_success(view, view.headline)
    amount = str(view.headline)
    assert best.success[amount].mean >= other.success[amount].mean
    first_line, *lines = [line for line in _agents_text(view) if line.startswith("  ")]
    assert first_line.split()[0] == by_success(view, view.distractors[0])[0].name
    assert ["reference" in line for line in (first_line, *lines)].count(True) == len(
        view.distractors
    )
    page = render(make_agent_report(view))
    rows = re.findall(rf'<th scope="row">(\w+)</th><td>{amount}</td>', page)
    assert rows[:2] == [best.name, other.name]


def test_runs_that_differ_in_the_seed_are_one_agent(agents):
    groups = {
        name: [agent.name for agent in members] for name, members in group_agents(agents).items()
    }
    assert groups == {"plain": ["plain-0", "plain-1"], "mlp": ["mlp"]}


def test_a_run_given_twice_is_an_error(agents):
    with pytest.raises(ConfigError, match="the same settings and seed"):
        group_agents([agents[0], agents[0]])


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
    assert [row.name for row in report.view.baselines] == [
        "random",
        "fewest uses",
        "nearest words (minilm)",
        "recipe oracle",
    ]
    for row in report.view.baselines:
        assert row.success.keys() == row.by_plan.keys() == {"1", "2", "8"}
        assert all(row.by_plan[amount] <= success for amount, success in row.success.items())


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


def test_curves_are_means_over_seeds(agents, report):
    for step, mean, low, high in as_values(report.view)["agents"][0]["curves"]["test"]:
        seeds = [
            row.figures["test_success"]
            for agent in agents[:2]
            for row in agent.metrics
            if row.step == step
        ]
        assert mean == pytest.approx(np.mean(seeds))
        assert low <= mean <= high


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


def test_figures_of_a_few_updates_only_are_left_out_of_the_curves(agents):
    rows = [
        MetricsRow(step=step, seconds=1, figures={"loss": step, "test_success": 0.5})
        for step in (100, 200, 210)
    ]
    agent = replace(agents[0], metrics=rows)
    training = report_of({"one": [agent]}, distractor_seeds=1, episodes=0).view.agents[0].training
    assert training["loss"][0].points == ((100, 100), (200, 200))
    assert [step for step, _ in training["test_success"][0].points] == [100, 200, 210]


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


def test_the_first_line_compares_agents_and_does_not_compare_a_single_one(agents, report):
    def first_line(report):
        card = re.search(
            r"<b>In short.*?</div>\s*<p class=.note.>.*?</p>", render(report), re.DOTALL
        )
        return text_of(card[0])

    mlp = report.view.agents[1].success["2"]
    verdict = (
        "above"
        if mlp.difference_ci[0] > 0
        else "below"
        if mlp.difference_ci[1] < 0
        else "no significant difference"
    )
    assert re.search(rf"Paired difference +to plain: .*mlp .*, +{verdict}", first_line(report))
    assert "difference between agents may be due to the seeds" in first_line(report)
    for of in (report, report_of({"one": [agents[0]]}, distractor_seeds=1, episodes=0)):
        card = text_of(re.search(r"<b>In short:(.*?)</div>", render(of), re.DOTALL)[1]).strip()
        sentences = re.split(r"(?<=\.) ", re.sub(r"\d\.\d", "0", card))
        assert len(sentences) == 2
        assert not any(sentence.startswith(("plain", "one")) for sentence in sentences)
    alone = first_line(report_of({"one": [agents[0]]}, distractor_seeds=1, episodes=0))
    assert "difference" not in alone
    assert "One seed: another seed may give another result." in alone


def test_bars_of_contributions_fill_the_width_at_the_largest_sum():
    sums = ({"alpha": 1.0, "u": 2.0, "v": -1.0}, {"alpha": -1.0, "u": 0.5, "v": -1.5})
    step = ExplainedStep(
        None,
        0.0,
        {},
        "egg",
        (),
        tuple(ExplainedSlot("egg", False, of, of, sum(of.values()), 0.5) for of in sums),
    )
    widths = [
        [float(width) for width in re.findall(r'width="([\d.]+)"', str(bar))]
        for _, bar in slot_rows(step)
    ]
    assert sum(widths[0][:2]) == pytest.approx(70, abs=0.2)
    assert widths[1][0] + widths[1][2] == pytest.approx(70 * 2.5 / 3, abs=0.2)


def test_it_follows_its_schema_and_is_the_same_each_time(agents, report):
    jsonschema.Draft202012Validator.check_schema(schema_of(AgentsView, "urn:x", "x"))
    jsonschema.validate(as_values(report.view), schema_of(AgentsView, "urn:x", "x"))
    again = report_of(group_agents(agents), distractor_seeds=2)
    assert again.view == report.view
    assert render(again) == render(report)


def test_the_page_is_whole_needs_no_network_and_escapes_names(agents):
    odd = replace(agents[0], name="<b>odd & name</b>")
    page = render(report_of({odd.name: [odd]}, distractor_seeds=1, episodes=1))
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


@pytest.mark.slow
def test_an_agent_is_compared_with_the_scores_that_it_saw(tmp_path):
    """An agent is compared with the scores that it saw and the page says how."""
    links = ComplExConfig(dim=8, epochs=6, n3=0.1, folds=3)
    model = train_links(LinksConfig("kitchen", links), tmp_path / "model").folder
    policies = {"folds": PolicyConfig(), "whole": PolicyConfig(in_sample=True)}
    agents = trained(
        tmp_path, {name: (policy, TRAINER) for name, policy in policies.items()}, str(model)
    )
    report = report_of(group_agents(agents), part="train", distractor_seeds=1)
    world = World(agents[0].opened, TASKS.environment("train"))
    assert [entry.cross_fitted for entry in report.view.agents] == [3, 0]
    html = render(report)
    for agent, entry in zip(agents, report.view.agents, strict=True):
        beside = entry.success["2"].against_scorer
        mine, alone = (
            Evaluator(world, distractor_seeds=1)(player)
            for player in (
                PolicyPlayer(agent.policy),
                knowledge_player(list(agent.policy.sources.values())),
            )
        )
        gain = mine.success.mean() - alone.success.mean()
        assert (beside.scorer, beside.gain) == ("combines (u), component (v)", pytest.approx(gain))
        assert (
            beside.differs
            == (mine.decisions != alone.decisions).mean()
            > (mine.success != alone.success).mean()
        )
        assert f"<td>{beside.scorer}</td><td>{100 * beside.differs:.1f} %</td>" in html
        assert entry.sources.keys() == {"combines (u)", "component (v)"}
        for source, found in entry.sources.items():
            note = f"{entry.name}, 2 distractors: {source} {found.sentence}."
            assert (note in html) == found.adds_nothing
    out_of_sample = (
        r"Scores of train tasks \(folds\):\s+.*out of sample.*, by models trained.*\(3 folds\)"
    )
    for note in (out_of_sample, r"Scores of train tasks \(whole\):\s+.*in-sample"):
        assert re.search(note, html)


@pytest.mark.parametrize(
    ("of_seeds", "of_tasks", "widest"),
    [
        (None, (0.4, 0.6), (0.4, 0.6)),
        ((0.5, 0.5), (0.4, 0.6), (0.4, 0.6)),
        ((0.3, 0.7), (0.4, 0.6), (0.3, 0.7)),
    ],
)
def test_the_headline_has_the_wider_interval_as_seeds_may_be_alike(of_seeds, of_tasks, widest):
    success = AgentSuccess(
        mean=0.5, seed_ci=of_seeds, task_ci=of_tasks, seeds=(0.5,), by_plan=0.5, actions=2.0
    )
    assert success.widest_ci == widest
