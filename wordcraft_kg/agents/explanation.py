"""Explanations for an agent's actions: a slot's logit, split into contributions by sources."""

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from wordcraft_kg.agents.states import has_train_recipes
from wordcraft_kg.base import (
    ConfigError,
    Record,
    Share,
    TaskError,
    steps,
    whole,
)
from wordcraft_kg.envs.batch import GOAL, IN_PROGRESS, OUT_OF_ATTEMPTS, OUTCOMES
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Entity, Part, TaskSet, padded
from wordcraft_kg.graphs.tasks import Rows
from wordcraft_kg.models.policies.policy import (
    Policy,
    PolicyOutput,
    checked_logits,
    selected_entities,
)
from wordcraft_kg.models.policies.sources import ALPHA
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
"""Model behind the scores, by training recipes.

``no_knowledge``: all models were trained on recipes in the plan.
"""


class ExpectedAttempt(Record):
    """An attempt in a plan.

    Attributes:
        ingredient_a, ingredient_b: the pair.
        result: the expected result.
        probability: probability that the pair makes this result.
    """

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
        because: supporting recipes, those that make the goal itself (with a plan, the expected
            result) first, then by share; a cross-fitted scorer excludes the recipes for the task.
        outside: evidence from outside the train recipes for slot, partner and this result,
            strongest first.
        plan: expected attempts, for sources that look ahead.
    """

    source: str
    partner: str
    because: tuple[Witness, ...]
    outside: tuple[OutsideEvidence, ...] = ()
    plan: tuple[ExpectedAttempt, ...] = ()


class ExplainedSlot(Record):
    """A slot's entity with the terms of its logit.

    Attributes:
        entity: label of the entity; empty for the action to combine.
        is_part: whether a plan's last recipe needs the entity.
        sources: score by source.
        contributions: mixing weight times score, by source; the sum is `logit`.
        logit: β, unnormalised, nats.
        probability: π, the softmax of the logits over the slots.
        evidence: train recipes that support the slot; None if no source gives any.
    """

    entity: str
    is_part: bool
    sources: dict[str, float]
    contributions: dict[str, float]
    logit: float
    probability: Share
    evidence: SlotEvidence | None = None


class ExplainedStep(Record):
    """An action with the scores behind the choice.

    Attributes:
        selection: selected entity before the action, of several the sum; None for the first action
            of an attempt.
        value: state value.
        lambdas: mixing weight λ by source; empty without mixing.
        action: label of the chosen entity; empty for the action to combine.
        made: new results of the attempt.
        slots: the filled slots before the action, in slot order.
    """

    selection: str | None
    value: float
    lambdas: dict[str, float]
    action: str
    made: tuple[str, ...]
    slots: Annotated[tuple[ExplainedSlot, ...], msgspec.Meta(min_length=1)]

    def best_evidence(self) -> list[tuple[str, SlotEvidence]]:
        """Return the entities with the highest logits, each with evidence.

        At most three, and no pair of entity and partner twice.
        """
        pairs: dict[frozenset[str], tuple[str, SlotEvidence]] = {}
        best_first = sorted(self.slots, key=lambda slot: -slot.logit)
        for slot in best_first:
            evidence = slot.evidence
            if evidence is not None and (evidence.because or evidence.outside or evidence.plan):
                # The same pair supports both of its slots; that with the higher logit comes first.
                pair = frozenset((slot.entity, evidence.partner))
                pairs.setdefault(pair, (slot.entity, evidence))
        return list(pairs.values())[:_MAX_PAIRS]


class ExplainedEpisode(Record):
    """An episode, explained action by action.

    Attributes:
        goal: label of the goal.
        start: starting ingredients, or the whole table if this is no task.
        plans: plans as texts, such as "a + b -> c".
        outcome: goal reached, out of attempts, or in progress if not played to the end.
        steps: the actions.
    """

    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[str, ...], ...]
    outcome: str
    steps: tuple[ExplainedStep, ...]


class TableRecipe(Record):
    """A recipe in a plan from a table.

    Attributes:
        ingredients: labels of the ingredients.
        result: label of the result.
        part: split part of the recipe.
        is_in_sample: whether the model that gave the scores was trained on the recipe.
    """

    ingredients: tuple[str, ...]
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
        recipes = dict.fromkeys(chain.from_iterable(self.ways))
        return tuple(recipe for recipe in recipes if recipe.is_in_sample)

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
    selection: tuple[int, ...] = ()


class Explainer:
    """Explains a policy's actions by splitting logits into contributions of sources; thread-safe.

    Explanations use double precision, so contributions add up to the logit, and probabilities to 1,
    within 1e-9. The policy is copied, so other tasks may be set in the original.

    Attributes:
        world: the world with the tasks.
        tables: the starting tables of evaluations.

    Example:
        >>> agent = open_agent("runs/kitchen")
        >>> world = World(agent.opened, agent.config.tasks.environment("test"))
        >>> explained = Explainer(agent.policy, world).table("bread", ["flour", "water", "fire"])
        >>> explained.episode.steps[0].action in ("flour", "water", "fire")
        True
    """

    def __init__(
        self,
        policy: Policy,
        world: World,
        *,
        trained_on: NDArray[np.bool_] | None = None,
        max_actions: int | None = None,
        outside: OutsideEvidenceFinder | None = None,
    ):
        """Copy a policy.

        Args:
            policy: the policy.
            world: the world with the tasks.
            trained_on: shape (num_recipes,), bool: recipes that the scorer saw with the correct
                result; None for all train recipes.
            max_actions: most actions to explain; None plays to the end.
            outside: finder for evidence from outside the train recipes; None without such
                knowledge.

        Raises:
            LeakError: if a model would score tasks with recipes from its training data.
            GraphMismatchError: if the tasks belong to another graph or split than a cross-fitted
                scorer.
        """
        self.world = world
        self._trained_on = world.split.is_in("train") if trained_on is None else trained_on
        self._max_actions = max_actions
        self._outside = outside
        self._policy = _own(policy)
        if has_train_recipes(world):
            self._policy.bind(world.tasks)
        # A copy in double precision without the sources, whose tables may take gigabytes; both
        # policies share them.
        without_sources = {id(self._policy.sources): nn.ModuleDict()}
        self._exact = copy.deepcopy(self._policy, without_sources).double()
        self._exact.sources = self._policy.sources
        self._names = [label.name for label in self._exact.labels]
        with torch.no_grad():
            self._weights = self._policy.weights()
            self._exact_weights = self._exact.weights()
        self.tables = EvaluationTables(world)

    def task(self, task: int, distractor_seed: int = 0) -> ExplainedTable:
        """Play and explain a task (index) on an evaluation table.

        Raises:
            ConfigError: if there is no such task or table, or the policy has other slots.
        """
        return self._explained(self._of_task(task, self.tables.table(task, distractor_seed)))

    def table(
        self,
        goal: Entity,
        table: Sequence[Entity],
        selection: Entity | Iterable[Entity] | None = None,
        *,
        like: int | None = None,
    ) -> ExplainedTable:
        """Explain the actions for a goal at any table.

        If all recipes for the goal are in one fold, a cross-fitted scorer uses the model without
        this fold, otherwise the model of all train recipes.

        Args:
            goal: label or id of the goal.
            table: labels or ids, in slot order.
            selection: label or id of the entity that is selected at the start, or several of them;
                None for nothing.
            like: index of a task. If goal and starting ingredients agree, the model for this task
                gives the scores. None for a table of no task.

        Returns:
            The explained actions, the plans at the table and the model behind the scores.

        Raises:
            UnknownEntityError: for an entity outside the graph.
            ConfigError: if the table is empty, too large or has duplicates, ``selection`` is absent
                from the table or complete, or task ``like`` does not exist.
        """
        graph = self.world.graph
        tasks = self.world.tasks
        ids = self.world.checked_table(table, MOST_ON_TABLE)
        target = graph.id_of(goal)
        selected = tuple(map(graph.id_of, selected_entities(selection)))
        for entity in selected:
            if entity not in ids:
                raise ConfigError(
                    f"`selection` '{graph.entities[entity]}' is not on the table: add the entity, "
                    "or select nothing."
                )
        if len(selected) >= graph.most_ingredients:
            raise ConfigError(
                f"`selection` of {len(selected)} entities: expected at most "
                f"{graph.most_ingredients - 1}."
            )
        if like is not None:
            whole("like", like, 0, len(tasks) - 1)
            start = self.world.without_nothing(tasks.starts[like].tolist())
            if tasks.goals[like] == target and {*start} <= {*ids}:
                return self._explained(self._of_task(like, ids)._replace(selection=selected))
        return self._explained(self._of_table(target, ids)._replace(selection=selected))

    def _of_task(self, task: int, table: list[int]) -> _Query:
        tasks = self.world.tasks
        start = tasks.graph.labels(self.world.without_nothing(tasks.starts[task].tolist()))
        # Without train recipes in the tasks, no model has to be chosen by task.
        number = task if has_train_recipes(self.world) else None
        goal = int(tasks.goals[task])
        return _Query(self._policy, number, start, tasks.plans[task], goal, table)

    def _of_table(self, goal: int, table: list[int]) -> _Query:
        plans = self._ways(goal, table)
        source = _folded(self._policy)
        query = _Query(self._policy, None, self.world.graph.labels(table), plans, goal, table)
        if source is None or not plans:
            return query
        folds = source.fold_of_recipe.cpu().numpy()
        # A task of one's own from this table, so that its model is chosen as for the world's tasks.
        posed = TaskSet(
            self.world.graph,
            self.world.config.depth,
            "all",
            np.array([goal]),
            np.array([sorted(table)]),
            (plans,),
            False,
            0,
        )
        (model,) = models_of_tasks(folds, posed)
        no_model = len(seen_by_models(folds)) - 1
        if not 0 < model < no_model:
            # No fold has a recipe of each plan: the model trained on all train recipes answers.
            return query
        policy = _own(self._policy)
        policy.bind(posed)
        return query._replace(policy=policy, task=0)

    def _ways(self, goal: int, table: Iterable[int]) -> tuple[Rows, ...]:
        world = self.world
        # A goal on the table may still have to be made, so it is no ingredient of its own plan.
        have = frozenset(table) - {goal}
        attempts = min(world.config.attempts, world.config.depth)
        ways = world.search.shortest_ways(goal, have, attempts)
        return tuple(world.search.ordered(ways, goal, have))

    def _explained(self, query: _Query) -> ExplainedTable:
        graph = self.world.graph
        model, fold, is_seen = self._answering(query)
        parts = get_args(Part)
        ways = []
        for way in self._ways(query.goal, query.table):
            recipes = graph.recipe_labels(graph.sets[list(way)])
            table_recipes = [
                TableRecipe(
                    ingredients=recipe.ingredients,
                    result=recipe.result,
                    part=parts[self.world.split.parts[row]],
                    is_in_sample=bool(is_seen[row]),
                )
                for row, recipe in zip(way, recipes, strict=True)
            ]
            ways.append(tuple(table_recipes))
        return ExplainedTable(
            table=graph.labels(query.table),
            ways=tuple(ways),
            model=model,
            fold=fold,
            episode=self._played(query),
        )

    def _answering(self, query: _Query) -> tuple[Model, int | None, NDArray[np.bool_]]:
        """Return the model that gives the scores, the fold it has not seen, and its recipes."""
        source = _folded(query.policy)
        is_known = self._trained_on
        if not self._policy.sources:
            return "no_scorer", None, np.zeros_like(is_known)
        if not is_known.any():
            return "no_recipes", None, is_known
        model = 0
        if source is not None:
            seen_recipes = seen_by_models(source.fold_of_recipe.cpu().numpy())
            # Model 0 is that of all train recipes, model i + 1 lacks fold i, the last is no model.
            model = 0 if query.task is None else int(source.model_of_task[query.task])
            is_known = is_known & seen_recipes[model]
            if model == len(seen_recipes) - 1:
                return "no_knowledge", None, is_known
        if model:
            return "without_a_fold", model - 1, is_known
        has_test_recipes = (is_known & ~self.world.split.is_in("train")).any()
        return "all_recipes" if has_test_recipes else "train_recipes", None, is_known

    def _played(self, query: _Query) -> ExplainedEpisode:
        world = self.world
        graph = world.graph
        nothing = world.nothing
        plans, parts = self._plan_labels(query.plans)
        # Slots for the results of all attempts; at least as many as an MLP was trained with.
        most_results = world.max_results * world.config.attempts
        room = max(world.num_slots, len(query.table) + most_results + world.has_combine)
        table = list(query.table)
        picks = list(query.selection)
        most_picks = graph.most_ingredients
        attempts = world.config.attempts
        is_made = False
        task = None if query.task is None else torch.tensor([query.task])
        steps: list[ExplainedStep] = []
        tried: list[list[int]] = []
        while attempts and not is_made and len(steps) != self._max_actions:
            selection = torch.from_numpy(padded([picks], nothing, most_picks))
            tried_sets = torch.from_numpy(padded(tried, nothing, most_picks))
            # A batch of one state.
            state = States(
                goal=torch.tensor([query.goal]),
                selection=selection if world.has_combine else selection[:, 0],
                table=torch.from_numpy(padded([table], nothing, room)),
                task=task,
                attempts=Attempts(torch.tensor([attempts]), tried_sets[None]),
            )
            action, output = self._decide(query.policy, state)
            evidence = self._evidence(query.policy, state)
            labels = dict(enumerate(graph.labels(table)))
            if world.has_combine and picks:
                labels[room - 1] = ""
            slots = tuple(_slots(self._names, output, labels, parts, evidence))
            selected = " + ".join(graph.labels(picks)) or None
            made_ids: list[int] = []
            if action < len(table):
                picks.append(table[action])
            if action >= len(table) or len(picks) == most_picks:
                results = world.outcomes.get(tuple(sorted(picks)), ())
                tried.append(picks)
                made_ids = [result for result in results if result not in table]
                table += made_ids
                is_made = query.goal in results
                attempts -= 1
                picks = []
            # Without mixing, there are neither names nor weights.
            lambdas = [] if output.lambdas is None else output.lambdas[0].tolist()
            steps.append(
                ExplainedStep(
                    selection=selected,
                    value=float(output.value[0]),
                    lambdas=dict(zip(self._names, lambdas, strict=False)),
                    action=labels[action],
                    made=graph.labels(made_ids),
                    slots=slots,
                )
            )
        outcome = GOAL if is_made else OUT_OF_ATTEMPTS
        if attempts and not is_made:
            outcome = IN_PROGRESS
        return ExplainedEpisode(
            graph.entities[query.goal], query.start, plans, OUTCOMES[outcome], tuple(steps)
        )

    def _evidence(self, policy: Policy, state: States) -> list[SlotEvidence | None]:
        """Return each slot's evidence: a plan if a source has one, else the first source's."""
        entities = self.world.graph.entities
        result: list[SlotEvidence | None] = [None] * state.table.shape[1]
        for name, source in policy.sources.items():
            assert isinstance(source, Source)
            for slot, evidence in enumerate(source.evidence(state)):
                if evidence is None or (result[slot] is not None and not evidence.plan):
                    continue
                # A plan's first attempt need not make the goal: evidence is for its own result.
                expected = evidence.plan[0][2] if evidence.plan else int(state.goal)
                pair = int(state.table[0, slot]), evidence.partner
                outside = self._outside.of_recipe(*pair, expected) if self._outside else ()
                plan = [
                    ExpectedAttempt(entities[a], entities[b], entities[product], probability)
                    for a, b, product, probability in evidence.plan
                ]
                result[slot] = SlotEvidence(
                    source=name,
                    partner=entities[evidence.partner],
                    because=tuple(Witness.of(recipe, entities) for recipe in evidence.supporting),
                    outside=outside,
                    plan=tuple(plan),
                )
        return result

    def _plan_labels(self, plans: tuple[Rows, ...]) -> tuple[tuple[tuple[str, ...], ...], set[str]]:
        """Return plans as texts, and the ingredients of their last recipes."""
        graph = self.world.graph
        texts = []
        parts: set[str] = set()
        for plan in plans:
            recipes = graph.recipe_labels(graph.sets[list(plan)])
            texts.append(tuple(map(str, recipes)))
            parts.update(recipes[-1].ingredients)
        return tuple(texts), parts

    @torch.no_grad()
    def _decide(self, policy: Policy, state: States) -> tuple[int, PolicyOutput]:
        # The action is that of the policy in single precision, as in play: in double precision a
        # tie could fall the other way. Only the shown numbers are exact.
        external_scores = policy.external_scores(state)
        action = int(self._policy.best_slots(state, self._weights, external_scores))
        exact = None if external_scores is None else external_scores.double()
        return action, self._exact(state, self._exact_weights, exact)


def _own(policy: Policy) -> Policy:
    # Buffers are shared, because they never change and may take gigabytes; weights are copied.
    shared = {id(tensor): tensor for tensor in policy.buffers()}
    return copy.deepcopy(policy, shared).eval()


def _folded(policy: Policy) -> FoldedSource | None:
    """Return a source with the models of folds, which are the same in all; None without one."""
    sources = (source for source in policy.folded_sources if len(source.fold_of_recipe))
    return next(sources, None)


def explain_episodes(
    policy: Policy,
    world: World,
    *,
    goal: str | None = None,
    episodes: int = 3,
    outside: OutsideEvidenceFinder | None = None,
    task: int | None = None,
) -> tuple[ExplainedEpisode, ...]:
    """Play tasks greedily on the fixed evaluation tables and explain each action.

    Args:
        policy: the policy, see :class:`Explainer`.
        world: the world with the tasks.
        goal: label of the goal of all tasks; None for evenly spaced tasks.
        episodes: number of episodes; if necessary, tasks repeat with different distractors.
        outside: finder for evidence from outside the train recipes; None without such knowledge.
        task: index of the only task to play; None for tasks by ``goal``.

    Returns:
        The episodes.

    Raises:
        UnknownEntityError: if the goal does not exist.
        TaskError: if the world has no task with the goal.
        ConfigError: if the task does not exist, or the policy has other slots.
        LeakError: if a model would score tasks with recipes from its training data.
        GraphMismatchError: if the tasks belong to another graph or split than a cross-fitted
            scorer.
    """
    explainer = Explainer(policy, world, outside=outside)
    tasks = world.tasks
    if task is not None:
        rows = np.array([whole("task", task, 0, len(tasks) - 1)])
    elif goal is not None:
        rows = np.flatnonzero(tasks.goals == world.graph.id_of(goal))
        if not len(rows):
            raise TaskError(
                f"no {world.config.part} task of depth {world.config.depth} has the goal '{goal}'. "
                "Choose another goal, or `part` all."
            )
    else:
        # Evenly spaced, because neighbouring tasks have the same goal; each on its first table.
        episodes = min(episodes, len(tasks))
        rows = np.linspace(0, len(tasks) - 1, episodes).astype(np.int64)
    # All tasks with the first table, then all with the second one.
    tables = [(int(rows[n % len(rows)]), n // len(rows)) for n in range(episodes)]
    return tuple(explainer.task(*table).episode for table in steps("explaining", tables))


def _slots(
    names: Sequence[str],
    output: PolicyOutput,
    labels: Mapping[int, str],
    parts: set[str],
    evidence: Sequence[SlotEvidence | None],
) -> Iterator[ExplainedSlot]:
    # The only state of the batch.
    own_logits = checked_logits(output.logits)[0]
    logits = own_logits.tolist()
    probabilities = torch.softmax(own_logits, dim=0).tolist()
    if output.sources is None or output.lambdas is None:
        # Without mixing, the logits are those of attention alone.
        names = [ALPHA.name]
        values = output.logits
        lambdas = [1.0]
    else:
        values = output.sources[0]
        lambdas = output.lambdas[0].tolist()
    for i, label in labels.items():
        sources = dict(zip(names, values[:, i].tolist(), strict=True))
        contributions = {
            name: weight * sources[name] for name, weight in zip(names, lambdas, strict=True)
        }
        yield ExplainedSlot(
            entity=label,
            is_part=label in parts,
            sources=sources,
            contributions=contributions,
            logit=logits[i],
            probability=probabilities[i],
            evidence=evidence[i],
        )
