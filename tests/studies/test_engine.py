import errno
import itertools
import json
import os
import shutil
import signal
import threading
import time
from functools import partial

import msgspec
import pytest
from small_study import (
    HALF,
    KITCHEN,
    RUN_METRICS,
    TEXT,
    pretend,
    run_small,
    small_plan,
)

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import nearest_words
from wordcraft_kg.base import TEMPORARY, TrainingError, as_values, parse_record
from wordcraft_kg.graphs.graph_folder import OpenedGraph, PlayedGraph, open_graph
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.reports.pages import render
from wordcraft_kg.studies.engine import Pool, missing_tasks, run_plan
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.plan import Outcome, agent_config
from wordcraft_kg.studies.report import make_study_report, panels_of
from wordcraft_kg.studies.results import (
    RunMetrics,
    StudyResults,
    collect_study,
    hash_of,
    own_results,
    read_metrics,
    results_text,
    write_metrics,
)
from wordcraft_kg.studies.view import view_study


def times_made(root):
    return [len(path.read_text().splitlines()) for path in sorted(root.glob("*/*/made"))]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A results folder with a study that is done."""
    root = tmp_path_factory.mktemp("study") / "results"
    run_small(root)
    return root


def the(kind, plan):
    """The first task of a kind."""
    return next(task for task in plan.tasks.values() if task.kind == kind)


def record(folder):
    return json.loads((folder / "run.json").read_text())


def interrupted(task, done, root):
    """Copy a study, and leave a run of it interrupted; return its folder."""
    from wordcraft_kg.agents.agent_training import train_agent

    shutil.copytree(done, root, dirs_exist_ok=True)
    shutil.rmtree(folder := task.folder(root))
    graph, *scorer = (str(root / address) for address in task.needs)
    config = agent_config(task.settings["settings"], graph, scorer[0] if scorer else None)
    with pytest.raises(KeyboardInterrupt):
        train_agent(config, folder, progress=lambda *_: os.kill(os.getpid(), signal.SIGINT))
    assert record(folder)["status"] == "interrupted"
    return folder


def figures(root):
    """All figures but those of time."""
    runs = as_values(collect_study(root, "small").runs)
    return [{name: value for name, value in run.items() if "second" not in name} for run in runs]


def test_a_study_gives_figures_of_every_cell(done):
    results = collect_study(done, "small")
    cells = [(run.values["distractors"], run.variant, run.seed) for run in results.runs]
    assert cells == list(itertools.product((2, 1), ("none", "guided"), (0, 1)))
    assert not results.missing
    for run in results.runs:
        assert (run.mrr is None) == (run.variant == "none")
        assert len(run.won) == 63, "one digit for each test task"
        assert run.rates.mean() == pytest.approx(run.success["test"], abs=1e-6)
        assert run.curve[-1] == (run.steps, pytest.approx(run.success["test"], abs=1e-5))
    assert len({run.run for run in results.runs}) == 8
    assert results.hours > 0


def test_what_is_done_is_not_done_again(done):
    before = figures(done)
    assert run_small(done) == []
    assert figures(done) == before


@pytest.mark.slow
def test_two_studies_share_what_is_equal(done):
    more = small_plan('[variants.more]\nscorer = "partial"\nuse = "v"', name="larger")
    new = [f"more, distractors {amount}, seed {seed}" for seed in (0, 1) for amount in (2, 1)]
    assert run_small(done, more) == new


def test_settings_at_their_default_are_those_of_studies_that_say_them(tmp_path):
    run_small(tmp_path, small_plan(name="silent"), pretend)
    text = TEXT.replace("steps", 'policy = "attention"\nsteps').replace("seeds = 2", "seeds = 3")
    run_small(
        tmp_path,
        small_plan('[variants.other]\nscorer = "partial"\nuse = "u"', "explicit", text),
        pretend,
    )
    silent, explicit = (collect_study(tmp_path, name).runs for name in ("silent", "explicit"))
    shared = [run.run for run in explicit if run.variant != "other" and run.seed < 2]
    assert shared == [run.run for run in silent]
    assert len(explicit) == 18


@pytest.mark.slow
def test_processes_give_the_figures_of_one(done, tmp_path):
    run_plan(small_plan(), tmp_path, Pool(2), work=partial(perform, keep_all=False))
    assert figures(tmp_path) == figures(done)
    assert not list(tmp_path.glob("runs/*/constants.safetensors")), "figures alone were to be kept"


def test_a_training_that_was_interrupted_goes_on_and_ends_the_same(done, tmp_path):
    plan = small_plan()
    folder = interrupted(plan.tasks[plan.runs[0]], done, tmp_path)
    run_small(tmp_path)
    assert record(folder)["resumed"], "it went on"
    assert figures(tmp_path) == figures(done)


def test_damaged_figures_are_noticed_and_made_again(done, tmp_path, caplog):
    before = figures(done)
    path = done / small_plan().runs[3] / "figures.json"
    path.write_text(path.read_text().replace('"distractor_seeds": 5', '"distractor_seeds": 4'))
    (missing,) = collect_study(done, "small").missing
    assert "the hash does not fit" in missing.why
    assert len(run_small(done)) == 1
    assert "is repeated now" in caplog.text
    assert figures(done) == before


def test_a_damaged_graph_is_named_with_what_to_do(done, tmp_path):
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    task = small_plan().tasks[small_plan().runs[0]]
    (the("graphs", small_plan()).folder(tmp_path) / "graph.json").write_text("{")
    shutil.rmtree(task.folder(tmp_path))
    remedy = "remove the damaged task's folder"
    assert remedy in perform(task, tmp_path).error
    assert all(remedy in gap.why for gap in collect_study(tmp_path, "small").missing[1:])


def test_a_full_disk_fails_a_task_with_what_to_do(tmp_path, monkeypatch, caplog):
    def run(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("wordcraft_kg.studies.perform._run", run)
    plan = small_plan()
    assert "free some space" in perform(plan.tasks[plan.runs[0]], tmp_path).error
    assert not caplog.records, "no traceback for each task"


def test_a_failure_stops_nothing_but_what_needs_it_and_is_tried_again(tmp_path):
    plan = small_plan()
    broken = the("scorers", plan).address

    def work(task, root):
        return (
            Outcome(task.address, "failed", "the oven is broken")
            if task.address == broken
            else pretend(task, root)
        )

    state = run_plan(plan, tmp_path, Pool(1), work=work)
    assert (state.done, len(state.failed), state.kept, state.total) == (5, 5, 0, 10)
    assert state.failed[broken].error == "the oven is broken"
    run = next(address for address, task in plan.tasks.items() if broken in task.needs)
    assert state.failed[run].error == f"{plan.tasks[broken].title} failed: the oven is broken"
    assert run_plan(plan, tmp_path, Pool(1), work=work).kept == 5
    assert len(run_small(tmp_path, plan, pretend)) == 5


def test_an_interrupted_study_ends_with_what_is_done_safe(tmp_path):
    began = []

    def work(task, root):
        began.append(task)
        return pretend(task, root) if len(began) < 3 else Outcome(task.address, "interrupted")

    with pytest.raises(KeyboardInterrupt, match="3 of 10 tasks are done, repeat the command"):
        run_small(tmp_path, work=work)
    assert len(began) == 3
    assert len(run_small(tmp_path, work=pretend)) == 7, "nothing stops the same command"
    assert set(times_made(tmp_path)) == {1}


def test_a_study_whose_first_file_cannot_be_written_leaves_no_folder(tmp_path):
    with pytest.raises(OSError, match="full"), own_results(tmp_path / "results"):
        raise OSError("full")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("folder", ["studies", "graphs", "reports"])
def test_files_that_a_killed_study_left_half_written_are_removed(tmp_path, folder):
    (tmp_path / folder).mkdir()
    (left := tmp_path / folder / f".small.json.x1{TEMPORARY}").touch()
    run_small(tmp_path, work=pretend)
    assert not left.exists()


def die(task, root):
    if task.kind == "runs" and task.settings["settings"]["seed"] == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return pretend(task, root)


def endless(task, root):
    """A training that takes Ctrl-C as a request to write a checkpoint."""
    asked = []
    before = signal.signal(signal.SIGINT, lambda *_: asked.append(1))
    (root / "begun").touch()
    while not asked:
        time.sleep(0.01)
    signal.signal(signal.SIGINT, before)
    (root / f"{task.folder(root).name}.checkpoint").touch()
    return Outcome(task.address, "interrupted")


def only_runs(task, root):
    return endless(task, root) if task.kind == "runs" else pretend(task, root)


@pytest.mark.slow
def test_the_death_of_a_process_ends_the_study_with_what_is_done_safe(tmp_path):
    plan = small_plan()
    with pytest.raises(TrainingError, match="fewer `jobs`"):
        run_plan(plan, tmp_path, Pool(2), work=die)
    done = len(list(tmp_path.glob("*/*/figures.json")))
    assert 2 <= done < 10
    assert len(run_small(tmp_path, plan, pretend)) == 10 - done
    assert not collect_study(tmp_path, "small").missing


@pytest.mark.slow
def test_ctrl_c_lets_workers_write_a_checkpoint_first(tmp_path):
    threading.Thread(target=press_when_begun, args=(tmp_path / "begun",), daemon=True).start()
    with pytest.raises(KeyboardInterrupt, match="2 of 10 tasks are done"):
        run_plan(small_plan(), tmp_path, Pool(2), work=only_runs)
    assert 1 <= len(list(tmp_path.glob("*.checkpoint"))) <= 2, "no other task began"


def press_when_begun(file):
    while not file.exists():
        time.sleep(0.05)
    signal.raise_signal(signal.SIGINT)


def test_a_run_without_test_tasks_is_missing_and_says_why(tmp_path):
    plan = small_plan()

    def work(task, root):
        outcome = pretend(task, root)
        if task.address == plan.runs[0]:
            path = task.folder(root)
            write_metrics(
                path,
                msgspec.structs.replace(
                    read_metrics(path, RunMetrics), success={"train": 0.5}, by_plan={"train": 0.5}
                ),
            )
        return outcome

    run_small(tmp_path, plan, work)
    results = collect_study(tmp_path, "small")
    (gap,) = results.missing
    assert (gap.variant, gap.seed, gap.why) == (
        "none",
        0,
        "the split has no test tasks of this kind",
    )
    assert len(results.runs) == 7


def the_run(plan=None):
    """The last task of a study, a guided agent."""
    plan = plan or small_plan()
    return plan.tasks[plan.runs[-1]]


ALL_WON = HALF["won"]


def forged(**changes):
    """Return a change of figures; a dictionary changes some keys of a figure."""

    def change(figures):
        for name, value in changes.items():
            figures[name] = figures[name] | value if isinstance(value, dict) else value

    return change


FORGERIES = {
    "success above": (forged(success={"test": 0.99}), "but 'won' gives 0.5"),
    "a task won more": (forged(won="5" + ALL_WON[1:]), "but 'won' gives 0.50"),
    "a task more": (forged(won=ALL_WON + "4", success={"test": 0.5}), "all test tasks of"),
    "no digits": (forged(won="zz"), "matching regex"),
    "line break": (forged(won=ALL_WON + "\n"), "matching regex"),
    "endless tables": (forged(distractor_seeds=1e308), "Expected 'int', got 'float'"),
    "no tables": (forged(distractor_seeds=0), "Expected 'int' >= 1"),
}


@pytest.fixture(scope="module")
def pretended(tmp_path_factory):
    """A results folder with a study that was pretended to run."""
    root = tmp_path_factory.mktemp("pretended")
    run_small(root, work=pretend)
    return root


@pytest.mark.parametrize(("forge", "message"), FORGERIES.values(), ids=FORGERIES)
def test_results_that_contradict_each_other_are_missing_with_the_reason(pretended, forge, message):
    path = pretended / the_run().address / "figures.json"
    text = path.read_text()
    figures = json.loads(text)["figures"]
    forge(figures)
    # The forger computes the hash anew, so only the figures tell.
    path.write_text(json.dumps({"sha256": hash_of(figures), "figures": figures}))
    (lost,) = collect_study(pretended, "small").missing
    path.write_text(text)
    assert message in lost.why


def test_results_are_read_of_a_book_without_room_for_the_default_table(tmp_path):
    book = tmp_path / "tiny.csv"
    pairs = ("aa", "ab", "ac", "bb", "bc", "cc")
    rows = [f"{first},{second},{first}-{second}" for first, second in pairs]
    book.write_text("\n".join(["ingredient_a,ingredient_b,result", *rows]))
    settings = f'book = "{book}"\nsplit = "by-goal"\ntrain_ratio = 0.5\nvalid_ratio = 0'
    text = TEXT.replace('book = "kitchen"', settings).replace("[2, 1]", "[1, 0]")

    def work(task, root):
        if task.kind == "graphs":
            return perform(task, root)
        outcome = pretend(task, root)
        if task.kind == "scorers":
            return outcome
        opened = open_graph(str(root / task.needs[0]))
        tasks = World(opened, WordCraftConfig(part="test", num_distractors=0)).tasks
        changes = {"graph": PlayedGraph.of(opened), "won": "4" * len(tasks)}
        write_metrics(task.folder(root), msgspec.structs.replace(RUN_METRICS, **changes))
        return outcome

    run_small(tmp_path, small_plan(text=text), work)
    results = collect_study(tmp_path, "small")
    assert len(results.runs) == 8, results.missing


def test_missing_tasks_are_listed_in_the_order_of_the_plan(pretended, tmp_path):
    plan = small_plan()
    assert missing_tasks(plan, pretended) == []
    assert missing_tasks(plan, tmp_path) == list(plan.tasks.values())


def test_the_report_names_platform_and_versions(pretended):
    results = collect_study(pretended, "small")
    assert as_values(results.origins) == [
        {"platform": "here", "versions": {"torch": "2"}, "runs": 8}
    ]
    page = " ".join(render(make_study_report(view_study(results))).split())
    assert "<dt>8 trainings</dt> <dd>here; torch 2</dd>" in page
    assert results.hours == pytest.approx(9 / 3600, abs=1e-4), "runs and a scorer"


def test_results_of_a_study_have_the_groups_of_their_tasks(tmp_path):
    text = TEXT.replace("[grid]", 'split = "by-goal"\n[grid]')
    plan = small_plan(text=text)
    goals = World(
        OpenedGraph(KITCHEN.graph, make_split(KITCHEN.graph, SplitConfig("by-goal")), "kitchen"),
        WordCraftConfig(part="test"),
    ).tasks.goals

    def of_goals(task, root):
        outcome = pretend(task, root)
        if task.kind == "runs":
            opened = open_graph(str(root / task.needs[0]))
            figures = msgspec.structs.replace(
                RUN_METRICS, won="4" * len(goals), graph=PlayedGraph.of(opened)
            )
            write_metrics(task.folder(root), figures)
        return outcome

    run_small(tmp_path, plan, of_goals)
    results = collect_study(tmp_path, "small")
    assert len(results.runs) == 8
    (groups,) = results.groups
    assert len(set(groups)) == len(set(goals.tolist())) < len(goals)
    assert len({*zip(groups, goals.tolist(), strict=True)}) == len(set(groups))
    assert results.rates_of(results.runs[:1]).groups.tolist() == list(groups)
    assert parse_record(results_text(results).encode(), StudyResults, "results.json") == results


PLAYERS = """
[variants."two at random"]
player = "random pair"
[variants.words]
player = "nearest words"
features = "auto"
"""


def test_players_without_training_stand_beside_the_agents(tmp_path):
    plan = small_plan(PLAYERS)
    run_plan(plan, tmp_path, Pool(1))
    results = collect_study(tmp_path, plan.name)
    played = [
        run for run in results.runs if run.variant == "words" and run.values["distractors"] == 2
    ]
    # Without chance in training or in the choice, all seeds are the same games.
    assert len({run.run for run in played}) == 1
    world = World(open_graph("kitchen"), WordCraftConfig("test", num_distractors=2))
    vectors = make_features("auto", world.graph.entities).unit_vectors
    expected = Evaluator(world)(nearest_words(vectors)).metrics()
    assert played[0].success["test"] == pytest.approx(expected.mean, abs=1e-6)
    assert played[0].steps == 0
    panels_of(view_study(results))


@pytest.mark.slow
def test_a_recipe_scorer_plays_alone_with_and_without_plans(tmp_path):
    players = (
        '[scorers.recipes]\ncommand = "train-recipes"\n'
        '[variants.pairs]\nplayer = "best pair"\nscorer = "recipes"\n'
        '[variants.plans]\nplayer = "planner"\nscorer = "recipes"\n'
    )
    plan = small_plan(players)
    run_plan(plan, tmp_path, Pool(1))
    view = view_study(collect_study(tmp_path, plan.name))
    success = {entry.variant: entry.mean for entry in view.points[0].variants}
    # At depth 1 the most probable plan is the best pair.
    assert success["plans"] == success["pairs"] > success["none"]
