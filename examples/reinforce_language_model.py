"""Train a language model by its own games, with group-relative policy optimisation (GRPO).

    wordcraft-kg chats everyday --style text --depth 1 --distractors 1,8 --out sft.jsonl
    python examples/finetune_language_model.py model.gguf everyday --chats sft.jsonl --out talking
    python examples/reinforce_language_model.py talking everyday --chats sft.jsonl --out reinforced

In each step the model draws some answers to the first question of a few games (a group each), and
the environment rewards them: 1 for the goal, else 0, and ``--form`` for an answer that names two
items on the table, which is counted apart. An answer's advantage is its reward minus the
group's mean, divided by the group's standard deviation (Shao et al. 2024, "DeepSeekMath", outcome
supervision). Answers are used once, for one gradient step, so there is no ratio to clip, and the
small rate stands for the penalty to the first model. A group of equal rewards teaches nothing.

The questions are those of a file of the command ``chats``; its answers are never read. Games with
recipes that are left out (fold 0 of ``--folds``) are not learned; they are played before and after,
greedily. The same command continues an interrupted training, with equal bits. The model plays by
generation:

    wordcraft-kg bench run craft-1-lite --out submission --weights reinforced/model.safetensors \
        --player "program:python examples/transformers_player.py reinforced --by generation"
"""

import argparse
import copy
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from finetune_language_model import (
    Row,
    Tree,
    loss_of,
    parameters_to_train,
    read_chats,
    read_state,
    save_model,
    write_state,
)
from transformers_player import Reader, by_generation

from wordcraft_kg import open_graph
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import WordCraftKGError


@dataclass(frozen=True)
class Settings:
    """Settings of a training.

    Attributes:
        folds: folds of each split's train recipes; games with recipes of one are not learned.
        layers: last layers to train; 0 for all.
        steps: gradient steps.
        groups: games in a step.
        answers: answers to each question.
        new_tokens: most tokens of an answer.
        lr: learning rate, after a warm-up of ten steps.
        form: reward of an answer that names two items on the table, beside that of the goal.
        judge_every: steps between two plays of games that are left out; 0 plays none meanwhile.
        seed: seed of games and answers.
    """

    folds: int = 20
    layers: int = 12
    steps: int = 200
    groups: int = 4
    answers: int = 8
    new_tokens: int = 12
    lr: float = 1e-5
    form: float = 0.0
    judge_every: int = 0
    seed: int = 0


class Games:
    """The games of some conversations, to ask and to reward."""

    def __init__(self, graph: str) -> None:
        """Prepare to play games of a graph."""
        self._graph = graph
        self._environments: dict[tuple[str, int, int, int], TextEnv] = {}

    def reward(self, row: Row, answer: str) -> float:
        """Return the reward of the first answer in a game: 1 for the goal."""
        return self.outcome(row, answer)[0]

    def outcome(self, row: Row, answer: str) -> tuple[float, float]:
        """Return the reward of the first answer in a game, and 1 if it names two items, else 0.

        Raises:
            ValueError: if the row's question is not that of the game which its name names.
        """
        depth, distractors, task, table = map(int, row["id"].split("-")[-4:])
        key = (row["part"], depth, distractors, row["attempts"])
        if key not in self._environments:
            self._environments[key] = TextEnv(
                self._graph,
                part=row["part"],
                depth=depth,
                num_distractors=distractors,
                max_attempts=row["attempts"],
            )
        environment = self._environments[key]
        opening, _ = environment.reset(options={"task": task, "distractor_seed": table})
        # Rules are worded anew from time to time; goal and table must be those of the file.
        _, _, table_and_goal = opening.partition("\n\n")
        if table_and_goal != row["messages"][1]["content"]:
            raise ValueError(f"'{row['id']}' is another game of '{self._graph}' than in its file.")
        _, reward, *_, info = environment.step(answer)
        return float(reward), float(not info["invalid_actions"])


@torch.no_grad()
def draw_answers(
    reader: Reader, prompt: list[int], settings: Settings, generator: torch.Generator
) -> list[list[int]]:
    """Draw answers from the model's probabilities, and return their tokens.

    An answer ends with the end token, unless it is cut off at ``new_tokens``.
    """
    reader.read(prompt)
    # The question is read once; each answer goes on from a copy of what was read.
    cache = copy.deepcopy(reader.cache)
    cache.batch_repeat_interleave(settings.answers)
    log_probs = reader.next.expand(settings.answers, -1)
    answers: list[list[int]] = [[] for _ in range(settings.answers)]
    for place in range(settings.new_tokens):
        drawn = torch.multinomial(log_probs.exp(), 1, generator=generator)  # (answers, 1)
        for answer, token in zip(answers, drawn[:, 0].tolist(), strict=True):
            if reader.end not in answer:
                answer.append(token)
        if place + 1 == settings.new_tokens or all(reader.end in answer for answer in answers):
            break
        logits = reader.model(input_ids=drawn, past_key_values=cache).logits
        log_probs = logits[:, -1].log_softmax(-1)
    # The next step's weights give other keys and values.
    reader.cut(0)
    return answers


def text_of(reader: Reader, tokens: list[int]) -> str:
    """Return the answer that some tokens write."""
    return str(reader.tokenizer.decode(tokens, skip_special_tokens=True))


def check(settings: Settings, games: int) -> None:
    """Raise ValueError if no step could teach anything with so many games to learn."""
    if not 1 <= settings.groups <= games:
        raise ValueError(
            f"found {games} games to learn, and {settings.groups} groups a step; expected at "
            "least a group, and a game for each: set --groups, or write more games."
        )
    if settings.answers < 2:
        raise ValueError(
            f"found {settings.answers} answers to a question; expected two or more, since an "
            "answer alone is as good as its group: set --answers."
        )


def reinforce(
    reader: Reader,
    rows: Sequence[Row],
    games: Games,
    settings: Settings,
    state: Path,
    *,
    judge: Callable[[], float | None] = lambda: None,
    save_every: int = 20,
    stop_after: int | None = None,
) -> Iterator[dict[str, float | None]]:
    """Train a model by its games, and yield the figures of each step; continues from ``state``.

    Args:
        reader: the model, which is changed.
        rows: conversations, of which the first question is asked.
        games: plays and rewards them.
        settings: settings, which the state must have been trained with.
        state: folder for the state.
        judge: returns the success in games that are left out, every ``judge_every`` steps.
        save_every: steps between two states.
        stop_after: number of the step before which training stops; None for the end.

    Raises:
        ValueError: if the state has other settings or games, or if no step could teach anything.
    """
    check(settings, len(rows))
    trained = parameters_to_train(reader.model, settings.layers)
    optimiser = torch.optim.AdamW(trained.values(), lr=settings.lr, weight_decay=0.0)
    facts = {"settings": asdict(settings), "games": [row["id"] for row in rows]}
    begun = read_state(state, trained, optimiser, facts)
    last = min(settings.steps, stop_after or settings.steps)
    for step in range(begun, last):
        optimiser.param_groups[0]["lr"] = settings.lr * min(1.0, (step + 1) / 10)
        started = time.process_time()
        # Each step has generators of its own, so that a continued training draws the same.
        chosen = np.random.default_rng([settings.seed, step]).choice(
            len(rows), settings.groups, replace=False
        )
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + step)
        trees: list[Tree] = []
        outcomes: list[tuple[float, float]] = []
        for row in (rows[place] for place in chosen.tolist()):
            prompt = reader.chat(row["messages"][:2], True)
            answers = draw_answers(reader, prompt, settings, generator)
            played = [games.outcome(row, text_of(reader, answer)) for answer in answers]
            outcomes += played
            # Form and goal are counted apart, and added for the gradient alone.
            group = np.array([made + settings.form * is_read for made, is_read in played])
            if group.std():
                advantages = (group - group.mean()) / group.std()
                trees.append(Tree(prompt, answers, [], advantages.tolist()))
        if trees:
            # A weight is an advantage: good answers become likelier, bad ones less likely.
            torch.autograd.backward(loss_of(reader.model, trees))
            torch.nn.utils.clip_grad_norm_(trained.values(), 1.0)
            optimiser.step()
            optimiser.zero_grad()
        reward, form = np.mean(outcomes, axis=0).tolist()
        is_judged = settings.judge_every and (step + 1) % settings.judge_every == 0
        yield {
            "step": step + 1,
            "of": settings.steps,
            "reward": round(reward, 4),
            "form": round(form, 4),
            "held_out": judge() if is_judged else None,
            "groups_that_teach": len(trees),
            "cpu_seconds": round(time.process_time() - started, 2),
        }
        # Without a gradient so far the optimiser has no moments to write.
        if optimiser.state and ((step + 1) % save_every == 0 or step + 1 == last):
            write_state(state, trained, optimiser, facts | {"step": step + 1})


@torch.no_grad()
def success(reader: Reader, rows: Sequence[Row], games: Games, settings: Settings) -> float | None:
    """Return the share of games made by the first, greedy answer; None without games."""
    if not rows:
        return None
    reader.cut(0)
    made = []
    for row in rows:
        prompt = reader.chat(row["messages"][:2], True)
        made.append(games.reward(row, by_generation(reader, prompt, settings.new_tokens)))
    return float(np.mean(made))


def main() -> None:
    """Play the games left out, train, play them again, and write the model's folder."""
    from transformers.utils import logging

    defaults = asdict(Settings())
    parser = argparse.ArgumentParser(description="Train a language model by its own games.")
    parser.add_argument("model", help="model folder, .gguf file, or a name on the hub")
    parser.add_argument("graphs", nargs="+", help="graph folders, or a book for its default split")
    parser.add_argument("--chats", type=Path, required=True, help="games, by `chats --style text`")
    parser.add_argument("--out", type=Path, required=True, help="folder for the trained model")
    for name, value in defaults.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    parser.add_argument("--tasks", type=int, default=100, help="most games left out to play")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    settings = Settings(**{name: getattr(options, name) for name in defaults})

    splits = [open_graph(graph).split for graph in options.graphs]
    rows, left_out = read_chats(options.chats, splits, settings.folds)
    check(settings, len(rows))
    order = np.random.default_rng(settings.seed).permutation(len(left_out))
    judged = [left_out[place] for place in order[: options.tasks].tolist()]
    reader = Reader(options.model)
    games = Games(options.graphs[0])
    options.out.mkdir(parents=True, exist_ok=True)
    log = options.out / "training.jsonl"
    before = success(reader, judged, games, settings)

    def judge() -> float | None:
        return success(reader, judged, games, settings)

    with log.open("a", encoding="utf-8") as file:
        folder = options.out / "state"
        for figures in reinforce(reader, rows, games, settings, folder, judge=judge):
            print(json.dumps(figures), file=file, flush=True)
            print(json.dumps(figures), file=sys.stderr, flush=True)
    save_model(reader.model, reader.tokenizer, options.out)
    # A step that ran twice, before and after an interruption, counts once.
    done = {row["step"]: row for row in map(json.loads, log.read_text("utf-8").splitlines())}
    weights = options.out / "model.safetensors"
    facts: dict[str, Any] = {
        "settings": asdict(settings),
        "weights": {weights.name: sha256_of(weights)},
        "book": splits[0].graph.name,
        "games": len(rows),
        "left_out": len(judged),
        "success_before": before,
        "success_after": success(reader, judged, games, settings),
        "cpu_seconds": round(sum(row["cpu_seconds"] for row in done.values())),
    }
    print(json.dumps(facts, indent=1))
    (options.out / "training.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except (WordCraftKGError, ValueError, OSError) as error:
        sys.exit(f"error: {error}")
