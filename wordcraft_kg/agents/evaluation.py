"""Evaluation of policies and players on all tasks in a part of the split, on fixed tables."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_records import TERMINATION_REASONS, Success, TerminationReason
from wordcraft_kg.agents.players import Player
from wordcraft_kg.agents.states import ROWS, bind_tasks, states_of
from wordcraft_kg.base import (
    MAX_SIZE,
    Count,
    Record,
    Share,
    check_memory,
    counted,
    steps,
    whole,
)
from wordcraft_kg.base.statistics import task_bootstrap
from wordcraft_kg.envs.batch import GOAL, BatchEngine, State
from wordcraft_kg.envs.draws import (
    EVALUATION_SEED,
    MOST_TASKS,
    default_seeds,
    sampled_tasks,
    warn_of_sample,
)
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import GraphLike, Ids, padded
from wordcraft_kg.models.policies.policy import Policy

# An odd factor of a 64-bit linear congruential generator: a product with it loses no bits.
_HASH_FACTOR = 6_364_136_223_846_793_005


@dataclass(frozen=True)
class PolicyPlayer:
    """A player that takes the best action under a policy's current weights.

    Ties go to the first slot.

    Attributes:
        policy: the policy.
        silent: names of its sources whose scores are 0 in this player.
    """

    policy: Policy
    silent: Collection[str] = ()

    @torch.no_grad()
    def __call__(self, state: State, rng: np.random.Generator) -> Any:
        """Return the best slot in each of N environments, shape (N,).

        Raises:
            LeakError: if a source would score a task by a model trained on the task's recipes.
            GraphMismatchError: if the tasks belong to another graph or split than a cross-fitted
                scorer.
        """
        bind_tasks([self.policy], state.world)
        states = states_of(state)
        # The same for all states, and costly: vectors of all entities.
        weights = self.policy.weights()
        device = next(self.policy.parameters()).device
        slot_batches = []
        for start in range(0, state.num_envs, ROWS):
            batch = states.rows(start, start + ROWS, device)
            scores = self.policy.external_scores(batch, self.silent)
            slot_batches.append(self.policy.best_slots(batch, weights, scores))
        slots = torch.cat(slot_batches)
        return slots if state.engine.arrays.on_device else slots.cpu().numpy()


@dataclass(frozen=True)
class Evaluation:
    """Outcomes on N tasks, each with D distractor seeds (samples of distractors).

    Attributes:
        tasks: shape (N,), int64: indices into the world's tasks.
        groups: shape (N,), int64: each task's resampling group, see :attr:`World.groups`.
        success: shape (N, D), bool: the episode reached the goal.
        by_plan: shape (N, D), bool: a plan's last pair made the goal.
        actions: shape (N, D), int64: episode length in actions.
        terminations: shape (N, D), int8: index into :data:`TERMINATION_REASONS`.
        decisions: shape (N, D), int64: hash of the attempted pairs, in order of attempts but not of
            actions.
    """

    tasks: Ids
    groups: Ids
    success: NDArray[np.bool_]
    by_plan: NDArray[np.bool_]
    actions: Ids
    terminations: NDArray[np.int8]
    decisions: Ids

    def metrics(self) -> Success:
        """Return the mean success with a 95 % interval over groups of tasks, and sample sizes."""
        low, high = task_bootstrap(self.success, self.groups)
        tasks, distractor_seeds = self.success.shape
        return Success(
            float(self.success.mean()),
            low,
            high,
            tasks,
            distractor_seeds,
            float(self.by_plan.mean()),
            float(self.actions.mean()),
        )

    def shares(self) -> dict[TerminationReason, Share]:
        """Return the share of episodes for each termination reason."""
        return {
            name: float((self.terminations == code).mean())
            for code, name in enumerate(TERMINATION_REASONS)
        }


class Evaluator:
    """Plays all tasks in a world, or an evenly spaced sample, on fixed starting tables."""

    def __init__(
        self,
        world: World,
        *,
        distractor_seeds: int | None = None,
        limit: int = MOST_TASKS,
        seed: int = EVALUATION_SEED,
    ):
        """Create an environment for each of at most ``limit`` tasks.

        Args:
            world: graph, tasks and settings.
            distractor_seeds: tables per task; None for
                :func:`~wordcraft_kg.envs.draws.default_seeds`.
            limit: most tasks; of more, evenly spaced ones are played.
            seed: draws the tables.

        Raises:
            ConfigError: if ``distractor_seeds`` or ``limit`` is below 1, or the episodes do not fit
                into memory.
        """
        self.tasks = sampled_tasks(world, whole("limit", limit, 1))
        warn_of_sample(world, self.tasks, limit)
        if distractor_seeds is None:
            distractor_seeds = default_seeds(len(world.tasks))
        self.distractor_seeds = whole("distractor_seeds", distractor_seeds, 1, MAX_SIZE)
        check_memory(
            "distractor_seeds",
            distractor_seeds,
            f"the episodes of {len(self.tasks):,} tasks",
            distractor_seeds * len(self.tasks) * 11,
        )
        self.engine = BatchEngine(world, len(self.tasks))
        self._seed = seed
        # The ingredients in the last recipes of a task's plans, shape (N, P), padded with -1.
        ingredients = world.graph.sets[:, :-1].tolist()
        parts = []
        for task in self.tasks.tolist():
            last_sets = [ingredients[plan[-1]] for plan in world.tasks.plans[task]]
            parts.append(sorted(set(chain.from_iterable(last_sets)) - {world.nothing}))
        self._parts = padded(parts, -1)

    def __call__(
        self, player: Player, rng: np.random.Generator | None = None, stage: str = "playing"
    ) -> Evaluation:
        """Play all tasks with all distractor seeds; return the outcomes.

        Args:
            player: maps a batched state and a random generator to slots, shape (N,): see
                :mod:`wordcraft_kg.agents.players`.
            rng: the player's generator; None for one for each distractor seed.
            stage: what the progress display says.

        Raises:
            LeakError: if a policy would score a task by a model trained on the task's recipes.
            GraphMismatchError: if the tasks belong to another graph or split than a policy's
                cross-fitted scorer.
            ActionError: if a player chooses a number that is not a slot.
        """
        shape = (len(self.tasks), self.distractor_seeds)
        result = Evaluation(
            tasks=self.tasks,
            groups=self.engine.world.groups[self.tasks],
            success=np.zeros(shape, dtype=bool),
            by_plan=np.zeros(shape, dtype=bool),
            actions=np.zeros(shape, dtype=np.int64),
            terminations=np.zeros(shape, dtype=np.int8),
            decisions=np.zeros(shape, dtype=np.int64),
        )
        engine = self.engine
        for distractor_seed in steps(stage, range(self.distractor_seeds)):
            state = engine.pose(self.tasks, distractor_seed, seed=self._seed)
            choices = rng or np.random.default_rng([EVALUATION_SEED, distractor_seed])
            while (running := state.attempts_left > 0).any():
                # A step clears the selection at the end of an attempt, so the state before it tells
                # what was combined. The step comes first: it refuses a number that is not a slot.
                before = state
                slots = player(before, choices)
                state, step = engine.step_once(before, slots)
                picks = before.picked(slots)
                result.actions[running, distractor_seed] += 1
                result.success[:, distractor_seed] |= step.outcome == GOAL
                result.by_plan[:, distractor_seed] |= step.by_plan
                is_attempt = running & before.has_selection() & ~state.has_selection()
                # The picks as one number, equal for all orders.
                set_number = np.zeros(len(self.tasks), dtype=np.int64)
                for column in np.sort(picks, axis=1).T:
                    set_number = set_number * engine.nothing + column
                # A polynomial of the sets in turn, so the order of attempts counts.
                result.decisions[is_attempt, distractor_seed] *= _HASH_FACTOR
                result.decisions[is_attempt, distractor_seed] += 1 + set_number[is_attempt]
                over = step.over
                ended = np.where(step.outcome == GOAL, 0, self._termination(picks))
                result.terminations[over, distractor_seed] = ended[over]
        return result

    def _termination(self, picks: Ids) -> NDArray[np.int64]:
        """Return an index into :data:`TERMINATION_REASONS` for each failed attempt."""
        is_twice = (picks == picks[:, :1]).all(1) & (picks[:, 0] != self.engine.nothing)
        # Whether an ingredient of a plan's last recipe is among the picks, in blocks of (N, P).
        is_right = np.zeros(len(picks), dtype=bool)
        for entities in picks.T:
            is_right |= (self._parts == entities[:, None]).any(1)
        # One above all pairs stands for a pair without a result.
        makes = self.engine.pair_numbers(picks) != self.engine.pairs.no_pair
        return np.select([is_twice, is_right, makes], [1, 2, 3], 4)


def evaluate(
    player: Policy | Player,
    graph: GraphLike | World,
    *,
    distractor_seeds: int | None = None,
    **settings: Any,
) -> Evaluation:
    """Evaluate a policy or player on all tasks in a part of the split (a sample if there are many).

    Args:
        player: policy for the graph, or function from a batched state and a random generator to
            slots.
        graph: graph folder, book file or name, recipe graph, opened graph, or world (then without
            ``settings``).
        distractor_seeds: tables per task, equal for all players; by default 5, or 1 if there are
            very many tasks.
        settings: task settings, see :class:`~wordcraft_kg.envs.world_config.WordCraftConfig`; the
            part is ``test`` by default.

    Returns:
        The outcomes; ``metrics()`` has the success rate.

    Raises:
        ConfigError: for an unknown setting, a value out of range, or settings next to a world.
        ActionError: if a player chooses a number that is not a slot.
        TaskError: if the graph has no task for these settings.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        ArtefactError: if a graph folder is damaged.
        LeakError: if a policy would score a task by a model trained on the task's recipes.
        GraphMismatchError: if the tasks belong to another graph or split than the policy's
            cross-fitted scorer.

    Example:
        >>> settings = {"num_distractors": 2, "distractor_seeds": 1}
        >>> result = evaluate(load_policy("runs/kitchen"), "kitchen", **settings)
        >>> result.success.shape, 0 <= result.metrics().mean <= 1
        ((63, 1), True)
    """
    if not isinstance(graph, World):
        settings = {"part": "test", **settings}
    evaluator = Evaluator(World.of(graph, settings), distractor_seeds=distractor_seeds)
    return evaluator(PolicyPlayer(player) if isinstance(player, Policy) else player)


class PlayerSuccess(Record):
    """A player's success rate on tables with a given number of distractors.

    Attributes:
        player: the player's name.
        distractors: distractors on each table.
        episodes: number of played tables.
        success: share of episodes that made the goal.
        low: lower end of the 95 % interval of ``success``, which resamples groups of tasks, see
            :attr:`World.groups`, because their episodes are not independent.
        high: upper end.
        by_plan: share of episodes in which a plan's last pair made the goal.
        goals: the group of goals that the row is about; empty for all tasks.
    """

    player: str
    distractors: Count
    episodes: Count
    success: Share
    low: Share
    high: Share
    by_plan: Share
    goals: str = ""


def play_all(
    world: World,
    players: dict[str, Player],
    distractors: Iterable[int] = (1, 2, 8),
    *,
    distractor_seeds: int | None = None,
    seed: int = 0,
    groups: Mapping[str, NDArray[np.bool_]] | None = None,
    limit: int = MOST_TASKS,
) -> tuple[PlayerSuccess, ...]:
    """Evaluate players on the tasks of a world with each number of distractors.

    Success does not depend on reward settings.

    Args:
        world: the world with the tasks; its own number of distractors is not used.
        players: players by name.
        distractors: numbers of distractors.
        distractor_seeds: tables per task, equal for all players; None as for
            :class:`Evaluator`.
        seed: draws distractors and players' choices.
        groups: masks over the world's tasks by name, each of shape (tasks,). Groups without tasks
            have no row. None for no groups.
        limit: most tasks; of more, evenly spaced ones are played, as by the evaluator.

    Returns:
        For each number of distractors and player a record of all tasks, then one of each group.

    Raises:
        ConfigError: for a seed out of range, ``limit`` or ``distractor_seeds`` below 1, or too few
            entities in the graph for so many distractors.
        ActionError: if a player chooses a number that is not a slot.
        LeakError: if a player would score a task by a model trained on the task's recipes.
    """
    whole("seed", seed, 0)
    rows: list[PlayerSuccess] = []
    for amount in dict.fromkeys(distractors):
        variant = world.variant(num_distractors=amount)
        evaluator = Evaluator(variant, distractor_seeds=distractor_seeds, limit=limit, seed=seed)
        masks = {group: mask[evaluator.tasks] for group, mask in (groups or {}).items()}
        for name, player in players.items():
            # A generator for each player: results do not depend on the other players.
            rng = np.random.default_rng([seed, amount])
            stage = f"playing {name}, {counted(amount, 'distractor')}"
            result = evaluator(player, rng, stage)
            rows += success_rows(name, amount, result, masks)
    return tuple(rows)


def success_rows(
    name: str,
    distractors: int,
    result: Evaluation,
    groups: Mapping[str, NDArray[np.bool_]],
) -> Iterator[PlayerSuccess]:
    """Yield the rows of a player that has played N tasks: for all tasks, then for each group.

    Args:
        name: the player's name.
        distractors: distractors on each table.
        result: the player's outcomes.
        groups: groups of goals by name, masks of shape (N,); those without tasks have no row.
    """
    everything = {"": np.ones(len(result.tasks), dtype=bool)}
    for group, mask in {**everything, **groups}.items():
        if not mask.any():
            continue
        success = result.success[mask]
        low, high = task_bootstrap(success, result.groups[mask])
        yield PlayerSuccess(
            player=name,
            distractors=distractors,
            episodes=success.size,
            success=float(success.mean()),
            low=low,
            high=high,
            by_plan=float(result.by_plan[mask].mean()),
            goals=group,
        )
