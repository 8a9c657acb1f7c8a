"""The pages of tasks, episodes and runs: figures, forms, links, labels, and runs that are not done."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from refusals import refuses

from tests.apps.explorer.shown import HOSTILE, Shown, look, page_of, state_of, view_of
from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.explanation import MOST_ON_TABLE, Explainer
from wordcraft_kg.agents.training import train_agent
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import State
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.episode import Episode
from wordcraft_kg.apps.explorer.pages.runs import Run, Runs
from wordcraft_kg.apps.explorer.pages.tasks import Tasks
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, TaskError, UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.graphs.recipes import RecipeBook
from wordcraft_kg.models.policies.config import PolicyConfig

SHORT = ImpalaConfig(steps=1_024, batch_size=16, log_every=128, eval_every=512)
LEARNED = PolicyConfig(features="learned", embedding_size=8, key_size=8, value_size=8, hidden_size=8)
LARGEST = 300 * 1024


@pytest.fixture(scope="module")
def agents(kitchen_folder: Path, run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Explored:
    """The kitchen with an agent that mixes the scores of a cross-fitted scorer, one without, and an mlp."""
    home = tmp_path_factory.mktemp("runs")
    plain = AgentConfig(str(kitchen_folder), None, TaskConfig(distractors=8), LEARNED, SHORT)
    train_agent(plain, home / "plain")
    train_agent(replace(plain, policy=replace(LEARNED, policy="mlp"), tasks=TaskConfig(distractors=2)), home / "mlp")
    return Explored.open(kitchen_folder, [], [run_folder, home / "plain", home / "mlp"])


STATES: tuple[State, ...] = (
    Tasks(),
    Tasks(part="train", page=2, run="plain"),
    Tasks(part="all", depth=2),
    Tasks(depth=3, goal="bread"),
    Tasks(success="never"),
    Episode(),
    Episode(part="train", task=7, draw=3, other=("plain",)),
    Episode(depth=2, task=3, distractors=2, other=("plain", "mlp")),
    Episode(goal="bread", table=("flour", "water", "fire"), held="water", other=("plain",)),
    Episode(run="mlp", task=2),
    Runs(),
    Run("guided"),
    Run("plain"),
)


# --- every page ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", STATES, ids=repr)
def test_a_page_is_plain_accessible_and_small(agents: Explored, state: State) -> None:
    found = look(agents, state)
    assert len(found.page.encode()) < LARGEST
    names = {attribute for _, attributes in found.tags for attribute in attributes}
    assert not [attribute for attribute in names if attribute == "style" or attribute.startswith("on")]
    headings = [int(tag[1]) for tag, _ in found.tags if tag in ("h1", "h2", "h3")]
    assert headings[0] == 1
    assert headings.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(headings))
    ids = [attributes["id"] for _, attributes in found.tags if attributes.get("id")]
    assert len(ids) == len(set(ids))
    labelled = {attributes["for"] for tag, attributes in found.tags if tag == "label" and "for" in attributes}
    for tag, attributes in found.tags:
        if tag in ("input", "select") and attributes.get("type") not in ("hidden", "checkbox"):
            assert attributes["id"] in labelled
    assert checked_values(view_of(agents, state))


@pytest.mark.parametrize("state", STATES, ids=repr)
def test_the_links_of_a_page_lead_to_pages(agents: Explored, state: State) -> None:
    own = [target for where, target in look(agents, state).own if where in ("tasks", "episode", "runs", "run")]
    assert own
    for target in dict.fromkeys(own[:12] + own[-6:]):
        view_of(agents, target)


# --- tasks -----------------------------------------------------------------------------------------------------------


def test_a_task_leads_to_its_episode_with_the_ending_that_the_table_counts(agents: Explored) -> None:
    for part in ("train", "test"):
        shown = view_of(agents, Tasks(part=part, run="guided"))
        for row in shown.table.rows[::7]:
            for draw in range(row.draws):
                found = view_of(agents, Episode(run="guided", part=part, task=row.number, draw=draw))
                episode = found.episode
                assert (episode.goal, episode.start, episode.plans) == (row.goal, row.start, row.plans)
                assert (episode.endings[draw] == "goal") == (episode.first.episode.outcome == "goal")
            assert episode.endings.count("goal") == row.won


def test_where_there_are_no_results_the_page_says_why(agents: Explored) -> None:
    missing = {
        Tasks(depth=2): "guided was evaluated on tasks of depth 1.",
        Tasks(part="all"): "guided was evaluated on train and test tasks.",
        Tasks(): "",
    }
    for state, text in missing.items():
        shown = view_of(agents, state)
        assert (shown.missing, shown.table.counts == {}) == (text, bool(text))
        assert text in look(agents, state).text
    assert "drawn at random: there may be more" in look(agents, Tasks(depth=3)).text
    with pytest.raises(UnknownEntityError, match="Did you mean 'bread'"):
        view_of(agents, Tasks(goal="braed"))


def test_tasks_are_shown_without_any_agent(kitchen_folder: Path) -> None:
    explored = Explored.open(kitchen_folder)
    found = look(explored, Tasks(part="train"))
    assert f"{view_of(explored, Tasks(part='train')).table.tasks} train tasks of depth 1" in found.text
    assert "Solved" not in found.text
    assert not [link for link in found.links if "episode" in link]
    assert not PAGES["episode"].is_there(explored)
    with pytest.raises(ConfigError, match="needs a run"):
        view_of(explored, Episode())


# --- episodes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("run", ["guided", "plain", "mlp"])
def test_an_episode_is_what_the_agent_explains(agents: Explored, run: str) -> None:
    agent = open_agent(agents.runs[run], agents.opened)
    world = World(agents.opened, agent.config.tasks.environment("train"))
    explainer = Explainer(agent.policy, world, kg=agent.run.kg or "partial")
    shown = view_of(agents, Episode(run=run, part="train", task=11, draw=2))
    assert shown.episode.first == explainer.task(11, 2)
    table = explainer.drawn(4)[:3]
    labels = agents.opened.graph.labels(table)
    asked = view_of(agents, Episode(run=run, part="train", task=4, goal="bread", table=labels))
    assert asked.episode.first == explainer.table("bread", labels, like=4)
    page = look(agents, Episode(run=run, part="train", task=11, draw=2)).page
    for step in shown.episode.first.episode.steps:
        for slot in step.slots:
            assert f"<td>{slot.logit:.2f}</td><td>{100 * slot.probability:.1f} %</td>" in page


def test_agents_are_asked_at_one_table_by_one_world_s_rules(agents: Explored) -> None:
    shown = view_of(agents, Episode(task=5, draw=1, other=("plain", "mlp", "")))
    guided, plain, mlp = shown.episode.agents
    assert guided.found.table == plain.found.table == shown.episode.table
    assert plain.found.model == "no_scorer"
    assert (mlp.found, "this mlp was made for" in mlp.problem) == (None, True)
    assert guided.folds == 3
    found = look(agents, Episode(task=5, draw=1, other=("plain", "mlp")))
    assert "cannot be asked: tables of" in found.text
    small = view_of(agents, Episode(task=5, distractors=2, other=("mlp",)))
    assert small.episode.agents[1].found.table == small.episode.table
    assert small.episode.endings == ()  # it was evaluated with eight
    with pytest.raises(ConfigError, match="this mlp was made for"):
        view_of(agents, Episode(run="mlp", distractors=8))


def test_the_form_asks_at_the_table_that_is_seen(agents: Explored) -> None:
    state = Episode(part="train", task=9, draw=1, other=("plain",))
    shown = view_of(agents, state).episode
    sent = look(agents, state).form("held")
    again = PAGES["episode"].read("", sent)
    edited = view_of(agents, again).episode
    assert edited.is_edited
    assert edited.table == shown.table
    assert [agent.found.episode.steps for agent in edited.agents] == [
        agent.found.episode.steps for agent in shown.agents
    ]
    # An emptied line is taken off, a filled one is put on the table, and what is held is the first pick.
    lines = [value for name, value in sent if name == "table"]
    assert lines == [*shown.table, "", "", ""]
    added = next(label for label in agents.opened.graph.entities if label not in (*shown.table, shown.goal))
    changed = ["", *lines[1:-2], f"  {added} ", ""]
    rest = [(name, value) for name, value in sent if name not in ("table", "held")]
    query = [*rest, *(("table", line) for line in changed), ("held", shown.table[1])]
    found = view_of(agents, PAGES["episode"].read("", query)).episode
    assert found.table == (*shown.table[1:], added)
    assert found.held == shown.table[1]
    assert len(found.first.episode.steps) == 1
    text = look(agents, PAGES["episode"].read("", query)).text
    assert "at a table of your own" in text
    assert "Back to the task’s own table" in text


def test_what_cannot_be_asked_is_said(agents: Explored) -> None:
    with pytest.raises(UnknownEntityError, match=r"no entity 'flouur' in kitchen\. Did you mean 'flour'"):
        view_of(agents, Episode(table=("flouur", "water")))
    with pytest.raises(UnknownEntityError, match="no run 'giuded'"):
        view_of(agents, Episode(run="giuded"))
    with pytest.raises(UnknownEntityError, match="no run 'nobody'"):
        view_of(agents, Episode(other=("nobody",)))
    with refuses("held"):
        view_of(agents, Episode(table=("flour", "water"), held="fire"))
    with refuses("table"):
        view_of(agents, Episode(table=("flour", "flour")))
    with refuses("task"):
        view_of(agents, Episode(task=99_999))
    with refuses("num_distractors"):
        view_of(agents, Episode(distractors=10_000))
    with pytest.raises(TaskError, match="no task"):
        view_of(agents, Episode(part="valid"))


def test_a_full_table_of_several_agents_is_a_page_of_usual_size(agents: Explored) -> None:
    labels = agents.opened.graph.entities[:MOST_ON_TABLE]
    page = look(agents, Episode(goal="bread", table=labels, other=("plain", "mlp"))).page
    assert len(page.encode()) < LARGEST
    found = view_of(agents, Episode(goal="bread", table=labels, other=("plain",)))
    assert len(found.episode.first.episode.steps[0].slots) == MOST_ON_TABLE
    assert (
        f"The {found.most_slots} of highest logit, of {MOST_ON_TABLE} on the table."
        in look(agents, Episode(goal="bread", table=labels, other=("plain",))).text
    )


def test_memory_is_marked(agents: Explored, recipes_folder: Path) -> None:
    """Where two folds have a way, every model has learned one of them; where one has, there is a model that has not."""
    from wordcraft_kg.models.scorers.folder import load_scorer

    graph, folds = agents.opened.graph, load_scorer(recipes_folder).of_recipe.tolist()  # type: ignore[attr-defined]
    by_goal: dict[int, dict[int, list[int]]] = {}
    for (a, b, goal), fold in zip(graph.recipes.tolist(), folds, strict=True):
        if fold >= 0:
            by_goal.setdefault(goal, {}).setdefault(fold, [a, b])
    goal, ways = next((goal, list(ways.values())) for goal, ways in by_goal.items() if len(ways) > 1)
    both = Episode(goal=graph.entities[goal], table=graph.labels(dict.fromkeys([*ways[0], *ways[1]])))
    shown = view_of(agents, both).episode.first
    learned = {" + ".join(sorted(graph.labels(way))) for way in ways[:2]}
    assert learned <= {f"{recipe.ingredient_a} + {recipe.ingredient_b}" for recipe in shown.memory}
    text = look(agents, both).text
    assert "memory This model has learned" in text
    assert all(way in text for way in learned)
    one = replace_table(both, graph.labels(dict.fromkeys(ways[0])))
    assert view_of(agents, one).episode.first.memory == ()
    text = look(agents, one).text
    assert "memory This model" not in text
    assert "model that has not seen fold" in text


def replace_table(state: Episode, table: tuple[str, ...]) -> Episode:
    return Episode(goal=state.goal, table=table)


# --- hostile labels and odd books ------------------------------------------------------------------------------------


def explored_of(
    book: RecipeBook, split: SplitConfig, home: Path, policy: PolicyConfig = LEARNED, **tasks: Any
) -> Explored:
    graph = RecipeGraph.from_book(book)
    write_graph_folder(home / "graph", book, make_split(graph, split))
    config = AgentConfig(str(home / "graph"), None, TaskConfig(**tasks), LEARNED, replace(SHORT, steps=64))
    train_agent(config, home / "run")
    return Explored.open(home / "graph", [], [home / "run"])


@pytest.fixture(scope="module")
def hostile_agents(tmp_path_factory: pytest.TempPathFactory) -> Explored:
    rows = [(label, HOSTILE[i - 2], HOSTILE[i - 1]) for i, label in enumerate(HOSTILE)]
    book = RecipeBook.of("<b>hostile</b>", rows)
    return explored_of(book, SplitConfig("none"), tmp_path_factory.mktemp("hostile"), distractors=4)


def test_hostile_labels_stay_text_and_come_back_from_the_form(hostile_agents: Explored) -> None:
    tasks = view_of(hostile_agents, Tasks())
    assert {row.goal for row in tasks.table.rows} == {*HOSTILE}
    pages = [look(hostile_agents, Tasks()), look(hostile_agents, Runs())]
    for row in tasks.table.rows:
        state = Episode(task=row.number)
        page = look(hostile_agents, state)
        shown = view_of(hostile_agents, state).episode
        sent = page.form("held")
        again = PAGES["episode"].read("", sent)
        assert view_of(hostile_agents, again).episode.table == shown.table
        held = replace_held(sent, shown.table[0])
        assert view_of(hostile_agents, PAGES["episode"].read("", held)).episode.held == shown.table[0]
        found, read = state_of(PAGES["episode"].address(again))
        assert (found, read) == ("episode", again)
        goal = view_of(hostile_agents, state_of(PAGES["tasks"].address(Tasks(goal=row.goal)))[1])
        assert [one.goal for one in goal.table.rows] == [row.goal]
        pages += [page, look(hostile_agents, again)]
    for page in pages:
        tags = [tag for tag, _ in page.tags]
        assert "img" not in tags
        assert tags.count("script") == 1  # the site's own
        assert "<b>hostile" not in page.page
    assert any("alert(1)" in page.text for page in pages)


def replace_held(sent: list[tuple[str, str]], label: str) -> list[tuple[str, str]]:
    return [(name, label if name == "held" else value) for name, value in sent]


@pytest.mark.parametrize(("kind", "part"), [("none", "train"), ("by-goal", "test"), ("by-recipe", "test")])
def test_pages_fit_any_split(tmp_path: Path, kind: str, part: str) -> None:
    explored = explored_of(open_book("kitchen"), SplitConfig(kind), tmp_path, distractors=3)  # type: ignore[arg-type]
    shown = view_of(explored, Tasks())
    assert (shown.table.part, shown.usual) == (part, part)
    assert shown.table.counts
    assert view_of(explored, Episode()).episode.part == part
    rows = view_of(explored, Runs()).runs
    assert set(rows[0].success) == ({"train"} if kind == "none" else {"train", "test"})
    for name in ("tasks", "episode", "runs", "run"):
        assert look(explored, PAGES[name].state()).page


def test_recipes_of_one_ingredient_are_tasks_like_others(tmp_path: Path) -> None:
    rows = [("a", "a", "b"), ("b", "b", "c"), ("c", "c", "d"), ("d", "d", "e")]
    explored = explored_of(RecipeBook.of("chain", rows), SplitConfig("none"), tmp_path, distractors=2)
    found = view_of(explored, Tasks()).table.rows
    assert [(row.goal, row.start) for row in found] == [("b", ("a",)), ("c", ("b",)), ("d", ("c",)), ("e", ("d",))]
    shown = view_of(explored, Episode(goal="c", table=("b",))).episode
    assert [step.picked for step in shown.first.episode.steps] == ["b", "b"]
    assert shown.first.episode.outcome == "goal"
    assert "b + b → c" in look(explored, Episode(goal="c", table=("b",))).text


# --- runs ------------------------------------------------------------------------------------------------------------


def test_the_runs_are_what_their_records_say(agents: Explored) -> None:
    view = view_of(agents, Runs())
    assert [row.name for row in view.runs] == ["guided", "plain", "mlp"]
    for row in view.runs:
        folder = agents.runs[row.name]
        summary = json.loads((folder / "evaluation.json").read_text())
        assert {part: found.mean for part, found in row.success.items()} == {
            part: found["mean"] for part, found in summary["success"].items()
        }
        assert all(found.ci[0] <= found.mean <= found.ci[1] for found in row.success.values())
        assert (row.steps, row.status, row.is_live) == (summary["steps"], "done", False)
    guided, plain, mlp = view.runs
    assert (guided.scorer, guided.use, guided.kg) == ("kitchen-recipes", ("u", "v", "w"), "partial")
    assert (plain.scorer, plain.use, plain.lambdas, mlp.policy) == ("", (), {}, "mlp")
    last = json.loads((agents.runs["guided"] / "metrics.jsonl").read_text().splitlines()[-1])
    assert guided.lambdas["w"] == (last["lambda_w_first"], last["lambda_w_second"])
    assert view.sources == ("alpha", "u", "v", "w")


def test_a_run_shows_its_curves_and_settings_but_no_folders_of_this_machine(agents: Explored, tmp_path: Path) -> None:
    view = view_of(agents, Run("guided"))
    lines = [json.loads(line) for line in (agents.runs["guided"] / "metrics.jsonl").read_text().splitlines()]
    points = [(line["step"], line["test_success"]) for line in lines if "test_success" in line]
    assert [(point.step, point.success) for point in view.curves["test"]] == points
    assert view.settings == {"graph": "kitchen", "scorer": "kitchen-recipes", "use": "u,v,w", "steps": "4000"}
    page = look(agents, Run("guided")).page
    assert str(tmp_path.parent) not in page
    assert "data-live" not in page
    assert page.count("<svg") >= 6


def unfinished(done: Path, to: Path, status: str, lines: int, checkpoint: bool = False) -> Path:
    """A run folder as a training leaves it after some lines of metrics, the last one half written."""
    kept = ("config.toml", "policy.json", "constants.safetensors")
    to.mkdir(exist_ok=True)
    for name in kept:
        shutil.copy(done / name, to / name)
    record = json.loads((done / "run.json").read_text())
    record |= {"status": status, "ended": None if status == "running" else record["ended"], "outputs": {}}
    (to / "run.json").write_text(json.dumps(record))
    if lines:
        text = (done / "metrics.jsonl").read_text().splitlines(keepends=True)
        (to / "metrics.jsonl").write_text("".join(text[:lines]) + text[lines][:25])
    return to


@pytest.mark.parametrize("status", ["running", "interrupted", "failed"])
@pytest.mark.parametrize("lines", [0, 1, 4])
def test_a_run_that_is_not_done_is_shown_as_far_as_it_has_come(
    agents: Explored, tmp_path: Path, status: str, lines: int
) -> None:
    folder = unfinished(agents.runs["plain"], tmp_path / "live", status, lines)
    explored = Explored.open(agents.opened.source, [], [folder])
    view = view_of(explored, Run())
    written = [json.loads(line) for line in (agents.runs["plain"] / "metrics.jsonl").read_text().splitlines()[:lines]]
    assert view.row.steps == (written[-1]["step"] if written else 0)
    assert (view.row.status, view.row.is_live, view.outcomes) == (status, status == "running", {})
    assert (view.row.success == {}) == (lines == 0)
    found = look(explored, Run())
    page = found.page
    live = [attributes["data-live"] for tag, attributes in found.tags if tag == "section" and "data-live" in attributes]
    assert live == (["3"] if status == "running" else [])
    assert "checkpoint" in view.waits_for
    assert view.waits_for in found.text
    assert ("<svg" in page) == (lines > 0)
    runs = look(explored, Runs()).page
    assert ('data-live="3"' in runs) == (status == "running")
    # What needs its weights or its evaluation says what it waits for.
    tasks = view_of(explored, Tasks())
    assert tasks.missing == f"live is {status}: how often it solves each task comes with its evaluation."
    with pytest.raises(Exception, match="no checkpoint yet"):
        view_of(explored, Episode())
    for state in (Run(), Runs(), Tasks(), Episode()):
        assert page_of(state).is_live(explored, state)
        assert not page_of(state).is_live(agents, state)


def test_a_run_that_ends_while_it_is_looked_at_is_shown_as_done(agents: Explored, tmp_path: Path) -> None:
    done = agents.runs["plain"]
    folder = unfinished(done, tmp_path / "live", "running", 3)
    explored = Explored.open(agents.opened.source, [], [folder])
    seen = [view_of(explored, Run()).row.steps]
    shutil.copy(done / "metrics.jsonl", folder / "metrics.jsonl")
    seen.append(view_of(explored, Run()).row.steps)
    shutil.copytree(done, folder, dirs_exist_ok=True)
    view = view_of(explored, Run())
    assert seen == [256, 1_024]
    assert (view.row.status, view.checkpoint, view.waits_for) == ("done", "final", "")
    assert view_of(explored, Tasks()).table.counts
    assert view_of(explored, Episode()).episode.first.episode.steps
    assert not PAGES["run"].is_live(explored, Run())


def test_an_agent_answers_with_its_last_checkpoint_while_it_trains(
    kitchen_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wordcraft_kg.agents.impala import Impala

    update, seen = Impala.update, []
    trainer = replace(SHORT, checkpoint_every=320, log_every=160)

    def look(self: Impala) -> None:
        update(self)
        if self.update_number == 15:
            explored = Explored.open(kitchen_folder, [], [tmp_path / "run"])
            seen.append(view_of(explored, Episode()).episode.agents[0])
            seen.append(view_of(explored, Run()))

    monkeypatch.setattr(Impala, "update", look)
    train_agent(AgentConfig(str(kitchen_folder), None, TaskConfig(distractors=2), LEARNED, trainer), tmp_path / "run")
    agent, run = seen
    assert agent.checkpoint == run.checkpoint == "step 320"
    assert len(agent.found.episode.steps) == 2
    assert run.waits_for == "It answers with the weights of step 320, renewed every 320 steps."
    assert [point.step for point in run.curves["test"]] == [0]


BREAK: dict[str, Callable[[Path], object]] = {
    "run.json": lambda folder: (folder / "run.json").write_text("{"),
    "config.toml": lambda folder: (folder / "config.toml").write_text("[train-agent]\n"),
    "metrics.jsonl": lambda folder: (folder / "metrics.jsonl").write_text("nonsense\n"),
    "the folder": shutil.rmtree,
}


@pytest.mark.parametrize("what", BREAK)
def test_a_run_that_is_damaged_is_said_to_be_and_the_others_are_shown(
    agents: Explored, tmp_path: Path, what: str
) -> None:
    folder = unfinished(agents.runs["plain"], tmp_path / "broken", "running", 3)
    explored = Explored.open(agents.opened.source, [], [folder, agents.runs["guided"]])
    BREAK[what](folder)
    rows = view_of(explored, Runs()).runs
    assert [row.status for row in rows] == [None, "done"]
    assert rows[0].problem
    for state in (Runs(), Run("broken"), Tasks()):
        page = look(explored, state)
        assert page.text.count(rows[0].problem.split(". ")[0][:60]) == 1
        assert "data-live" not in page.page


def test_a_run_that_begins_again_is_waited_for(agents: Explored, tmp_path: Path) -> None:
    folder = unfinished(agents.runs["plain"], tmp_path / "again", "running", 3)
    explored = Explored.open(agents.opened.source, [], [folder])
    (folder / "run.json").unlink()
    found = look(explored, Run())
    assert "It has not begun yet" in found.text
    assert [attributes for _, attributes in found.tags if "data-live" in attributes]


def test_a_run_of_another_graph_is_refused_at_the_start(agents: Explored, tmp_path: Path) -> None:
    book = open_book("kitchen")
    write_graph_folder(tmp_path / "other", book, make_split(RecipeGraph.from_book(book), SplitConfig(seed=3)))
    with pytest.raises(GraphMismatchError):
        Explored.open(tmp_path / "other", [], [agents.runs["plain"]])


# --- a site of files -------------------------------------------------------------------------------------------------


def test_a_site_of_files_has_the_episodes_of_the_tasks_that_it_lists(agents: Explored) -> None:
    states = list(PAGES["episode"].states(agents))
    rows = view_of(agents, Tasks(run="plain")).table.rows
    assert {Episode(run="plain", task=row.number) for row in rows} <= set(states)
    assert set(PAGES["run"].states(agents)) == {Run("guided"), Run("plain"), Run("mlp")}
    assert list(PAGES["runs"].states(agents)) == [Runs()]
    known = {("episode", state) for state in states} | {("tasks", state) for state in PAGES["tasks"].states(agents)}

    def address(page: Any, state: State) -> str:
        return f"/{page.name}.html" if (page.name, state) in known else ""

    site = Site(agents, address, lambda file: file, is_static=True)
    for state in (Tasks(run="plain"), states[0]):
        found = Shown(site.page(page_of(state), state))
        assert "form" not in [tag for tag, attributes in found.tags if attributes.get("role") != "search"]
        assert not [attributes for tag, attributes in found.tags if tag == "a" and not attributes.get("href")]
        assert "/episode.html" in found.links


def test_a_site_of_files_has_no_episode_of_an_agent_that_cannot_be_asked(agents: Explored, tmp_path: Path) -> None:
    _, folder = agents.run()
    shutil.copytree(folder, failed := tmp_path / "failed")
    record = json.loads((failed / "run.json").read_text())
    (failed / "run.json").write_text(json.dumps(record | {"status": "failed"}))
    explored = Explored(agents.opened, runs={"done": folder, "failed": failed})
    assert {state.run for state in PAGES["tasks"].states(explored)} == {"", "done", "failed"}
    assert {state.run for state in PAGES["episode"].states(explored)} == {"", "done"}
