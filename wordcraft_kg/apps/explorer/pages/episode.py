"""The episode page: agents' actions at a table, explained.

``_view`` first: it asks each agent to act at the table that the settings describe.
"""

from collections.abc import Iterator
from operator import attrgetter

from wordcraft_kg.agents.agent_records import TerminationReason
from wordcraft_kg.agents.explanation import ExplainedTable
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import AskedDepth, AskedPart, Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages.tasks import PAGE as TASKS, list_tasks
from wordcraft_kg.base import ArtefactError, ConfigError, Count, Record, WordCraftKGError, whole
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Recipe, TaskPart

MOST_ROWS = 160
"""Maximum rows of slots on a page; large pages show only the best slots of each action."""


class EpisodeState(PageState):
    """Page settings: a task, the agents that act, and the visitor's changes to the table.

    Attributes:
        run: name of the first agent's run; empty for the first run.
        other: names of the runs of agents to compare with it; empty names are ignored.
        part: part of the task; empty for the usual part.
        depth: depth of the task, in crafts; 0 for the first agent's training depth.
        task: number of the task among those of its depth and part.
        distractor_seed: seed of the distractors on the task's own table.
        distractors: number of distractors; negative for as many as in the first agent's training.
        goal: another goal; empty for the task's own.
        table: another table; empty labels are ignored, since forms send empty fields.
        selection: entity that is selected at the start; empty for none.
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
    """An agent's actions at the shown table, or the problem that prevents them.

    Attributes:
        run: name of the agent's run.
        checkpoint: weights that act; empty if the agent cannot act.
        explained: the actions; None if the agent cannot act.
        problem: reason why the agent cannot act.
    """

    run: str
    checkpoint: str = ""
    explained: ExplainedTable | None = None
    problem: str = ""


class EpisodeView(Record):
    """A task, the entities on its table, and the actions of one or more agents there.

    Attributes:
        most_slots: most slots to list for each action.
        part: part of the task.
        depth: depth of the task, in crafts.
        distractors: number of distractors on the task's own table.
        tasks: number of tasks with this depth and part.
        terminations: termination reasons in the first agent's evaluation, by distractor seed; empty
            if the agent did not play this task, or played it with another number of distractors.
        start: labels of the task's starting ingredients.
        plans: plans that make the task's goal, as recipes in turn.
        goal: label of the goal.
        table: labels of the entities on the table.
        selection: label of the entity that is selected at the start; None for none.
        agents: the agents; the others are compared with the first, which acts.
    """

    most_slots: Count
    part: TaskPart
    depth: int
    distractors: Count
    tasks: Count
    terminations: tuple[TerminationReason, ...]
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    goal: str
    table: tuple[str, ...]
    selection: str | None
    agents: tuple[AgentAtTable, ...]


def _view(explored: Explored, state: EpisodeState) -> EpisodeView:
    """Return the page: a task of the main agent's world, and what each agent does at its table."""
    main_name, main_run = explored.followed(state.run)
    distractors = None if state.distractors < 0 else state.distractors
    # All agents act by the rules of one world, that of the first agent.
    world = explored.world_of(explored.settings_of(main_run, state.part, state.depth, distractors))
    # A dict, so that a run that is given twice is shown once; the first is shown above.
    other_runs = dict(explored.followed(name) for name in state.other if name)
    other_runs.pop(main_name, None)
    whole("task", state.task, 0, len(world.tasks) - 1)
    task = world.tasks[state.task]
    explained = _explained(main_run, world, state)
    agents = [AgentAtTable(main_name, main_run.agent().checkpoint, explained)]
    for name, run in other_runs.items():
        # A problem of another agent does not keep the first from acting.
        try:
            actions = _explained(run, world, state)
            agents.append(AgentAtTable(name, run.agent().checkpoint, actions))
        except (ArtefactError, ConfigError) as error:
            agents.append(AgentAtTable(name, problem=str(error)))
    steps = sum(len(agent.explained.episode.steps) for agent in agents if agent.explained)
    return EpisodeView(
        most_slots=max(MOST_ROWS // steps, 4),
        part=world.config.part,
        depth=world.config.depth,
        distractors=world.config.num_distractors,
        tasks=len(world.tasks),
        terminations=_terminations(main_run, world, state.task),
        start=task.start,
        plans=task.plans,
        goal=explained.episode.goal,
        table=explained.table,
        selection=explained.episode.steps[0].selection,
        agents=tuple(agents),
    )


def _explained(run: FollowedRun, world: World, state: EpisodeState) -> ExplainedTable:
    """Return an agent's actions at the task's table, or at the visitor's."""
    explainer = run.explainer(world)
    graph = world.graph
    if not state.is_edited:
        return explainer.task(state.task, state.distractor_seed)
    goal = graph.id_of(state.goal) if state.goal else int(world.tasks.goals[state.task])
    # A visitor may change the goal alone, and keep the task's table.
    table = [graph.id_of(label) for label in state.labels]
    if not table:
        table = explainer.tables.table(state.task, state.distractor_seed)
    selection = [graph.id_of(state.selection)] if state.selection else []
    return explainer.table(goal, table, selection, like=state.task)


def _terminations(run: FollowedRun, world: World, task: int) -> tuple[TerminationReason, ...]:
    tasks = run.records().config.tasks
    config = world.config
    # The evaluation had tables of the training's size: its results say nothing about other tables.
    if tasks.depth != config.depth or tasks.distractors != config.num_distractors:
        return ()
    posed = world.tasks[task]
    played = run.episodes().get((config.part, posed.goal, posed.start))
    return () if played is None else played.terminations


def _exported(explored: Explored) -> Iterator[EpisodeState]:
    # The tasks that the site's task pages list; all tasks may be thousands.
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
)
