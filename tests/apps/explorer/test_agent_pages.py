"""The pages of tasks, episodes and runs: figures, forms, labels, and runs that are not done."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from helpers import lines_of

from tests.apps.explorer.shown import look, view_of
from wordcraft_kg import WordCraftConfig, World, open_agent
from wordcraft_kg.agents.agent_records import PlayedTask
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.agents.players import random_entity
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.episode import EpisodeState
from wordcraft_kg.apps.explorer.pages.runs import RunsState, RunState
from wordcraft_kg.apps.explorer.pages.tasks import (
    TASKS_A_PAGE,
    ListedTask,
    TasksState,
    outcomes_of,
    view_task_table,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import (
    make_tasks,
)


def test_a_task_leads_to_its_episode_with_the_ending_that_the_table_counts(agents):
    for part in ("train", "test"):
        shown = view_of(agents, TasksState(part=part, run="guided"))
        for row in shown.table.rows[::40]:
            for seed in range(row.distractor_seeds):
                state = EpisodeState(run="guided", part=part, task=row.number, distractor_seed=seed)
                episode = view_of(agents, state)
                assert (episode.goal, episode.start, episode.plans) == (
                    row.goal,
                    row.start,
                    row.plans,
                )
                assert (episode.terminations[seed] == "goal") == (
                    episode.agents[0].explained.episode.outcome == "goal"
                )
            assert episode.terminations.count("goal") == row.won


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (TasksState(depth=2), "guided was evaluated on tasks of depth 1."),
        (TasksState(part="all"), "guided was evaluated on train and test tasks."),
        (TasksState(), ""),
    ],
)
def test_where_there_are_no_results_the_page_says_why(agents, state, reason):
    view = view_of(agents, state)
    assert (view.missing, view.table.counts == {}) == (reason, bool(reason))
    assert reason in look(agents, state).text


def test_tasks_are_shown_without_any_agent(kitchen_folder):
    explored, state = Explored.open(kitchen_folder), TasksState(part="train")
    page = look(explored, state)
    assert f"{view_of(explored, state).table.tasks} train tasks of depth 1" in page.text
    assert "Solved" not in page.text
    assert not [link for link in page.links if "episode" in link]
    assert not PAGES["episode"].is_there(explored)
    with pytest.raises(ConfigError, match="needs a run"):
        view_of(explored, EpisodeState())


@pytest.mark.parametrize("run", ["guided", "plain", "mlp"])
def test_an_episode_is_what_the_agent_explains(agents, run):
    agent = open_agent(agents.runs[run], agents.opened)
    world = World(agents.opened, agent.config.tasks.environment("train"))
    explainer = Explainer(agent.policy, world, trained_on=agent.trained_on)
    state = EpisodeState(run=run, part="train", task=11, distractor_seed=2)
    first = view_of(agents, state).agents[0].explained
    assert first == explainer.task(11, 2)
    labels = agents.opened.graph.labels(explainer.tables.table(4)[:3])
    edited = EpisodeState(run=run, part="train", task=4, goal="bread", table=labels)
    assert view_of(agents, edited).agents[0].explained == explainer.table("bread", labels, like=4)
    page = look(agents, state).page
    for slot in (slot for step in first.episode.steps for slot in step.slots):
        assert f"<td>{slot.logit:.2f}</td><td>{100 * slot.probability:.1f} %</td>" in page


def test_agents_are_asked_at_one_table_by_one_world_s_rules(agents):
    shown = view_of(agents, EpisodeState(task=5, distractor_seed=1, other=("plain", "mlp", "")))
    guided, plain, mlp = shown.agents
    assert guided.explained.table == plain.explained.table == shown.table
    assert plain.explained.model == "no_scorer"
    assert (mlp.explained, "this mlp was made for" in mlp.problem) == (None, True)
    assert (
        "not available: "
        in look(agents, EpisodeState(task=5, distractor_seed=1, other=("plain", "mlp"))).text
    )
    small = view_of(agents, EpisodeState(task=5, distractors=2, other=("mlp",)))
    assert small.agents[1].explained.table == small.table
    assert small.terminations == ()  # it was evaluated with eight
    with pytest.raises(ConfigError, match="this mlp was made for"):
        view_of(agents, EpisodeState(run="mlp", distractors=8))


def test_in_sample_scores_are_marked(agents, recipes_folder):
    """Where two folds have a way, every model has learned one of them; where one has, there is a
    model that has not."""
    from wordcraft_kg.models.scorers.scorer_folder import load_scorer

    graph, folds = agents.opened.graph, load_scorer(recipes_folder).of_recipe.tolist()  # type: ignore[attr-defined]
    by_goal = {}
    for (a, b, goal), fold in zip(graph.recipes.tolist(), folds, strict=True):
        if fold >= 0:
            by_goal.setdefault(goal, {}).setdefault(fold, [a, b])
    goal, ways = next(
        (goal, list(ways.values())) for goal, ways in by_goal.items() if len(ways) > 1
    )
    both = EpisodeState(
        goal=graph.entities[goal], table=graph.labels(dict.fromkeys([*ways[0], *ways[1]]))
    )
    shown = view_of(agents, both).agents[0].explained
    learned = {" + ".join(sorted(graph.labels(way))) for way in ways[:2]}
    assert learned <= {" + ".join(recipe.ingredients) for recipe in shown.in_sample}
    unseen = msgspec.structs.replace(
        shown.ways[0][0], is_in_sample=False
    )  # as the second recipe of a plan of depth 2
    partly = msgspec.structs.replace(shown, ways=((*shown.ways[0], unseen),))
    assert (shown.is_known, partly.is_known, bool(partly.in_sample)) == (True, False, True)
    text = look(agents, both).text
    assert all(shown in text for shown in ("in-sample This model was trained on", *learned))
    one = EpisodeState(goal=both.goal, table=graph.labels(dict.fromkeys(ways[0])))
    assert view_of(agents, one).agents[0].explained.in_sample == ()
    text = look(agents, one).text
    assert ("in-sample This model" in text, "model trained without fold" in text) == (False, True)


def test_the_runs_are_what_their_records_say(agents):
    view = view_of(agents, RunsState())
    assert [row.name for row in view.runs] == ["guided", "plain", "mlp"]
    for row in view.runs:
        summary = json.loads((agents.runs[row.name] / "evaluation.json").read_text())
        means = {part: success["mean"] for part, success in summary["success"].items()}
        assert {part: success.mean for part, success in row.success.items()} == means
        assert all(
            success.ci[0] <= success.mean <= success.ci[1] for success in row.success.values()
        )
        assert (row.steps, row.status, row.is_live) == (summary["steps"], "done", False)
    guided, plain, mlp = view.runs
    assert (guided.scorer, guided.use, guided.kg) == ("kitchen-recipes", ("u", "v", "w"), "partial")
    assert (plain.scorer, plain.use, mlp.policy) == ("", (), "mlp")


def test_a_run_shows_curves_and_settings_but_no_folders(agents, tmp_path):
    """A run shows its curves and settings but no folders of this machine."""
    view = view_of(agents, RunState("guided"))
    lines = lines_of(agents.runs["guided"] / "metrics.jsonl")
    points = [(line["step"], line["test_success"]) for line in lines if "test_success" in line]
    assert [(point.step, point.success) for point in view.curves["test"]] == points
    assert view.settings == {
        "graph": "kitchen",
        "scorer": "kitchen-recipes",
        "use": "combines (u), component (v), recipe (w)",
        "batch_size": "16",
        "steps": "1600",
    }
    page = look(agents, RunState("guided")).page
    assert str(tmp_path.parent) not in page
    assert "data-live" not in page
    assert page.count("<svg") >= 6


BREAK: dict[str, Callable[[Path], object]] = {
    "run.json": lambda folder: (folder / "run.json").write_text("{"),
    "config.toml": lambda folder: (folder / "config.toml").write_text("[train-agent]\n"),
    "metrics.jsonl": lambda folder: (folder / "metrics.jsonl").write_text("nonsense\n"),
    "the folder": shutil.rmtree,
}


@pytest.mark.parametrize("what", BREAK)
def test_a_run_that_is_damaged_is_said_to_be_and_the_others_are_shown(agents, tmp_path, what):
    folder = shutil.copytree(agents.runs["plain"], tmp_path / "live")
    explored = Explored.open(agents.opened.source, [], [folder, agents.runs["guided"]])
    BREAK[what](folder)
    rows = view_of(explored, RunsState()).runs
    assert [row.status for row in rows] == [None, "done"]
    assert rows[0].problem
    for state in (RunsState(), RunState("live"), TasksState()):
        page = look(explored, state)
        assert page.text.count(rows[0].problem.split(". ")[0][:60]) == 1
        assert "data-live" not in page.page


def played_at_random(opened, depth):
    """Episodes of chance, as a run records them; of every third task none."""
    world = World(opened, WordCraftConfig(part="train", depth=depth, num_distractors=0))
    success, lines = Evaluator(world, distractor_seeds=4)(random_entity).success, []
    for number in (number for number in range(len(world.tasks)) if number % 3):
        task, won = world.tasks[number], success[number].tolist()
        terminations = tuple("goal" if one else "no_recipe" for one in won)
        lines.append(
            PlayedTask("train", task.goal, task.start, float(np.mean(won)), terminations, (2,) * 4)
        )
    return world.tasks, lines


@pytest.mark.parametrize("depth", [1, 2])
def test_all_tasks_are_listed_once_with_how_often_they_were_solved(opened, depth):
    tasks, lines = played_at_random(opened, depth)
    results = outcomes_of(tasks, reversed(lines))
    by_task = {(line.goal, line.start): line.terminations for line in lines}
    pages = view_task_table(tasks, results).paging.pages
    rows = [
        row
        for page in range(1, pages + 1)
        for row in view_task_table(tasks, results, page=page).rows
    ]
    assert [row.number for row in rows] == list(range(len(tasks)))
    for row, task in zip(rows, tasks, strict=True):
        terminations = by_task.get((task.goal, task.start))
        won = (None, None) if terminations is None else (terminations.count("goal"), 4)
        assert row == ListedTask(row.number, task.goal, task.start, task.plans, *won)
    found = view_task_table(tasks, results)
    assert sum(found.counts.values()) == len(lines)
    for kind, holds in (
        ("always", lambda row: row.won == 4),
        ("never", lambda row: row.won == 0),
        ("sometimes", lambda row: row.won is not None and 0 < row.won < 4),
    ):
        expected = [row for row in rows if holds(row)]
        chosen = view_task_table(tasks, results, won=kind)
        assert (chosen.counts, chosen.paging.total) == (found.counts, len(expected))
        assert chosen.counts[kind] == len(expected)
        assert list(chosen.rows) == expected[:TASKS_A_PAGE]
        assert expected or (tasks.depth, kind) == (2, "always")  # which chance hardly does


def test_drawn_tasks_are_said_to_be_drawn(opened):
    tasks = make_tasks(opened.graph, 3, opened.split, "train", limit=70)
    found = view_task_table(tasks)
    assert (found.tasks, found.is_complete, found.paging.pages) == (70, False, 2)
    assert view_task_table(make_tasks(opened.graph, 1)).is_complete
