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
        self.selection = world.nothing
        self.attempts_left = world.config.attempts
        self.outcome = "in_progress"
        self.goal = int(world.tasks.goals[task])
        self.intermediates = {*world.tasks.intermediates[task].tolist()} - {world.nothing}
        pairs = world.graph.recipes[:, :2]
        self.last_pairs = {tuple(pairs[plan[-1]].tolist()) for plan in world.tasks.plans[task]}

    def step(self, slot):
        """Choose a slot; return reward, whether by plan, and whether the slot was empty."""
        assert self.outcome == "in_progress"
        reward, by_plan = 0.0, False
        is_empty = slot >= len(self.table)
        if not is_empty and self.selection == self.world.nothing:
            self.selection = self.table[slot]
        else:
            # The second action, or an empty slot at any time, ends the attempt.
            if not is_empty:
                reward, by_plan = self.attempt(self.selection, self.table[slot])
            self.selection = self.world.nothing
            self.attempts_left -= 1
        if self.outcome == "in_progress" and self.attempts_left == 0:
            self.outcome = "out_of_attempts"
        return reward, by_plan, is_empty

    def attempt(self, first, second):
        """Combine two entities; return the reward, and whether a plan's last pair made the goal."""
        rewards = self.world.config.rewards
        pair = (min(first, second), max(first, second))
        results = self.world.outcomes.get(pair, ())
        # Each entity is on the table once, however often it is made.
        fresh = [result for result in results if result not in self.table]
        self.table += fresh
        if not results:
            return -rewards.wrong_pair_penalty, False
        # Rewarded when first made, but never irrelevant.
        reward = rewards.intermediate_reward * len(self.intermediates.intersection(fresh))
        if self.goal in results:
            self.outcome = "goal"
            return reward + 1, pair in self.last_pairs
        if not self.intermediates.intersection(results):
            reward -= rewards.irrelevant_penalty
        return reward, False

    def seen(self):
        """Return the observation."""
        empty = self.world.num_slots - len(self.table)
        return {
            "goal": self.goal,
            "table": np.array(self.table + [self.world.nothing] * empty),
            "selection": self.selection,
            "attempts_left": self.attempts_left,
            "action_mask": np.array([1] * len(self.table) + [0] * empty),
        }
