"""CPU seconds to 95 % of the final test success: our trainer beside MaskablePPO of Stable-Baselines3.

    python benchmarks/seconds_to_level.py everyday
    python benchmarks/seconds_to_level.py everyday --scorer models/everyday-recipes --every 20000
    python benchmarks/seconds_to_level.py graphs/kitchen --scorer models/kitchen --use u,v,w --preset recommended \\
        --depth 2 --distractors 4 --steps 50000 --ppo-steps 50000 --every 50000 --seeds 3 --json ppo.json

Both train the same network, with or without a scorer, on the same train tasks and with one thread; the same Evaluator
plays the test tasks, with as many attempts as the depth. MaskablePPO reads the environment's observations, which lack the
number of attempts left. The clock counts training only: not the evaluation, and not building environments and learner. The
level is 95 % of what our trainer ends with, for each seed. MaskablePPO has a small grid of learning rates and rollout
lengths on 64 environments, with 4 epochs and batches of 512; other settings are defaults. Needs the extra interop.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import gymnasium as gym
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv

from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, Preset, TaskConfig
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.sb3 import MaskableSB3Policy
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.envs.wrappers import TaskObservation
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import make_policy

SHARE = 0.95
ENVS = 64


class Clock:
    """CPU seconds of training, and the success on test tasks at times."""

    def __init__(self, evaluator: Evaluator):
        self.evaluator, self.used, self.since = evaluator, 0.0, time.process_time()
        self.curve: list[tuple[float, int, float]] = []

    def look(self, policy: Policy, steps: int) -> None:
        self.used += time.process_time() - self.since
        self.curve.append(
            (self.used, steps, float(self.evaluator(PolicyPlayer(policy)).success.mean()))
        )
        self.since = time.process_time()

    def in_words(self, level: float) -> str:
        found = [
            f"{used:.1f} s, {steps:,} steps"
            for used, steps, success in self.curve
            if success >= level
        ]
        used, steps, success = self.curve[-1]
        return (
            f"{found[0] if found else 'not reached'}; at the end {success:.3f} ({used:.1f} s, "
            f"{steps:,} steps)"
        )


class Look(BaseCallback):
    """Looks every so many steps."""

    def __init__(self, clock: Clock, every: int):
        super().__init__()
        self.clock, self.every, self.next = clock, every, every

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps >= self.next:
            self.next = self.num_timesteps + self.every
            network: Any = self.model.policy.network
            self.clock.look(network, self.num_timesteps)


def ours(
    policy: Policy,
    train: World,
    clock: Clock,
    seed: int,
    every: int,
    settings: ImpalaConfig,
) -> None:
    config = replace(settings, seed=seed)
    learner = Impala(policy, BatchEngine(train, config.num_envs).reset(seed), config)
    clock.since = time.process_time()
    clock.look(policy, 0)
    for number in range(1, config.updates + 1):
        learner.update()
        if number % max(1, every // config.steps_per_update) == 0 or number == config.updates:
            clock.look(policy, number * config.steps_per_update)


def ppo(
    policy: Policy,
    train: World,
    clock: Clock,
    seed: int,
    steps: int,
    every: int,
    rate: float,
    length: int,
) -> None:
    wrap = TaskObservation if policy.reads_task else lambda env: env
    envs = DummyVecEnv([lambda: wrap(gym.make("WordCraft-v0", graph=train))] * ENVS)
    model = MaskablePPO(
        MaskableSB3Policy,
        envs,
        learning_rate=rate,
        n_steps=length,
        batch_size=512,
        n_epochs=4,
        ent_coef=0.01,
        seed=seed,
        policy_kwargs={"network": policy},
    )
    clock.since = time.process_time()
    clock.look(policy, 0)
    model.learn(steps, callback=Look(clock, every))
    clock.look(model.policy.network, model.num_timesteps)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("book")
    parser.add_argument("--depth", type=int, default=1)
    parser.add_argument("--distractors", type=int, default=8)
    parser.add_argument("--preset", choices=get_args(Preset), default="paper", help="ours")
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--ppo-steps", type=int, default=500_000)
    parser.add_argument("--every", type=int, default=50_000)
    parser.add_argument("--rates", default="0.001,0.003")
    parser.add_argument("--lengths", default="8,32")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--scorer", help="a model folder")
    parser.add_argument("--use", default="u,v", help="the scorer's scores in the policy")
    parser.add_argument(
        "--json", type=Path, help="file to write, with the success of each training"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    opened = open_graph(options.book)
    train, test = (
        World(opened, WordCraftConfig(part, options.depth, options.distractors))
        for part in ("train", "test")
    )

    config = AgentConfig(
        options.book,
        options.scorer,
        TaskConfig(depth=options.depth, distractors=options.distractors),
        PolicyConfig(use=options.use) if options.scorer else PolicyConfig(),
        ImpalaConfig(options.preset, steps=options.steps),
    )
    plain = replace(config.policy, sees_attempts=False)
    guide: dict[str, Any] = {}
    if options.scorer:
        model = open_model(options.scorer)
        guide = {"scorer": model.scorer, "observed": model.triples, "tasks": train.tasks}

    rows = []

    def run(
        trainer: Callable[..., None],
        settings: PolicyConfig,
        seed: int,
        *arguments: Any,
    ) -> Clock:
        policy, _ = make_policy(settings, opened.graph, train.num_slots, seed=seed, **guide)
        clock = Clock(Evaluator(test))
        trainer(policy, train, clock, seed, *arguments)
        used, steps, success = clock.curve[-1]
        rows.append(
            {
                "trainer": trainer.__name__,
                "settings": [value for value in arguments if isinstance(value, int | float)],
                "seed": seed,
                "steps": steps,
                "cpu_seconds": round(used, 1),
                "success": round(success, 4),
            }
        )
        return clock

    for seed in range(options.seeds):
        clock = run(ours, config.policy, seed, options.every, config.trainer)
        level = SHARE * clock.curve[-1][2]
        start = f"untrained {clock.curve[0][2]:.3f}, level {level:.3f}"
        print(f"{opened.graph.name}, {options.distractors} distractors, seed {seed}: {start}")
        print(f"ours: {clock.in_words(level)}", flush=True)
        for rate in map(float, options.rates.split(",")):
            for length in map(int, options.lengths.split(",")):
                clock = run(ppo, plain, seed, options.ppo_steps, options.every, rate, length)
                print(
                    f"MaskablePPO, rate {rate:g}, {length} steps: {clock.in_words(level)}",
                    flush=True,
                )

    if options.json:
        write_atomically(options.json, dump_json(rows))


if __name__ == "__main__":
    main()
