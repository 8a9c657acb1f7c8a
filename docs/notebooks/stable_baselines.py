# %% [markdown]
# # Stable-Baselines3
#
# MaskablePPO from sb3-contrib trains a policy from this package, guided by a scorer.
# [Environments](../environment.md) is the guide; the extra `interop` installs the libraries.

# %%
import gymnasium as gym
import pandas as pd
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
from wordcraft_kg.models.policies.folder import make_policy

torch.set_num_threads(1)  # more threads are slower on networks this small
opened = open_graph("kitchen")
world = World(opened, WordCraftConfig(part="train", num_distractors=4))
env = gym.make("WordCraft-v0", graph=world, render_mode="ansi")
observation, info = env.reset(seed=0)
observation

# %%
print(env.render())

# %% [markdown]
# ## A guided policy
#
# `TaskObservation` adds the task's number to the observations, so that the policy asks a
# model that has not seen the task's recipe.

# %%
train_links(LinksConfig("kitchen", ComplExConfig(dim=32, epochs=20)), "models/kitchen")
scorer, seen = load_scorer("models/kitchen"), opened.split.partial
policy, _ = make_policy(PolicyConfig(), opened.graph, world.num_slots, scorer=scorer, observed=seen, tasks=world.tasks)
model = MaskablePPO(
    MaskableSB3Policy, TaskObservation(env), policy_kwargs={"network": policy}, n_steps=512, learning_rate=0.001, seed=0
)
model = model.learn(10_240)

# %% [markdown]
# ## Before and after
#
# The training is short: on test tasks the intervals overlap. For results use `train_agent`.

# %%
players = {"before": policy, "after": model.policy.network}
rows = {}
for part in ("train", "test"):
    for name, player in players.items():
        figures = evaluate(player, opened, part=part, num_distractors=4).metrics()
        rows[part, name] = f"{figures.mean:.3f} [{figures.ci_low:.3f}, {figures.ci_high:.3f}]"
pd.Series(rows).unstack().loc[["train", "test"], ["before", "after"]]

# %% [markdown]
# A saved policy works in all commands, and decides about any table.

# %%
save_policy("policies/ppo", model.policy.network)
model.policy.network.act(goal="bread", table=["flour", "fire", "water", "egg"])
