"""Stable-Baselines3 trains on the environment.

MaskablePPO with our policy as its network, guided by a scorer.

The scorer is cross-fitted: with the number of the task in the observations, the policy asks a model
that has not seen the task's recipe, and does not learn to rely on memory.

The training shows how the parts fit together and is too short to improve the policy: even ten times
the steps reach only .352 [.273, .435] on the test tasks, from .330. Train agents for results with
`train_agent`.

Needs the extra interop. Run it in an empty folder: it writes models/ppo and policies/ppo, in
less than half a minute.
"""

import gymnasium as gym
import torch
from sb3_contrib import MaskablePPO

from wordcraft_kg import (
    ComplExConfig,
    LinksConfig,
    PolicyConfig,
    WordCraftConfig,
    World,
    evaluate,
    load_scorer,
    open_graph,
    save_policy,
    train_links,
)
from wordcraft_kg.agents.sb3 import MaskableSB3Policy
from wordcraft_kg.envs.wrappers import TaskObservation
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.policy_folder import make_policy


def main() -> None:
    """Train for a few thousand steps and evaluate the policy on the test tasks."""
    torch.set_num_threads(
        1
    )  # on networks this small more threads are slower, on a busy machine many times
    opened = open_graph("kitchen")
    train_links(LinksConfig("kitchen", ComplExConfig(dim=32, epochs=20)), "models/ppo")
    world = World(opened, WordCraftConfig(part="train", num_distractors=4))
    env = TaskObservation(gym.make("WordCraft-v0", graph=world))
    scorer, seen = load_scorer("models/ppo"), opened.split.partial
    policy, _ = make_policy(
        PolicyConfig(),
        opened.graph,
        world.num_slots,
        scorer=scorer,
        observed=seen,
        tasks=world.tasks,
    )
    model = MaskablePPO(
        MaskableSB3Policy, env, policy_kwargs={"network": policy}, n_steps=512, seed=0
    )
    model.learn(2_048)
    trained: Policy = model.policy.network  # a copy: `policy` is as it was
    for name, player in (("before", policy), ("after", trained)):
        figures = evaluate(player, opened, num_distractors=4).metrics()
        print(
            f"success on test tasks {name}: {figures.mean:.3f} [{figures.ci_low:.3f}, "
            f"{figures.ci_high:.3f}]"
        )
    save_policy("policies/ppo", trained)
    print(trained.act(goal="bread", table=["flour", "fire", "water", "egg"]))


if __name__ == "__main__":
    main()
