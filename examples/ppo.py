"""Plain PPO on the vector environment: the baseline that a newcomer writes in an hour.

A network looks at each item alone, beside the goal and the selection, and gives it a logit; an
agent of this package has to do better. Needs no trainer and no policy of the package:

    python examples/ppo.py --graph everyday --steps 1000000
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg import evaluate, open_graph
from wordcraft_kg.agents.players import Player
from wordcraft_kg.envs.batch import State
from wordcraft_kg.models.scorers.features import make_features

ENVS, STEPS, EPOCHS, MINIBATCH = 256, 8, 3, 1024
DISCOUNT, GAE, CLIP, ENTROPY, RATE = 0.99, 0.95, 0.2, 0.01, 1e-3


class Network(nn.Module):
    """Logits (B, A) and values (B,) for the ids in observations; row E of the vectors is zeros."""

    def __init__(self, vectors: Tensor):
        super().__init__()
        self.vectors = nn.functional.pad(vectors, (0, 0, 0, 1))
        dim = vectors.shape[1]
        self.item = nn.Sequential(nn.Linear(3 * dim, 128), nn.ReLU(), nn.Linear(128, 1))
        self.value = nn.Sequential(nn.Linear(3 * dim, 128), nn.ReLU(), nn.Linear(128, 1))

    def forward(self, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return logits and values."""
        items = self.vectors[seen["table"]]
        state = torch.cat([self.vectors[seen["goal"]], self.vectors[seen["selection"]]], dim=1)
        beside = state[:, None].expand(-1, items.shape[1], -1)
        logits = self.item(torch.cat([items, beside], dim=2))[..., 0]
        logits = logits.masked_fill(seen["action_mask"] == 0, -torch.inf)
        pooled = (logits.softmax(1)[..., None] * items).sum(1)
        return logits, self.value(torch.cat([state, pooled], dim=1))[:, 0]


def advantages(rewards: Tensor, values: Tensor, over: Tensor) -> Tensor:
    """Return generalised advantages (T, B) of rewards, values (T + 1, B) and ends of episodes."""
    result = torch.zeros_like(rewards)
    following = torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        goes_on = (~over[t]).float()
        error = rewards[t] + DISCOUNT * goes_on * values[t + 1] - values[t]
        following = error + DISCOUNT * GAE * goes_on * following
        result[t] = following
    return result


def train(graph: str, steps: int, seed: int = 0, distractors: int = 8) -> Network:
    """Train a network on the train tasks of a graph."""
    torch.manual_seed(seed)
    opened = open_graph(graph)
    envs = gym.make_vec(
        "WordCraft-v0",
        ENVS,
        vectorization_mode="vector_entry_point",
        graph=opened,
        part="train",
        num_distractors=distractors,
    )
    network = Network(torch.tensor(make_features("glove", opened.graph.entities).vectors))
    optimizer = torch.optim.Adam(network.parameters(), RATE)
    seen = tensors(envs.reset(seed=seed)[0])
    for _ in range(steps // (ENVS * STEPS)):
        played, rewards, over, values = [], [], [], []
        for _ in range(STEPS):
            with torch.no_grad():
                logits, value = network(seen)
            action = torch.multinomial(logits.softmax(1), 1)[:, 0]
            played.append({**seen, "action": action, "log_prob": log_probs_of(logits, action)})
            values.append(value)
            following, reward, terminated, _, _ = envs.step(action.numpy())
            rewards.append(torch.tensor(reward, dtype=torch.float32))
            over.append(torch.tensor(terminated))
            seen = tensors(following)
        with torch.no_grad():
            values.append(network(seen)[1])
        every = torch.stack(values)
        gains = advantages(torch.stack(rewards), every, torch.stack(over))
        batch = {name: torch.cat([step[name] for step in played]) for name in played[0]}
        batch |= {"gain": gains.flatten(), "return": (gains + every[:-1]).flatten()}
        for _ in range(EPOCHS):
            for rows in torch.randperm(ENVS * STEPS).chunk(ENVS * STEPS // MINIBATCH):
                learn(network, optimizer, {name: values[rows] for name, values in batch.items()})
    return network


def learn(network: Network, optimizer: torch.optim.Adam, batch: dict[str, Tensor]) -> None:
    """Take a step of the clipped policy gradient, with losses of value and entropy."""
    logits, value = network(batch)
    ratio = (log_probs_of(logits, batch["action"]) - batch["log_prob"]).exp()
    gain = (batch["gain"] - batch["gain"].mean()) / (batch["gain"].std() + 1e-8)
    clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
    loss = -torch.minimum(ratio * gain, clipped * gain).mean()
    # Empty slots have probability 0, and a logarithm of -inf.
    log_probs = logits.log_softmax(1).clamp(min=-50)
    entropy = -(log_probs.exp() * log_probs).sum(1).mean()
    loss = loss + (value - batch["return"]).square().mean() / 2 - ENTROPY * entropy
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 0.5)
    optimizer.step()


def log_probs_of(logits: Tensor, action: Tensor) -> Tensor:
    """Return the log-probabilities (B,) of actions (B,) under logits (B, A)."""
    return logits.log_softmax(1).gather(1, action[:, None])[:, 0]


def tensors(seen: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """Return observations as tensors."""
    return {name: torch.as_tensor(values) for name, values in seen.items()}


def player_of(network: Network) -> Player:
    """Return greedy play by a network."""

    @torch.no_grad()
    def player(state: State, rng: np.random.Generator) -> np.ndarray:
        seen = {name: getattr(state, name).copy() for name in ("goal", "selection", "table")}
        logits, _ = network(tensors({**seen, "action_mask": state.action_masks()}))
        slots: np.ndarray = logits.argmax(1).numpy()
        return slots

    return player


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--graph", default="everyday")
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--distractors", type=int, default=8)
    options = parser.parse_args()
    torch.set_num_threads(1)
    network = train(options.graph, options.steps, options.seed, options.distractors)
    figures = evaluate(
        player_of(network),
        open_graph(options.graph),
        part="test",
        num_distractors=options.distractors,
    ).metrics()
    print(f"test success {figures.mean:.3f} [{figures.ci_low:.3f}, {figures.ci_high:.3f}]")
