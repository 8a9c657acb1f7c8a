"""An episode with what agents thought, and what they would do at a table of one's own."""

from collections.abc import Mapping
from dataclasses import dataclass

from wordcraft_kg.agents.explanation import ExplainedTable
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.agents.outcomes import Ending
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.settings import whole
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.tasks import TaskPart


@dataclass(frozen=True)
class TableQuestion:
    """A task on one of its tables, or that with something changed.

    Attributes:
        task: number of the task among the world's.
        draw: which draw of distractors.
        goal: another goal; empty for the task's.
        table: another table, by labels; empty for the task's.
        held: what is held, by label; empty for nothing.
    """

    task: int = 0
    draw: int = 0
    goal: str = ""
    table: tuple[str, ...] = ()
    held: str = ""

    @property
    def is_edited(self) -> bool:
        """Whether it is asked of anything but the task."""
        return bool(self.goal or self.table or self.held)


class AgentAtTable(Record):
    """What an agent does at a table.

    Attributes:
        run: its name.
        checkpoint: the weights that answer; empty if it cannot be asked.
        folds: number of folds of its scorer; 0 without folds.
        found: its picks; None if it cannot be asked.
        problem: why it cannot be asked.
    """

    run: str
    checkpoint: str
    folds: Count
    found: ExplainedTable | None
    problem: str = ""


class EpisodeView(Record):
    """Agents at a table.

    Attributes:
        task: number of the task.
        tasks: number of tasks of its depth and part.
        draw: the draw of distractors.
        endings: how the first agent's episodes of the task ended in its evaluation, by draw; none if it has not played
            it, or not with so many distractors.
        start: starting ingredients of the task.
        plans: plans of the task.
        is_edited: whether goal, table or hand are other than the task's.
        goal: what is to be made.
        table: what is on the table.
        held: what is held at first; None for nothing.
        agents: the agents, the first of which the others are compared with.
    """

    part: TaskPart
    depth: int
    distractors: Count
    task: Count
    tasks: Count
    draw: Count
    endings: tuple[Ending, ...]
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    is_edited: bool
    goal: str
    table: tuple[str, ...]
    held: str | None
    agents: tuple[AgentAtTable, ...]

    @property
    def first(self) -> ExplainedTable:
        """What the first agent does."""
        found = self.agents[0].found
        assert found is not None, "the first one can be asked"
        return found


def view_episode(world: World, runs: Mapping[str, FollowedRun], question: TableQuestion) -> EpisodeView:
    """Ask agents at a table, all by the rules of one world.

    Args:
        world: graph, tasks and settings.
        runs: runs by name, one or more; that the first one cannot be asked is an error, of others it is told.
        question: the table.

    Raises:
        UnknownEntityError: with the nearest labels.
        ConfigError: if there is no such task, or the first agent cannot be asked at such a table.
        ArtefactError: if the first run has no weights yet, or is damaged.
    """
    whole("task", question.task, 0, len(world.tasks) - 1)
    task, (first, *others) = world.tasks[question.task], runs
    asked = _asked(runs[first], world, question)
    agents = [_agent(first, runs[first], asked)]
    for name in others:
        try:
            agents.append(_agent(name, runs[name], _asked(runs[name], world, question)))
        except (ArtefactError, ConfigError) as error:
            agents.append(AgentAtTable(name, "", 0, None, str(error)))
    return EpisodeView(
        part=world.config.part,
        depth=world.config.depth,
        distractors=world.config.num_distractors,
        task=question.task,
        tasks=len(world.tasks),
        draw=question.draw,
        endings=_endings(runs[first], world, question.task),
        start=task.start,
        plans=task.plans,
        is_edited=question.is_edited,
        goal=asked.episode.goal,
        table=asked.table,
        held=asked.episode.steps[0].held,
        agents=tuple(agents),
    )


def _agent(name: str, run: FollowedRun, found: ExplainedTable) -> AgentAtTable:
    agent = run.agent()
    return AgentAtTable(name, agent.checkpoint, agent.run.cross_fitted, found)


def _asked(run: FollowedRun, world: World, question: TableQuestion) -> ExplainedTable:
    explainer, graph = run.explainer(world), world.graph
    if not question.is_edited:
        return explainer.task(question.task, question.draw)
    goal = _label(graph, question.goal) if question.goal else int(world.tasks.goals[question.task])
    table = [_label(graph, label) for label in question.table] or explainer.drawn(question.task, question.draw)
    held = _label(graph, question.held) if question.held else None
    return explainer.table(goal, table, held, like=question.task)


def _label(graph: RecipeGraph, text: str) -> int:
    """Return the entity that somebody has typed; spaces around a label do not matter, unless they belong to it."""
    return graph.id_of(text if text in graph else text.strip())


def _endings(run: FollowedRun, world: World, task: int) -> tuple[Ending, ...]:
    """Return how the episodes of a task ended in the evaluation of a run."""
    tasks = run.records().config.tasks
    if (tasks.depth, tasks.distractors) != (world.config.depth, world.config.num_distractors):
        return ()
    posed = world.tasks[task]
    played = run.episodes().get((world.config.part, posed.goal, posed.start))
    return () if played is None else played.endings
