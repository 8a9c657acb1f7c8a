"""The rules of the crafting game as plain loops over lists: slow, and written to be read.

The tests compare the engine with it, step for step. A change of a rule belongs into both.
"""

import numpy as np


class ReferenceEnv:
    """One environment with a given task and table."""

    def __init__(self, world, task, table):
        self.world = world
        self.task = task
        self.table = list(table)
        self.picks = []
        self.attempts_left = world.config.attempts
        self.outcome = "in_progress"
        self.goal = int(world.tasks.goals[task])
        self.intermediates = {*world.tasks.intermediates[task].tolist()} - {world.nothing}
        # Only a graph with other recipes than pairs has the action to combine, the last one.
        sizes = {len(recipe.ingredients) for recipe in world.graph.recipe_labels()}
        self.combine = None if sizes == {2} else world.num_slots - 1
        self.most_picks = max(2, *sizes)
        self.last_sets = {
            tuple(map(world.graph.id_of, plan[-1].ingredients)) for plan in world.tasks[task].plans
        }

    def step(self, slot):
        """Choose a slot; return reward, whether by plan, and whether the slot was empty."""
        assert self.outcome == "in_progress"
        reward, by_plan = 0.0, False
        is_combined = slot == self.combine and bool(self.picks)
        is_empty = slot >= len(self.table) and not is_combined
        if not is_empty and not is_combined:
            self.picks.append(self.table[slot])
        is_complete = is_combined or (not is_empty and len(self.picks) == self.most_picks)
        if is_complete:
            reward, by_plan = self.attempt(tuple(sorted(self.picks)))
        # An empty slot at any time ends the attempt.
        if is_complete or is_empty:
            self.picks = []
            self.attempts_left -= 1
        if self.outcome == "in_progress" and self.attempts_left == 0:
            self.outcome = "out_of_attempts"
        return reward, by_plan, is_empty

    def attempt(self, picks):
        """Combine entities; return the reward, and whether a plan's last set made the goal."""
        rewards = self.world.config.rewards
        results = self.world.outcomes.get(picks, ())
        # Each entity is on the table once, however often it is made.
        fresh = [result for result in results if result not in self.table]
        self.table += fresh
        if not results:
            return -rewards.wrong_pair_penalty, False
        # Rewarded when first made, but never irrelevant.
        reward = rewards.intermediate_reward * len(self.intermediates.intersection(fresh))
        if self.goal in results:
            self.outcome = "goal"
            return reward + 1, picks in self.last_sets
        if not self.intermediates.intersection(results):
            reward -= rewards.irrelevant_penalty
        return reward, False

    def seen(self):
        """Return the observation."""
        nothing = self.world.nothing
        picks = self.picks + [nothing] * (self.most_picks - len(self.picks))
        table = self.table + [nothing] * (self.world.num_slots - len(self.table))
        mask = [int(entity != nothing) for entity in table]
        if self.combine is not None:
            mask[self.combine] = int(bool(self.picks))
        return {
            "goal": self.goal,
            "table": np.array(table),
            "selection": picks[0] if self.combine is None else picks,
            "attempts_left": self.attempts_left,
            "action_mask": np.array(mask),
        }
