"""Stable-Baselines3 trains on the environment: MaskablePPO with our policy as its network.

Needs the extra interop. Run it in an empty folder: it writes policies/ppo, in about ten seconds.
"""

import gymnasium as gym
import torch
from sb3_contrib import MaskablePPO

from wordcraft_kg import PolicyConfig, evaluate, open_graph, save_policy
from wordcraft_kg.agents.sb3 import MaskableSB3Policy
from wordcraft_kg.models.policies.folder import make_policy
from wordcraft_kg.models.policies.policy import Policy


def main() -> None:
    """Train for a few thousand steps and judge the policy on the test tasks."""
    torch.set_num_threads(1)  # on networks this small more threads are slower, on a busy machine many times
    opened = open_graph("kitchen")
    env = gym.make("WordCraft-v0", graph=opened, num_distractors=4)
    slots = env.get_wrapper_attr("num_slots")
    policy, _ = make_policy(PolicyConfig(), opened.graph, slots)
    model = MaskablePPO(MaskableSB3Policy, env, policy_kwargs={"network": policy}, n_steps=512, seed=0)
    model.learn(2_048)
    trained: Policy = model.policy.network  # a copy: `policy` is as it was
    for name, player in (("before", policy), ("after", trained)):
        print(f"success on test tasks {name}: {evaluate(player, opened, num_distractors=4).figures().mean:.3f}")
    save_policy("policies/ppo", trained)
    print(trained.act(goal="bread", table=["flour", "fire", "water", "egg"]))


if __name__ == "__main__":
    main()
