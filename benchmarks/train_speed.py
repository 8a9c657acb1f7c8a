"""Measure training speed: steps per second compared with a plain loop, and a whole run from command to report.

    python benchmarks/train_speed.py BOOK               sustained speed, unguided and guided, and a plain loop
    python benchmarks/train_speed.py BOOK --whole       also a run with 3,000,000 steps, from command to report
    python benchmarks/train_speed.py BOOK --device cuda the same on a device
    python benchmarks/train_speed.py BOOK --scorer MODEL --use combines,component,recipe
                                                     guided by a model instead of counts of neighbours
    python benchmarks/train_speed.py BOOK --scorer MODEL --use u,v,w --tables 32768
                                                     once the tables of a training are scored
    python benchmarks/train_speed.py BOOK --policy pairs --batch 512
                                                     the recommended policy, with its memory, instead of the paper's
    python benchmarks/train_speed.py BOOK --cpu-time --json FILE
                                                     steps per CPU second, for a machine with other jobs

The plain loop follows the paper's equations literally: keys for every slot, a softmax over the last axis, torch's
RMSProp over a parameter list, on the same batched environment. Measure on an idle machine, or with --cpu-time.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path

import torch
from torch import nn

from wordcraft_kg.agents.agent_config import ImpalaConfig
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.losses import baseline_loss, divergence, policy_gradient_loss, v_trace
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs.graph_folder import OpenedGraph, open_graph
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.scorer_folder import load_scorer


def ours(
    opened: OpenedGraph,
    config: ImpalaConfig,
    distractors: int,
    scorer: TripleScorer | None,
    settings: PolicyConfig,
) -> Callable[[], None]:
    state = begin(opened, config, distractors)
    guide = {"scorer": scorer, "observed": opened.split.partial, "tasks": state.engine.world.tasks}
    policy, _ = make_policy(settings, opened.graph, state.engine.num_slots, **guide)  # type: ignore[arg-type]
    return Impala(policy, state, config).update


def plain(opened: OpenedGraph, config: ImpalaConfig, distractors: int) -> Callable[[], None]:
    """The unguided agent in a straightforward form."""
    state = begin(opened, config, distractors)
    features = torch.tensor(make_features("glove", opened.graph.entities).vectors)
    vectors = torch.cat([features, torch.zeros(1, features.shape[1])])
    query, key = nn.Linear(100, 300), nn.Linear(50, 300, bias=False)
    inner, head = nn.Linear(50, 300), nn.Linear(300, 1)
    parameters = [p for layer in (query, key, inner, head) for p in layer.parameters()]
    optimizer = torch.optim.RMSprop(parameters, lr=0.001, alpha=0.99, eps=0.01)

    def policy(
        goal: torch.Tensor, selection: torch.Tensor, table: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        slots, mask = vectors[table], table != state.nothing
        asked = query(torch.cat([vectors[goal], vectors[selection]], dim=1))
        alpha = torch.einsum("bd,bad->ba", asked, key(slots)) / math.sqrt(300)
        weights = torch.softmax(alpha.masked_fill(~mask, -torch.inf), dim=1)
        value = head(torch.relu(torch.einsum("ba,bad->bd", weights, inner(slots))))[:, 0]
        return torch.log_softmax(alpha.masked_fill(~mask, -torch.inf), dim=1), value

    def observe() -> list[torch.Tensor]:
        return [
            torch.from_numpy(getattr(state, name).copy()) for name in ("goal", "selection", "table")
        ]

    def update() -> None:
        nonlocal state
        states, actions, log_probs, rewards, discounts = [], [], [], [], []
        for _ in range(config.unroll):
            states.append(observe())
            with torch.no_grad():
                log_policy, _ = policy(*states[-1])
                action = torch.multinomial(log_policy.exp(), 1)
            state, step = state.engine.step(state, action[:, 0].numpy())
            actions.append(action)
            log_probs.append(log_policy.gather(1, action)[:, 0])
            rewards.append(torch.from_numpy(step.reward))
            discounts.append(torch.from_numpy(~step.over) * config.discount)
        log_policy, values = policy(*(torch.cat(parts) for parts in zip(*states, strict=True)))
        chosen = log_policy.gather(1, torch.cat(actions))[:, 0].view(config.unroll, -1)
        values = values.view(config.unroll, -1)
        with torch.no_grad():
            bootstrap = policy(*observe())[1]
        log_rhos = chosen.detach() - torch.stack(log_probs)
        vs, pg_advantages = v_trace(
            log_rhos, torch.stack(discounts), torch.stack(rewards), values.detach(), bootstrap
        )
        loss = policy_gradient_loss(chosen, pg_advantages) + 0.01 * divergence(log_policy, 0.0)
        loss = loss + 0.5 * baseline_loss(values, vs)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(parameters, 40.0)
        optimizer.step()

    return update


def begin(opened: OpenedGraph, config: ImpalaConfig, distractors: int) -> State:
    world = World(opened, WordCraftConfig(part="train", num_distractors=distractors))
    engine = BatchEngine(world, config.num_envs, device=config.device, repeat=episodes_of(config))
    return engine.reset()


def episodes_of(config: ImpalaConfig) -> int:
    """Return the number of different episodes of an environment."""
    return math.ceil((config.tables or 0) / config.num_envs)


def rate(
    update: Callable[[], None],
    config: ImpalaConfig,
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return environment steps per second of a clock, once all tables have been played."""
    # An update plays an episode in each environment.
    for _ in range(max(50, episodes_of(config) + 1)):
        update()
    done, begun = 0, clock()
    while clock() - begun < seconds or done % 50:
        update()
        done += 1
    if config.device != "cpu":
        torch.cuda.synchronize()
    return done * config.steps_per_update / (clock() - begun)


def store(path: Path, book: str, rates: dict[str, list[float]]) -> None:
    """Write the best rate of each row, in place of the file's rows of the same names."""
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    rows = [row for row in old if row["row"] not in rates]
    for name, each in rates.items():
        row = {"book": book, "row": name, "steps_per_cpu_second": round(max(each))}
        row |= {"date": date.today().isoformat(), "load": round(os.getloadavg()[0], 1)}
        rows.append(row)
    write_atomically(path, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


def whole(book: str, distractors: int, steps: int, device: str) -> None:
    """Run the command as a user does, unguided and guided, and say how long it took and how much
    memory."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "wordcraft_kg"]
        graph, model = Path(folder, "graph"), Path(folder, "model")
        subprocess.run(
            [*command, "build-graph", book, "--out", graph, "--quiet"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        subprocess.run(
            [*command, "train-complex", graph, "--out", model, "--quiet"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        for name, options in (("unguided", []), ("guided", ["--scorer", model])):
            arguments = [
                "train-agent",
                graph,
                *options,
                "--distractors",
                distractors,
                "--steps",
                steps,
            ]
            arguments += ["--device", device, "--out", Path(folder, name), "--json", "--quiet"]
            begun = time.perf_counter()
            done = subprocess.run(
                [*command, *map(str, arguments)], check=True, capture_output=True, text=True
            )
            seconds, found = time.perf_counter() - begun, json.loads(done.stdout)
            print(
                f"{name:9s} {found['steps']:,} steps from the command to its report: {seconds:.1f} "
                f"s ({found['steps_per_second']:,} steps/s in training); test success "
                f"{found['success']['test']:.3f}",
                flush=True,
            )
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
        print(f"memory: at most {peak:.2f} GiB")
        begun = time.perf_counter()
        arguments = [
            "train-agent",
            graph,
            "--steps",
            256,
            "--eval-every",
            0,
            "--out",
            Path(folder, "first"),
            "--quiet",
        ]
        process = subprocess.Popen([*command, *map(str, arguments)], stdout=subprocess.DEVNULL)
        metrics = Path(folder, "first", "metrics.jsonl")
        while process.poll() is None and not (metrics.is_file() and metrics.stat().st_size):
            time.sleep(0.01)
        print(f"from the command to the first step: {time.perf_counter() - begun:.1f} s")
        process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("book")
    parser.add_argument("--distractors", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--scorer", help="a model folder")
    parser.add_argument("--policy", default="attention", choices=["pairs", "attention"])
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--use", default="u,v", help="the scorer's scores in the policy")
    parser.add_argument("--tables", type=int, default=0, help="different tables; 0 for all new")
    parser.add_argument("--cpu-time", action="store_true", help="count CPU seconds of the process")
    parser.add_argument("--json", type=Path, help="file to write the best rates to")
    options = parser.parse_args()
    if options.json and (not options.cpu_time or options.device != "cpu"):
        parser.error("--json stores steps per CPU second; add --cpu-time, and use the CPU")
    clock = time.process_time if options.cpu_time else time.perf_counter
    unit = "steps per CPU second" if options.cpu_time else "steps/s"
    torch.set_num_threads(options.threads)
    opened = open_graph(options.book)
    policy = PolicyConfig(options.policy, use=options.use)
    memory = 1.0 if options.policy == "pairs" else 0.0
    config = ImpalaConfig(
        "paper",
        batch_size=options.batch,
        memory_cost=memory,
        device=options.device,
        tables=options.tables,
    )
    print(
        f"{opened.graph.name}, {options.distractors} distractors, batch {config.num_envs}, "
        f"unroll {config.unroll}, {options.threads} "
        f"thread{'s' * (options.threads > 1)} of {os.cpu_count()}"
    )
    scorer: TripleScorer
    if options.scorer:
        scorer = load_scorer(options.scorer)
    else:
        scorer = NeighbourScorer(opened.graph, opened.split.partial)
    rates: dict[str, list[float]] = {}
    for _ in range(options.rounds):
        unguided, guided = (
            rate(
                ours(opened, config, options.distractors, one, policy),
                config,
                options.seconds,
                clock,
            )
            for one in (None, scorer)
        )
        print(
            f"unguided {unguided:8,.0f} {unit}   guided {guided:8,.0f} {unit}", end="", flush=True
        )
        kind = ""
        if (options.policy, options.batch) != ("attention", 128):
            kind = f", {options.policy}, batch {options.batch}"
        kept = ", known tables" if options.tables else ""
        rates.setdefault("no graph" + kind, []).append(unguided)
        rates.setdefault(options.use + kept + kind, []).append(guided)
        if options.device == "cpu":
            step = plain(opened, config, options.distractors)
            beside = rate(step, config, options.seconds, clock)
            rates.setdefault("plain loop", []).append(beside)
            print(
                f"   plain loop, unguided {beside:8,.0f} {unit}: {unguided / beside:.2f} x", end=""
            )
        print(flush=True)
    if options.json:
        store(options.json, opened.graph.name, rates)
    if options.whole:
        whole(options.book, options.distractors, options.steps, options.device)


if __name__ == "__main__":
    main()
