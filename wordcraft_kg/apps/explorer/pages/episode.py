"""The episode page."""

from collections.abc import Iterable, Iterator
from functools import cache
from operator import attrgetter

from wordcraft_kg.agents.explanation import ExplainedStep, ExplainedTable
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.agents.outcomes import TerminationReason
from wordcraft_kg.apps.explorer.explored import AskedDepth, AskedPart, Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages.games import GamesState, list_games
from wordcraft_kg.apps.explorer.pages.tasks import PAGE as TASKS
from wordcraft_kg.apps.explorer.pages.tasks import list_tasks
from wordcraft_kg.base.errors import ArtefactError, ConfigError, WordCraftKGError
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.settings import whole
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.tasks import TaskPart

LISTED_SEEDS = 5
"""Distractor seeds offered on the page, as many as the evaluation uses."""
MOST_ROWS = 160
"""Maximum rows of slots on a page; large pages show only the best slots of each action."""


class EpisodeState(PageState):
    """Page settings: a task, the agents that act, and changes by the visitor to goal, table or selection, by labels.

    Depth 0 and negative ``distractors`` are as in the agent's training.
    """

    run: str = ""
    other: tuple[str, ...] = ()
    part: AskedPart = ""
    depth: AskedDepth = 0
    task: int = 0
    distractor_seed: int = 0
    distractors: int = -1
    goal: str = ""
    table: tuple[str, ...] = ()
    selection: str = ""

    @property
    def labels(self) -> tuple[str, ...]:
        """Entities that the visitor put on the table; empty for the task's own table."""
        return tuple(label for label in self.table if label)

    @property
    def is_edited(self) -> bool:
        """Whether the visitor changed goal, table or selection."""
        return bool(self.goal or self.labels or self.selection)


class AgentAtTable(Record):
    """An agent's actions at the shown table, or the problem that prevents them; ``folds`` counts the scorer's folds."""

    run: str
    checkpoint: str
    folds: Count
    explained: ExplainedTable | None
    problem: str = ""


class Pick(Record):
    """A chosen entity with the scores and the probability that the first agent gives to this choice, if known."""

    entity: str
    sources: dict[str, float]
    probability: Share | None


class Attempt(Record):
    """A combined pair and the new entities."""

    picks: tuple[Pick, Pick]
    made: tuple[str, ...]


class PlayerAtTable(Record):
    """A player's attempts at the table (None for a lost attempt); success is None for an unfinished game."""

    player: str
    kind: str
    attempts: tuple[Attempt | None, ...]
    success: bool | None


class EpisodeView(Record):
    """A task, the entities on its table, and the actions by one or more agents there.

    ``players`` are the agents and the players of recorded games at this table; empty for a single agent.

    ``terminations`` are from the first agent's evaluation, by distractor seed; empty if it did not play this task.
    The page offers ``runs`` and ``distractor_seeds``, and lists at most ``most_slots`` for each action.
    """

    runs: tuple[str, ...]
    distractor_seeds: Count
    trained_with: Count
    most_slots: Count
    part: TaskPart
    depth: int
    distractors: Count
    task: Count
    tasks: Count
    distractor_seed: Count
    terminations: tuple[TerminationReason, ...]
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    is_edited: bool
    goal: str
    table: tuple[str, ...]
    selection: str | None
    agents: tuple[AgentAtTable, ...]
    players: tuple[PlayerAtTable, ...]

    @property
    def first(self) -> ExplainedTable:
        """The main agent's actions, with which other agents are compared."""
        actions = self.agents[0].explained
        assert actions is not None, "a problem of the first agent is an error"
        return actions


def _view(explored: Explored, state: EpisodeState) -> EpisodeView:
    first, run = explored.followed(state.run)
    tasks = explored.tasks_of(run)
    distractors = None if state.distractors < 0 else state.distractors
    world = explored.world_of(explored.settings_of(tasks, state.part, state.depth, distractors))
    others = dict(explored.followed(other) for other in state.other if other)
    whole("task", state.task, 0, len(world.tasks) - 1)
    task, explained = world.tasks[state.task], _explained(run, world, state)
    agents = [_agent(first, run, explained)]
    for name, other in others.items():
        if name != first:
            try:
                agents.append(_agent(name, other, _explained(other, world, state)))
            except (ArtefactError, ConfigError) as error:
                agents.append(AgentAtTable(name, "", 0, None, str(error)))
    steps = sum(len(agent.explained.episode.steps) for agent in agents if agent.explained)
    terminations = _terminations(run, world, state.task)
    return EpisodeView(
        runs=tuple(explored.runs),
        distractor_seeds=max(LISTED_SEEDS, len(terminations)),
        trained_with=tasks.distractors,
        most_slots=max(MOST_ROWS // steps, 4),
        part=world.config.part,
        depth=world.config.depth,
        distractors=world.config.num_distractors,
        task=state.task,
        tasks=len(world.tasks),
        distractor_seed=state.distractor_seed,
        terminations=terminations,
        start=task.start,
        plans=task.plans,
        is_edited=state.is_edited,
        goal=explained.episode.goal,
        table=explained.table,
        selection=explained.episode.steps[0].selection,
        agents=tuple(agents),
        players=tuple(_players(explored, run, world, state, agents)),
    )


def _players(
    explored: Explored,
    run: FollowedRun,
    world: World,
    state: EpisodeState,
    agents: list[AgentAtTable],
) -> Iterator[PlayerAtTable]:
    tables = [agent.explained for agent in agents if agent.explained]
    goal, table, graph = tables[0].episode.goal, tables[0].table, world.graph
    games, explainer = explored.games.get((goal, frozenset(table)), []), run.explainer(world)

    @cache
    def first_step(have: tuple[str, ...], selection: str | None) -> ExplainedStep:
        return explainer.table(goal, have, selection, like=state.task).episode.steps[0]

    def pick(label: str, have: tuple[str, ...], selection: str | None) -> Pick:
        for slot in (
            first_step(have, selection).slots if {label, selection or label} <= {*have} else ()
        ):
            if slot.entity == label:
                return Pick(label, slot.sources, slot.probability)
        return Pick(label, {}, None)

    def attempts(pairs: Iterable[tuple[str, str] | None]) -> Iterator[Attempt | None]:
        have = table
        for pair in pairs:
            if pair is None:
                yield None
                continue
            one, other = sorted(map(graph.id_of, pair))
            made = [
                label
                for label in graph.labels(world.outcomes.get((one, other), ()))
                if label not in have
            ]
            yield Attempt((pick(pair[0], have, None), pick(pair[1], have, pair[0])), tuple(made))
            have += tuple(made)

    if games or len(agents) > 1:
        for agent in agents:
            if (actions := agent.explained) is not None:
                outcome, steps = actions.episode.outcome, actions.episode.steps
                labels = [
                    label
                    for label in (steps[0].selection, *(step.action for step in steps))
                    if label
                ]
                pairs = zip(labels[::2], labels[1::2], strict=False)
                success = None if outcome == "in_progress" else outcome == "goal"
                yield PlayerAtTable(agent.run, "agent", tuple(attempts(pairs)), success)
        for game in games:
            yield PlayerAtTable(game.player, game.kind, tuple(attempts(game.pairs)), game.success)


def _agent(name: str, run: FollowedRun, actions: ExplainedTable) -> AgentAtTable:
    agent = run.agent()
    return AgentAtTable(name, agent.checkpoint, agent.run.cross_fitted, actions)


def _explained(run: FollowedRun, world: World, state: EpisodeState) -> ExplainedTable:
    explainer, graph = run.explainer(world), world.graph
    if not state.is_edited:
        return explainer.task(state.task, state.distractor_seed)
    goal = _label(graph, state.goal) if state.goal else int(world.tasks.goals[state.task])
    table = [_label(graph, label) for label in state.labels] or explainer.drawn(
        state.task, state.distractor_seed
    )
    selection = _label(graph, state.selection) if state.selection else None
    return explainer.table(goal, table, selection, like=state.task)


def _label(graph: RecipeGraph, text: str) -> int:
    return graph.id_of(text if text in graph else text.strip())


def _terminations(run: FollowedRun, world: World, task: int) -> tuple[TerminationReason, ...]:
    tasks = run.records().config.tasks
    if (tasks.depth, tasks.distractors) != (world.config.depth, world.config.num_distractors):
        return ()
    posed = world.tasks[task]
    played = run.episodes().get((world.config.part, posed.goal, posed.start))
    return () if played is None else played.terminations


def _is_live(explored: Explored, state: EpisodeState) -> bool:
    return explored.is_any_live(state.run, *filter(None, state.other))


def _exported(explored: Explored) -> Iterator[EpisodeState]:
    if explored.games:
        yield from (
            EpisodeState(**row.settings) for row in list_games(explored, GamesState()).tables
        )
    for tasks in TASKS.states(explored):
        try:
            explored.followed(tasks.run)[1].agent()  # an error without weights
            rows = list_tasks(explored, tasks).table.rows
        except WordCraftKGError:
            continue
        yield from (EpisodeState(run=tasks.run, task=row.number) for row in rows)


PAGE = Page(
    "episode",
    EpisodeState,
    _view,
    "Episodes",
    exported=_exported,
    is_there=attrgetter("runs"),
    is_live=_is_live,
)
