"""Steps a second of Stable-Baselines3 with its DummyVecEnv and with our SB3VecEnv, in one run.

    python benchmarks/sb3_speed.py --envs 8 64 256

*alone*: random legal actions, without a policy. *collect*: `collect_rollouts` of PPO and MaskablePPO
with the default policy (random vectors), on one thread; the best of three.
"""

import argparse
import time

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg import PolicyConfig, WordCraftConfig, World, open_graph
from wordcraft_kg.agents.sb3 import MaskableSB3Policy, SB3Policy, SB3VecEnv
from wordcraft_kg.models.policies.folder import make_policy

SECONDS = 3.0
STEPS = 2_048
"""Least steps of a rollout, over all environments."""
FEWEST = 16
"""Least steps of a rollout in each environment."""


def alone(env):
    """Return steps a second with random legal actions."""
    rng = np.random.default_rng(0)
    env.seed(0)
    env.reset()
    done, start = 0, time.perf_counter()
    while (spent := time.perf_counter() - start) < SECONDS:
        counts = np.stack(env.env_method("action_masks")).sum(1)
        env.step((rng.random(env.num_envs) * counts).astype(np.int64))
        done += env.num_envs
    return done / spent


def collect(algorithm, kind, env, policy):
    """Return steps a second of an algorithm that collects rollouts."""
    steps = max(FEWEST, STEPS // env.num_envs)
    settings = {"n_steps": steps, "batch_size": env.num_envs * steps, "seed": 0}
    model = algorithm(kind, env, policy_kwargs={"network": policy}, **settings)
    _, callback = model._setup_learn(10**9, None)
    best = 0.0
    for _ in range(4):  # the first one warms up
        start = time.perf_counter()
        model.collect_rollouts(model.env, callback, model.rollout_buffer, steps)
        best = max(best, env.num_envs * steps / (time.perf_counter() - start))
    return best


def main(sizes):
    torch.set_num_threads(1)
    opened = open_graph("everyday")
    world = World(opened, WordCraftConfig(num_distractors=8))
    policy, _ = make_policy(PolicyConfig(features="random"), opened.graph, world.num_slots)
    print("environments  kind          alone  PPO collect  MaskablePPO collect")
    for size in sizes:
        for name, make in (
            (
                "DummyVecEnv",
                lambda n: DummyVecEnv([lambda: gym.make("WordCraft-v0", graph=world)] * n),
            ),
            ("SB3VecEnv", lambda n: SB3VecEnv(n, world)),
        ):
            rates = [
                alone(make(size)),
                collect(PPO, SB3Policy, make(size), policy),
                collect(MaskablePPO, MaskableSB3Policy, make(size), policy),
            ]
            shown = "  ".join(f"{rate:>9,.0f}" for rate in rates)
            print(f"{size:>12}  {name:<11}  {shown}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", type=int, nargs="+", default=[8, 64, 256])
    main(parser.parse_args().envs)
