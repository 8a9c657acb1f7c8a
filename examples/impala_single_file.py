"""IMPALA on crafting tasks in one file.

Environment, attention policy, V-trace, training, and a CSV of the curve.

    python examples/impala_single_file.py --graph kitchen --steps 20000 --out curve.csv

This script is `wordcraft-kg train-agent` without files, checkpoints, knowledge and speed: the same
seed gives the same tasks, weights and actions, and the same curve up to rounding. Copy the file and
change the part that you study.
"""

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.scorers.features import make_features

BATCH, UNROLL = 128, 2  # environments side by side, and steps of each in an update
DISCOUNT, ENTROPY_COST, BASELINE_COST, CLIP = 0.99, 0.01, 0.5, 40.0
LEARNING_RATE, RMS_DECAY, RMS_EPSILON = 0.003, 0.99, 0.01
UPDATES_PER_ROW = 10
GOAL = 1  # outcome of an episode that made the goal
DISTRACTOR_SEEDS = 5  # tables with other distractors, for each test task


# --- environment: pure functions, (state, actions) -> (state, outcome of the step) ----------------


def make_world(graph: str, part: TaskPart, distractors: int) -> World:
    """Return a part's tasks at depth 1: choose two entities on the table that make the goal."""
    return World.open(graph, WordCraftConfig(part=part, num_distractors=distractors))


def observe(state: State) -> tuple[Tensor, Tensor, Tensor]:
    """Return ids: the goal (B,), the selection (B,) and the table (B, A)."""
    return (
        torch.from_numpy(state.goal),
        torch.from_numpy(state.selection),
        torch.from_numpy(state.table),
    )


# --- policy: attention of goal and selection over the table ---------------------------------------


class AttentionPolicy(nn.Module):
    """Attention of goal and selection over the table.

    ``α_i = Q([x_goal; x_sel]) · K(x_i) / √d`` are the logits of the slots, ``V = MLP(Σ_i
    softmax(α)_i x_i)``.
    """

    vectors: Tensor

    def __init__(self, vectors: Tensor, size: int = 300):
        """Take the vectors of all entities, shape (E, F).

        Nothing, with the id E, gets a zero vector.
        """
        super().__init__()
        dim = vectors.shape[1]
        self.register_buffer("vectors", nn.functional.pad(vectors, (0, 0, 0, 1)))
        self.query = nn.Linear(2 * dim, size)
        self.key = nn.Linear(dim, size, bias=False)
        self.value = nn.Sequential(nn.Linear(dim, size), nn.ReLU(), nn.Linear(size, 1))

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor) -> tuple[Tensor, Tensor]:
        """Return log-probabilities of the slots, (B, A), and the value, (B,).

        An empty slot has -inf.
        """
        slots, is_empty = self.vectors[table], table == len(self.vectors) - 1
        query = self.query(torch.cat([self.vectors[goal], self.vectors[selection]], dim=1))
        logits = (self.key(slots) @ query[:, :, None])[:, :, 0] / math.sqrt(self.key.out_features)
        logits = logits.masked_fill(is_empty, -torch.inf)
        summary = (torch.softmax(logits, dim=1)[:, None, :] @ slots)[:, 0]
        return torch.log_softmax(logits, dim=1), self.value(summary)[:, 0]


def draw_slots(log_probs: Tensor, noise: Tensor) -> Tensor:
    """Draw a slot for each row with one uniform number.

    It is the first slot whose cumulative probability exceeds the number.
    """
    shares = log_probs.exp().cumsum(dim=1)
    return (shares <= noise[:, None] * shares[:, -1:]).sum(dim=1)


# --- V-trace (Espeholt et al. 2018), with all truncation levels 1 ---------------------------------


def v_trace(
    log_rhos: Tensor, discounts: Tensor, rewards: Tensor, values: Tensor, bootstrap: Tensor
) -> tuple[Tensor, Tensor]:
    """Return targets of the values and advantages of the actions.

    Arguments and results of shape (T, B) but (B,).
    """
    rhos = log_rhos.exp().clamp(max=1)
    following = torch.cat([values[1:], bootstrap[None]])
    deltas = rhos * (rewards + discounts * following - values)
    corrections = torch.zeros_like(values)
    correction = torch.zeros_like(bootstrap)
    for t in reversed(range(len(values))):
        correction = deltas[t] + discounts[t] * rhos[t] * correction
        corrections[t] = correction
    targets = values + corrections
    advantages = rhos * (rewards + discounts * torch.cat([targets[1:], bootstrap[None]]) - values)
    return targets, advantages


# --- training -------------------------------------------------------------------------------------


def learn(
    policy: AttentionPolicy,
    states: Sequence[tuple[Tensor, ...]],
    actions: Tensor,
    steps: dict[str, Tensor],
) -> Tensor:
    """Return the loss of an unroll.

    It has T + 1 states, T actions, and the outcomes of the steps, shape (T, B) each.
    """
    log_policies, values = policy(*(torch.cat(parts) for parts in zip(*states, strict=True)))
    values = values.view(UNROLL + 1, BATCH)
    log_policies = log_policies.view(UNROLL + 1, BATCH, -1)[:UNROLL]
    log_probs = log_policies.gather(2, actions[:, :, None])[:, :, 0]
    log_rhos = (
        log_probs.detach() - steps["log_probs"]
    )  # 0 here: the acting policy is the learning one
    discounts = DISCOUNT * (~steps["over"]).float()
    targets, advantages = v_trace(
        log_rhos, discounts, steps["rewards"], values[:UNROLL].detach(), values[UNROLL].detach()
    )
    entropy = -(log_policies.exp() * log_policies.masked_fill(log_policies == -torch.inf, 0)).sum()
    baseline_loss = 0.5 * (targets - values[:UNROLL]).square().sum()
    loss: Tensor = (
        -(log_probs * advantages).sum() + BASELINE_COST * baseline_loss - ENTROPY_COST * entropy
    )
    return loss


@torch.no_grad()
def evaluate(policy: AttentionPolicy, world: World) -> float:
    """Return the success rate of the greedy policy, over all tasks and distractor seeds."""
    engine, made = BatchEngine(world, len(world.tasks)), []
    for distractor_seed in range(DISTRACTOR_SEEDS):
        state = engine.pose(np.arange(len(world.tasks)), distractor_seed)
        for _ in range(2):  # an attempt has two actions, and tasks at depth 1 have one attempt
            state, step = engine.step_once(state, policy(*observe(state))[0].argmax(dim=1).numpy())
        made.append((step.outcome == GOAL).mean())
    return float(np.mean(made))


def train(graph: str, steps: int, distractors: int, seed: int, out: Path) -> None:
    """Train a policy and write its learning curve."""
    world, test = make_world(graph, "train", distractors), make_world(graph, "test", distractors)
    engine = BatchEngine(world, BATCH)
    state = engine.reset(seed)
    vectors = torch.tensor(make_features("glove", world.graph.entities).vectors)
    torch.manual_seed(seed)
    policy = AttentionPolicy(vectors)
    optimizer = torch.optim.RMSprop(
        policy.parameters(), lr=LEARNING_RATE, alpha=RMS_DECAY, eps=RMS_EPSILON
    )
    generator = torch.Generator().manual_seed(seed)
    updates = -(-steps // (BATCH * UNROLL))
    sums = {"loss": 0.0, "episodes": 0, "successes": 0}
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["step", "loss", "success", "test_success"])
        for update in range(updates):
            noise = torch.rand(UNROLL, BATCH, generator=generator)
            states, actions, rows = [observe(state)], [], []
            for t in range(UNROLL):
                with torch.no_grad():
                    log_policy, _ = policy(*states[-1])
                slots = draw_slots(log_policy, noise[t])
                state, step = engine.step(state, slots.numpy())
                states.append(observe(state))
                actions.append(slots)
                chosen = log_policy.gather(1, slots[:, None])[:, 0]
                rows.append((chosen, torch.from_numpy(step.reward), torch.from_numpy(step.over)))
                sums["episodes"] += step.over.sum()
                sums["successes"] += (step.outcome == GOAL).sum()
            parts = map(torch.stack, zip(*rows, strict=True))
            loss = learn(
                policy,
                states,
                torch.stack(actions),
                dict(zip(("log_probs", "rewards", "over"), parts, strict=True)),
            )
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            nn.utils.clip_grad_norm_(policy.parameters(), CLIP)
            optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1 - update / updates)
            optimizer.step()
            sums["loss"] += loss.item()
            if (update + 1) % UPDATES_PER_ROW == 0:
                row = [(update + 1) * BATCH * UNROLL, sums["loss"] / UPDATES_PER_ROW]
                writer.writerow(
                    [*row, sums["successes"] / sums["episodes"], evaluate(policy, test)]
                )
                sums = dict.fromkeys(sums, 0)


def main() -> None:
    """Train with the settings of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--graph", default="everyday")
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--distractors", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("curve.csv"))
    options = parser.parse_args()
    train(options.graph, options.steps, options.distractors, options.seed, options.out)


if __name__ == "__main__":
    main()
