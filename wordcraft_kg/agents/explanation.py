"""Explanations for an agent's actions: the logit for each slot, split into contributions by sources."""

import copy
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from wordcraft_kg.agents.states import has_train_recipes
from wordcraft_kg.base.errors import ConfigError, TaskError, UnknownEntityError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.settings import nearest, whole
from wordcraft_kg.envs.batch import GOAL, IN_PROGRESS, OUT_OF_ATTEMPTS, OUTCOMES
from wordcraft_kg.envs.evaluation_tables import EvaluationTables
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.recipe_graph import Entity
from wordcraft_kg.graphs.splits import Part
from wordcraft_kg.graphs.tasks import Rows, TaskSet
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput
from wordcraft_kg.models.policies.sources import ALPHA
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.sources.source import FoldedSource, Source
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence, OutsideEvidenceFinder
from wordcraft_kg.models.scorers.cross_fitting import models_of_tasks, seen_by_models
from wordcraft_kg.models.scorers.recipes import Witness

_MAX_PAIRS = 3  # with evidence, per action
MOST_ON_TABLE = 64
"""Maximum number of entities on a custom table; computing time grows with the square."""
Model = Literal[
    "no_scorer", "no_recipes", "all_recipes", "train_recipes", "without_a_fold", "no_knowledge"
]
"""Model behind the scores, by training recipes; ``no_knowledge``: all models were trained on recipes in the plan."""


class ExpectedAttempt(Record):
    """An attempt in a plan: the pair, its expected result, and this result's probability."""

    ingredient_a: str
    ingredient_b: str
    result: str
    probability: Share

    def __str__(self) -> str:
        return (
            f"{self.ingredient_a} + {self.ingredient_b} -> {self.result} ({self.probability:.2g})"
        )


class SlotEvidence(Record):
    """Train recipes that support a slot: similar to combining the slot's entity with a partner.

    They make something like the goal or, with a plan, like the first attempt's expected result.

    Attributes:
        source: source of the recipe score.
        partner: the selection, or without selection the best partner on the table.
        because: supporting recipes, those that make the goal itself (with a plan, the expected result) first, then by
            share; a cross-fitted scorer excludes the recipes for the task.
        outside: evidence from outside the train recipes for slot, partner and this result, strongest first.
        plan: expected attempts, for sources that look ahead.
    """

    source: str
    partner: str
    because: tuple[Witness, ...]
    outside: tuple[OutsideEvidence, ...] = ()
    plan: tuple[ExpectedAttempt, ...] = ()


class ExplainedSlot(Record):
    """A slot's entity, whether a plan needs it, logit β, probability π, and scores and contributions by source."""

    entity: str
    is_part: bool
    sources: dict[str, float]
    contributions: dict[str, float]
    logit: float
    probability: Share
    evidence: SlotEvidence | None = None


class ExplainedStep(Record):
    """An action with the scores behind the choice.

    ``selection`` is the selected entity before the action, ``value`` the state value, ``made`` the results, and
    ``lambdas`` the mixing weight λ by source (empty without mixing).
    """

    selection: str | None
    value: float
    lambdas: dict[str, float]
    action: str
    made: tuple[str, ...]
    slots: Annotated[tuple[ExplainedSlot, ...], msgspec.Meta(min_length=1)]

    def best_evidence(self, limit: int = _MAX_PAIRS) -> list[tuple[str, SlotEvidence]]:
        """Return up to ``limit`` entities with the highest logits, each with evidence; no entity-partner pair twice."""
        pairs: dict[frozenset[str], tuple[str, SlotEvidence]] = {}
        for slot in sorted(self.slots, key=lambda slot: -slot.logit):
            if slot.evidence is not None and (
                slot.evidence.because or slot.evidence.outside or slot.evidence.plan
            ):
                pairs.setdefault(
                    frozenset((slot.entity, slot.evidence.partner)), (slot.entity, slot.evidence)
                )
        return list(pairs.values())[:limit]


class ExplainedEpisode(Record):
    """An episode, explained action by action; plans are lists of texts, such as "a + b -> c"."""

    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[str, ...], ...]
    outcome: str
    steps: tuple[ExplainedStep, ...]


class TableRecipe(Record):
    """A recipe in a plan from a table, with its split part; in sample if the table's model was trained on it."""

    ingredient_a: str
    ingredient_b: str
    result: str
    part: Part
    is_in_sample: bool


class ExplainedTable(Record):
    """An agent's actions at a table, the plans there, and the model behind the scores.

    Attributes:
        table: labels in slot order.
        ways: shortest plans for the goal, including distractors as ingredients.
        model: the model that gave the scores, by its training recipes.
        fold: number of the fold unseen by a cross-fitted model, or None.
        episode: the explained actions.
    """

    table: tuple[str, ...]
    ways: tuple[tuple[TableRecipe, ...], ...]
    model: Model
    fold: int | None
    episode: ExplainedEpisode

    @property
    def in_sample(self) -> tuple[TableRecipe, ...]:
        """Recipes of the plans that are training data of the model that gave the scores."""
        return tuple(
            dict.fromkeys(recipe for way in self.ways for recipe in way if recipe.is_in_sample)
        )

    @property
    def is_known(self) -> bool:
        """Whether all recipes of a plan are training data of the model that gave the scores."""
        return any(all(recipe.is_in_sample for recipe in way) for way in self.ways)


class _Query(NamedTuple):
    """A table, the policy, and the task index (None for tasks without train recipes)."""

    policy: Policy
    task: int | None
    start: tuple[str, ...]
    plans: tuple[Rows, ...]
    goal: int
    table: list[int]
    selection: int | None = None


class Explainer:
    """Explains a policy's actions by splitting logits into contributions by attention and scores; thread-safe.

    Explanations use double precision, so contributions add up to the logit, and probabilities to 1, within 1e-9.
    The policy is copied, so other tasks may be set in the original.

    Example:
        >>> agent = open_agent("runs/kitchen")
        >>> explainer = Explainer(agent.policy, World(agent.opened, agent.config.tasks.environment("test")))
        >>> explainer.table("bread", ["flour", "water", "fire"]).episode.steps[0].action in ("flour", "water", "fire")
        True
    """

    def __init__(
        self,
        policy: Policy,
        world: World,
        *,
        kg: TrainedOn = "partial",
        trained_on: NDArray[np.bool_] | None = None,
        max_actions: int | None = None,
        outside: OutsideEvidenceFinder | None = None,
    ):
        """Copy a policy; LeakError if a model would score tasks with recipes from its training data.

        ``kg`` names the recipes that the scorer was trained on: ``partial`` (train recipes) or ``full``.
        ``trained_on``, shape (num_recipes,), bool, marks those that it saw with the correct result; by default all.
        ``max_actions`` limits the explained actions; None plays to the end. ``outside`` finds evidence from outside the
        train recipes.
        """
        self.world = world
        self._kg, self._trained_on, self._max_actions, self._outside = (
            kg,
            trained_on,
            max_actions,
            outside,
        )
        self._policy = _own(policy)
        if has_train_recipes(world):
            self._policy.bind(world.tasks)
        self._exact = copy.deepcopy(
            self._policy, {id(self._policy.sources): nn.ModuleDict()}
        ).double()
        self._exact.sources = self._policy.sources
        self._names = [label.name for label in self._exact.labels]
        with torch.no_grad():
            self._weights, self._exact_weights = self._policy.weights(), self._exact.weights()
        self._tables = EvaluationTables(world)

    def episode(self, task: int, distractor_seed: int = 0) -> ExplainedEpisode:
        """Play and explain a task (index) on an evaluation table; ConfigError for a missing task or other slots."""
        return self._played(self._of_task(task, self.drawn(task, distractor_seed)))

    def task(self, task: int, distractor_seed: int = 0) -> ExplainedTable:
        """Return an :meth:`episode`'s explanation with the plans at its table and the model behind its scores."""
        return self._explained(self._of_task(task, self.drawn(task, distractor_seed)))

    def table(
        self,
        goal: Entity,
        table: Sequence[Entity],
        selection: Entity | None = None,
        *,
        like: int | None = None,
    ) -> ExplainedTable:
        """Explain the actions for a goal at any table; entities are labels or ids, the table in slot order.

        If all recipes for the goal are in one fold, a cross-fitted scorer uses the model without this fold, otherwise
        the model of all train recipes. If goal and starting ingredients agree with task ``like`` (index), the model for
        this task gives the scores.

        UnknownEntityError for an entity outside the graph; ConfigError if the table is empty, too large or has
        duplicates, ``selection`` is absent from the table, or task ``like`` does not exist.
        """
        graph, tasks = self.world.graph, self.world.tasks
        ids, target = [graph.id_of(entity) for entity in table], graph.id_of(goal)
        if not 1 <= len(ids) <= MOST_ON_TABLE:
            raise ConfigError(f"`table` of {len(ids)} entities: expected 1 to {MOST_ON_TABLE}.")
        if len(set(ids)) < len(ids):
            twice = next(entity for i, entity in enumerate(ids) if entity in ids[:i])
            raise ConfigError(
                f"`table` holds '{graph.entities[twice]}' twice: expected different entities."
            )
        selected = None if selection is None else graph.id_of(selection)
        if selected is not None and selected not in ids:
            raise ConfigError(
                f"`selection` '{graph.entities[selected]}' is not on the table: add the entity, or select nothing."
            )
        if like is not None:
            whole("like", like, 0, len(tasks) - 1)
            if tasks.goals[like] == target and {*tasks.starts[like].tolist()} <= {
                *ids,
                self.world.nothing,
            }:
                return self._explained(self._of_task(like, ids)._replace(selection=selected))
        return self._explained(self._of_table(target, ids)._replace(selection=selected))

    def drawn(self, task: int, distractor_seed: int = 0) -> list[int]:
        """Return the entity ids on an evaluation table; see :meth:`episode`."""
        return self._tables.table(task, distractor_seed)

    def _of_task(self, task: int, table: list[int]) -> _Query:
        tasks = self.world.tasks
        start = tasks.graph.labels(
            entity for entity in tasks.starts[task].tolist() if entity != self.world.nothing
        )
        number = task if has_train_recipes(self.world) else None
        return _Query(self._policy, number, start, tasks.plans[task], int(tasks.goals[task]), table)

    def _of_table(self, goal: int, table: list[int]) -> _Query:
        plans, folds = self._ways(goal, table), self._folds()
        query = _Query(self._policy, None, self.world.graph.labels(table), plans, goal, table)
        if folds is None or not plans:
            return query
        start = np.array([sorted(table)])
        posed = TaskSet(
            self.world.graph,
            self.world.config.depth,
            "all",
            np.array([goal]),
            start,
            (plans,),
            False,
            0,
        )
        if not 0 < models_of_tasks(folds, posed)[0] < len(seen_by_models(folds)) - 1:
            # No fold has a recipe of each plan: the model trained on all train recipes answers.
            return query
        policy = _own(self._policy)
        policy.bind(posed)
        return query._replace(policy=policy, task=0)

    def _ways(self, goal: int, table: Iterable[int]) -> tuple[Rows, ...]:
        world, have = self.world, frozenset(table) - {goal}
        ways = world.search.shortest_ways(
            goal, have, min(world.config.attempts, world.config.depth)
        )
        return tuple(world.search.ordered(ways, goal, have))

    def _folds(self) -> Ids | None:
        for source in self._policy.sources.values():
            if (
                isinstance(source, FoldedSource)
                and source.reads_task
                and len(source.fold_of_recipe)
            ):
                return np.asarray(source.fold_of_recipe.cpu().numpy())
        return None

    def _explained(self, query: _Query) -> ExplainedTable:
        graph, split = self.world.graph, self.world.split
        model, fold, is_seen = self._answering(query)
        ways = tuple(
            tuple(
                TableRecipe(
                    *recipe, part=get_args(Part)[split.parts[row]], is_in_sample=bool(is_seen[row])
                )
                for row, recipe in zip(
                    way, graph.recipe_labels(graph.recipes[list(way)]), strict=True
                )
            )
            for way in self._ways(query.goal, query.table)
        )
        return ExplainedTable(graph.labels(query.table), ways, model, fold, self._played(query))

    def _answering(self, query: _Query) -> tuple[Model, int | None, NDArray[np.bool_]]:
        is_train, folds = self.world.split.is_in("train"), self._folds()
        if not self._policy.sources:
            return "no_scorer", None, np.zeros_like(is_train)
        if self._kg == "none":
            return "no_recipes", None, np.zeros_like(is_train)
        if folds is None:
            is_all = self._kg == "full"
            return (
                "all_recipes" if is_all else "train_recipes",
                None,
                self._known(is_train | is_all, 0),
            )
        seen, model = seen_by_models(folds), 0
        if query.task is not None:
            source = next(
                source
                for source in query.policy.sources.values()
                if isinstance(source, FoldedSource)
            )
            model = int(source.model_of_task[query.task])
        if model == len(seen) - 1:
            return "no_knowledge", None, seen[model]
        is_known = self._known(seen[model], model)
        return (
            ("without_a_fold", model - 1, is_known) if model else ("train_recipes", None, is_known)
        )

    def _known(self, is_seen: NDArray[np.bool_], model: int) -> NDArray[np.bool_]:
        if self._trained_on is not None:
            return is_seen & self._trained_on
        for source in self._policy.sources.values():
            if isinstance(source, BestRecipe):
                recipes = torch.from_numpy(self.world.graph.recipes.copy())
                return np.asarray(is_seen & source.knows(recipes, model).numpy())
        return is_seen

    def _played(self, query: _Query) -> ExplainedEpisode:
        world, graph, nothing = self.world, self.world.graph, self.world.nothing
        plans, parts = self._plan_labels(query.plans)
        room = max(world.num_slots, len(query.table) + world.max_results * world.config.attempts)
        table, selection, attempts, is_made = (
            list(query.table),
            query.selection,
            world.config.attempts,
            False,
        )
        task = None if query.task is None else torch.tensor([query.task])
        steps: list[ExplainedStep] = []
        tried: list[tuple[int, int]] = []
        while attempts and not is_made and len(steps) != self._max_actions:
            padded = torch.tensor([[*table, *[nothing] * (room - len(table))]])
            state = States(
                torch.tensor([query.goal]),
                torch.tensor([nothing if selection is None else selection]),
                padded,
                task,
                Attempts(torch.tensor([attempts]), torch.tensor([tried or [(nothing, nothing)]])),
            )
            action, output = self._decide(query.policy, state)
            slots = _slots(
                self._names, output, graph.labels(table), parts, self._evidence(query.policy, state)
            )
            entity, made = table[action], []
            if selection is not None:
                results = world.outcomes.get((min(selection, entity), max(selection, entity)), ())
                tried.append((selection, entity))
                made = [result for result in results if result not in table]
                table += made
                is_made, attempts = query.goal in results, attempts - 1
            selected = None if selection is None else graph.entities[selection]
            lambdas = (
                {}
                if output.lambdas is None
                else dict(zip(self._names, output.lambdas[0].tolist(), strict=True))
            )
            value, label = float(output.value[0]), graph.entities[entity]
            steps.append(ExplainedStep(selected, value, lambdas, label, graph.labels(made), slots))
            selection = entity if selection is None else None
        outcome = OUTCOMES[GOAL if is_made else IN_PROGRESS if attempts else OUT_OF_ATTEMPTS]
        return ExplainedEpisode(
            graph.entities[query.goal], query.start, plans, outcome, tuple(steps)
        )

    def _evidence(self, policy: Policy, state: States) -> list[SlotEvidence | None]:
        entities, goal, find = self.world.graph.entities, int(state.goal), self._outside
        result: list[SlotEvidence | None] = [None] * state.table.shape[1]
        for name, source in policy.sources.items():
            assert isinstance(source, Source)
            for slot, evidence in enumerate(source.evidence(state)):
                if evidence is not None and (result[slot] is None or evidence.plan):
                    because = tuple(Witness.of(recipe, entities) for recipe in evidence.supporting)
                    expected = evidence.plan[0][2] if evidence.plan else goal
                    outside = (
                        find.of_recipe(int(state.table[0, slot]), evidence.partner, expected)
                        if find
                        else ()
                    )
                    plan = tuple(
                        ExpectedAttempt(entities[a], entities[b], entities[made], probability)
                        for a, b, made, probability in evidence.plan
                    )
                    result[slot] = SlotEvidence(
                        name, entities[evidence.partner], because, outside, plan
                    )
        return result

    def _plan_labels(self, plans: tuple[Rows, ...]) -> tuple[tuple[tuple[str, ...], ...], set[str]]:
        graph = self.world.graph
        labels = [graph.recipe_labels(graph.recipes[list(plan)]) for plan in plans]
        texts = tuple(tuple(f"{a} + {b} -> {result}" for a, b, result in plan) for plan in labels)
        return texts, {label for plan in labels for label in plan[-1][:2]}

    @torch.no_grad()
    def _decide(self, policy: Policy, state: States) -> tuple[int, PolicyOutput]:
        external_scores = policy.external_scores(state)
        action = int(self._policy(state, self._weights, external_scores).logits.argmax(1))
        exact = None if external_scores is None else external_scores.double()
        return action, self._exact(state, self._exact_weights, exact)


def _own(policy: Policy) -> Policy:
    return copy.deepcopy(policy, {id(tensor): tensor for tensor in policy.buffers()}).eval()


def explain_episodes(
    policy: Policy,
    world: World,
    *,
    goal: str | None = None,
    episodes: int = 3,
    outside: OutsideEvidenceFinder | None = None,
    task: int | None = None,
) -> tuple[ExplainedEpisode, ...]:
    """Play tasks greedily on the fixed evaluation tables and explain each action; see :class:`Explainer`.

    Plays the task with index ``task``, or else tasks with this ``goal``, or else evenly spaced tasks; if necessary,
    tasks repeat with different distractors until there are ``episodes``. UnknownEntityError if the goal does not exist,
    TaskError if the world has no task with the goal, ConfigError if the task does not exist.
    """
    explainer = Explainer(policy, world, outside=outside)
    if task is not None:
        whole("task", task, 0, len(world.tasks) - 1)
        return tuple(
            explainer.episode(task, distractor_seed) for distractor_seed in range(episodes)
        )
    tasks, distractor_seeds = _choose_tasks(world, goal, episodes)
    chosen = list(zip(tasks.tolist(), distractor_seeds.tolist(), strict=True))
    return tuple(
        explainer.episode(task, distractor_seed)
        for task, distractor_seed in steps("explaining", chosen)
    )


def _choose_tasks(world: World, goal: str | None, episodes: int) -> tuple[Ids, Ids]:
    graph, tasks, config = world.graph, world.tasks, world.config
    if goal is None:
        rows = np.linspace(0, len(tasks) - 1, min(episodes, len(tasks))).astype(np.int64)
        return rows, np.zeros_like(rows)
    if goal not in graph.entities:
        raise UnknownEntityError(
            f"no entity '{goal}' in {graph.name}.{nearest(goal, graph.entities)}"
        )
    rows = np.flatnonzero(tasks.goals == graph.entities.index(goal))
    if not len(rows):
        raise TaskError(
            f"no {config.part} task of depth {config.depth} has the goal '{goal}'. Choose another goal, or `part` all."
        )
    numbers = np.arange(episodes)
    return rows[numbers % len(rows)], numbers // len(rows)


def _slots(
    names: Sequence[str],
    output: PolicyOutput,
    labels: tuple[str, ...],
    parts: set[str],
    evidence: Sequence[SlotEvidence | None],
) -> tuple[ExplainedSlot, ...]:
    logits, probabilities = (
        output.logits[0].tolist(),
        torch.softmax(output.logits[0], dim=0).tolist(),
    )
    values, lambdas = output.logits, [1.0]
    if output.sources is None or output.lambdas is None:
        names = [ALPHA.name]
    else:
        values, lambdas = output.sources[0], output.lambdas[0].tolist()
    rows = []
    for i, label in enumerate(labels):
        sources = dict(zip(names, values[:, i].tolist(), strict=True))
        terms = [weight * value for weight, value in zip(lambdas, sources.values(), strict=True)]
        contributions = dict(zip(names, terms, strict=True))
        rows.append(
            ExplainedSlot(
                label,
                label in parts,
                sources,
                contributions,
                logits[i],
                probabilities[i],
                evidence[i],
            )
        )
    return tuple(rows)
