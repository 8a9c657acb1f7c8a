"""Fine-tune a language model on a GPU: recipes as texts and games, by low-rank matrices.

    wordcraft-kg build-graph everyday --split by-goal --out graphs/by-goal
    wordcraft-kg chats everyday --style text --distractors 8 --tables 12 --out sft.jsonl
    python examples/finetune_on_gpu.py prepare everyday graphs/by-goal --chats sft.jsonl --out sft
    python examples/finetune_on_gpu.py train sft model --seed 0 --out adapter.safetensors
    python examples/finetune_on_gpu.py merge model adapter.safetensors --out tuned

`prepare` writes what the model learns: the recipes that are train recipes in all of the splits, in
both orders, and each answer of the games that is no mistake. A twentieth of each split's train
recipes is left out, with its games, to choose settings by. `train` needs torch, transformers and
safetensors alone, so that it runs on a machine without this package. `merge` adds the learned
matrices to the weights; the folder plays by examples/transformers_player.py.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch.nn.functional import cross_entropy, linear

LEARNED = "learned.jsonl"
LEFT_OUT = "left-out.jsonl"
FOLDS = 20
MOST_ANSWER = 12
"""Tokens of an answer, as examples/transformers_player.py generates them."""


@dataclass(frozen=True)
class Settings:
    """Settings of a training.

    Attributes:
        rank: rank of the learned matrices; 0 trains all weights.
        lr: highest learning rate; after a warm-up of a twentieth it falls to 0 in a line.
        epochs: passes over the games, or a part of them below 1.
        recipe_epochs: passes over the recipes in each pass over the games.
        batch: most tokens in a step, padding included.
        seed: seed of the matrices and the orders.
    """

    rank: int = 24
    lr: float = 1e-3
    epochs: float = 1.0
    recipe_epochs: int = 4
    batch: int = 32_768
    seed: int = 0


class LowRank(torch.nn.Module):
    """A linear layer with frozen weights ``W`` and a learned change: ``W x + 2 B A x``."""

    def __init__(self, layer: torch.nn.Linear, rank: int, rng: torch.Generator):
        """Wrap a layer; ``B`` begins as 0, so at first nothing changes."""
        super().__init__()
        self.layer = layer
        outputs, inputs = layer.weight.shape
        bound = 1 / math.sqrt(inputs)
        first = (torch.rand(rank, inputs, generator=rng) * 2 - 1) * bound
        self.first = torch.nn.Parameter(first)
        self.second = torch.nn.Parameter(torch.zeros(outputs, rank))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return the outputs, shape (..., outputs)."""
        change = linear(linear(values, self.first), self.second)
        result: torch.Tensor = self.layer(values) + 2 * change
        return result


def add_low_rank(model: Any, rank: int, seed: int) -> dict[str, torch.nn.Parameter]:
    """Wrap all linear layers but the last; return the parameters to train by name."""
    rng = torch.Generator().manual_seed(seed)
    model.requires_grad_(rank == 0)
    layers = [
        (name, layer)
        for name, layer in model.model.named_modules()
        if isinstance(layer, torch.nn.Linear)
    ]
    for name, layer in layers if rank else []:
        parent = model.model.get_submodule(name.rpartition(".")[0])
        wrapped = LowRank(layer, rank, rng).to(layer.weight.device)
        setattr(parent, name.rpartition(".")[2], wrapped)
    return {name: value for name, value in model.named_parameters() if value.requires_grad}


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of JSON lines."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def tokens_of(rows: Sequence[dict[str, Any]], tokenizer: Any) -> list[tuple[list[int], list[int]]]:
    """Return prompt and answer of each row as tokens; answers in games end a turn."""
    prompts = []
    answers = []
    for row in rows:
        is_game = isinstance(row["prompt"], list)
        prompt = row["prompt"]
        if is_game:
            prompt = tokenizer.apply_chat_template(
                prompt, tokenize=False, add_generation_prompt=True
            )
        prompts.append(prompt)
        answers.append(row["answer"] + (tokenizer.eos_token if is_game else ""))
    texts = [tokenizer(part, add_special_tokens=False).input_ids for part in (prompts, answers)]
    return list(zip(*texts, strict=True))


def _asked(messages: Any, tokenizer: Any) -> str:
    """Return a conversation as text that ends with the beginning of an answer."""
    text = tokenizer.apply_chat_template(messages, tokenize=False, add_generation_prompt=True)
    return str(text)


def batches(
    texts: Sequence[tuple[list[int], list[int]]], most: int, rng: np.random.Generator
) -> list[list[int]]:
    """Return the texts' numbers in batches of about equal length, in random order."""
    sizes = np.array([len(prompt) + len(answer) for prompt, answer in texts])
    order = np.argsort(sizes + rng.random(len(sizes)) * 8)
    made: list[list[int]] = [[]]
    for number in order.tolist():
        if made[-1] and (len(made[-1]) + 1) * (sizes[number] + 8) > most:
            made.append([])
        made[-1].append(number)
    return [made[place] for place in rng.permutation(len(made))]


def loss_of(model: Any, texts: Sequence[tuple[list[int], list[int]]]) -> torch.Tensor:
    """Return the mean loss of the answers' tokens."""
    device = model.lm_head.weight.device
    length = max(len(prompt) + len(answer) for prompt, answer in texts) - 1
    ids = torch.zeros(len(texts), length, dtype=torch.long)
    rows: list[int] = []
    columns: list[int] = []
    targets: list[int] = []
    for row, (prompt, answer) in enumerate(texts):
        text = [*prompt, *answer]
        ids[row, : len(text) - 1] = torch.tensor(text[:-1])
        rows += [row] * len(answer)
        columns += range(len(prompt) - 1, len(text) - 1)
        targets += answer
    # Padding stands behind the text, where no token sees it.
    hidden = model.model(input_ids=ids.to(device), use_cache=False).last_hidden_state
    logits = model.lm_head(hidden[rows, columns])
    return cross_entropy(logits.float(), torch.tensor(targets, device=device))


def train(
    model: Any, rows: Sequence[dict[str, Any]], tokenizer: Any, settings: Settings
) -> Iterator[dict[str, float]]:
    """Train a model in place, and yield the figures of each step."""
    device = model.lm_head.weight.device
    trained = add_low_rank(model, settings.rank, settings.seed)
    texts = tokens_of(rows, tokenizer)
    is_game = np.array([isinstance(row["prompt"], list) for row in rows])
    games = np.flatnonzero(is_game)
    recipes = np.flatnonzero(~is_game)
    rng = np.random.default_rng(settings.seed)
    steps: list[list[int]] = []
    left = settings.epochs
    while left > 0:
        part = rng.permutation(games)[: round(min(1.0, left) * len(games))]
        times = max(1, round(settings.recipe_epochs * min(1.0, left)))
        chosen = np.concatenate([part, *[recipes] * times])
        made = batches([texts[number] for number in chosen], settings.batch, rng)
        steps += [chosen[batch].tolist() for batch in made]
        left -= 1
    optimiser = torch.optim.AdamW(
        trained.values(), lr=settings.lr, weight_decay=0.01, betas=(0.9, 0.98)
    )
    model.train()
    started = time.monotonic()
    for step, batch in enumerate(steps):
        warm = (step + 1) / max(1, len(steps) // 20)
        optimiser.param_groups[0]["lr"] = settings.lr * min(warm, 1 - step / len(steps))
        with torch.autocast(device.type, torch.bfloat16):
            loss = loss_of(model, [texts[number] for number in batch])
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(trained.values(), 1.0)
        optimiser.step()
        optimiser.zero_grad()
        if step % 20 == 0 or step + 1 == len(steps):
            seconds = round(time.monotonic() - started, 1)
            shown = {"step": step + 1, "of": len(steps), "loss": loss.item(), "seconds": seconds}
            yield shown
    model.eval()


@torch.inference_mode()
def answers_of(model: Any, prompts: Sequence[Any], tokenizer: Any, batch: int = 256) -> list[str]:
    """Return the model's answer to each prompt, each token the most probable."""
    device = model.lm_head.weight.device
    tokenizer.padding_side = "left"
    answers: list[str] = []
    for start in range(0, len(prompts), batch):
        texts = [_asked(prompt, tokenizer) for prompt in prompts[start : start + batch]]
        read = tokenizer(texts, add_special_tokens=False, padding=True, return_tensors="pt")
        made = model.generate(
            **read.to(device),
            max_new_tokens=MOST_ANSWER,
            do_sample=False,
            eos_token_id=tokenizer.eos_token_id,
            pad_token_id=tokenizer.eos_token_id,
        )
        new = made[:, read.input_ids.shape[1] :]
        answers += tokenizer.batch_decode(new, skip_special_tokens=True)
    return answers


def judged(rows: Sequence[dict[str, Any]], answers: Sequence[str]) -> dict[str, float]:
    """Return the shares of right answers, and of those that name no two items of the table."""
    right = invalid = 0
    for row, answer in zip(rows, answers, strict=True):
        pair = answer.strip().split(" + ")
        invalid += len(pair) != 2 or not set(row["table"]).issuperset(pair)
        right += sorted(pair) in row["right"]
    return {"asked": len(rows), "right": right / len(rows), "invalid": invalid / len(rows)}


def prepare(options: argparse.Namespace) -> None:
    """Write what the model learns, and questions about what is left out."""
    from finetune_language_model import STEM, answers_in, learned, read_chats

    from wordcraft_kg import open_graph

    splits = [open_graph(graph).split for graph in options.graphs]
    graph = splits[0].graph
    recipes = learned(splits, FOLDS).tolist()
    rows: list[dict[str, Any]] = []
    questions: list[dict[str, Any]] = []
    for one, other, goal in recipes:
        stem = STEM.format(graph.entities[goal])
        for first, second in ((one, other), (other, one)):
            rows.append(
                {"prompt": stem, "answer": f" {graph.entities[first]} + {graph.entities[second]}"}
            )
    makers: dict[str, list[list[str]]] = {}
    for one, other, goal in splits[0].recipes("train").tolist():
        pair = sorted((graph.entities[one], graph.entities[other]))
        makers.setdefault(graph.entities[goal], []).append(pair)
    for path in options.chats:
        chats, left_out = read_chats(path, splits, FOLDS)
        for chat in chats:
            messages = chat["messages"]
            for place in answers_in(chat):
                rows.append({"prompt": messages[:place], "answer": messages[place]["content"]})
        for chat in left_out:
            if chat["wording"] or chat["depth"] > 1 or chat["distractors"] != 8:
                continue
            question = chat["messages"][:2]
            listed = question[1]["content"].splitlines()[1].removeprefix("Table: ").split(", ")
            table = [item.partition(" ")[2] for item in listed]
            right = [pair for pair in makers[chat["goal"]] if set(table).issuperset(pair)]
            questions.append({"prompt": question, "table": table, "right": right})
    options.out.mkdir(parents=True)
    for name, written in ((LEARNED, rows), (LEFT_OUT, questions)):
        text = "".join(json.dumps(row) + "\n" for row in written)
        (options.out / name).write_text(text, encoding="utf-8")
    print(f"{len(rows):,} answers to learn, {len(questions):,} questions to choose by")


def open_model(folder: str) -> tuple[Any, Any]:
    """Return a model of a folder in float32, and its tokenizer."""
    from transformers import AutoModelForCausalLM, AutoTokenizer

    path = Path(folder)
    where = {"gguf_file": path.name} if path.suffix == ".gguf" else {}
    name = str(path.parent) if where else folder
    model = AutoModelForCausalLM.from_pretrained(name, dtype=torch.float32, **where)
    return model, AutoTokenizer.from_pretrained(name, **where)


def train_command(options: argparse.Namespace) -> None:
    """Train with one seed; write the matrices, and print the share of right answers."""
    model, tokenizer = open_model(options.model)
    model.to("cuda" if torch.cuda.is_available() else "cpu")
    names = ("rank", "lr", "epochs", "recipe_epochs", "batch", "seed")
    settings = Settings(**{name: getattr(options, name) for name in names})
    for shown in train(model, read_rows(options.texts / LEARNED), tokenizer, settings):
        print(json.dumps(shown), flush=True)
    write_adapter(model, options.out)
    rows = read_rows(options.texts / LEFT_OUT)
    print(judged(rows, answers_of(model, [row["prompt"] for row in rows], tokenizer)))


def write_adapter(model: Any, path: Path) -> None:
    """Write the trained parameters, in bfloat16."""
    trained = {name: value for name, value in model.named_parameters() if value.requires_grad}
    tensors = {name: value.detach().bfloat16().cpu() for name, value in trained.items()}
    save_file(tensors, path)


@torch.no_grad()
def add_changes(model: Any, tensors: dict[str, torch.Tensor]) -> None:
    """Add learned matrices to the weights of a model that has none."""
    for name in tensors:
        layer, _, last = name.rpartition(".")
        if last == "first":
            change = tensors[f"{layer}.second"].float() @ tensors[name].float()
            model.get_submodule(layer).weight += 2 * change


def merge(options: argparse.Namespace) -> None:
    """Add learned matrices to a model, and write its folder."""
    from finetune_language_model import save_model

    model, tokenizer = open_model(options.model)
    add_changes(model, load_file(options.adapter))
    save_model(model, tokenizer, options.out)


def main() -> None:
    """Run one of the three commands."""
    parser = argparse.ArgumentParser(description="Fine-tune a language model on a GPU.")
    commands = parser.add_subparsers(required=True)
    first = commands.add_parser("prepare", help="write what the model learns")
    first.set_defaults(run=prepare)
    first.add_argument("graphs", nargs="+", help="graph folders, or a book for its default split")
    first.add_argument(
        "--chats", type=Path, nargs="+", required=True, help="by `chats`, text style"
    )
    second = commands.add_parser("train", help="learn low-rank matrices")
    second.set_defaults(run=train_command)
    second.add_argument("texts", type=Path, help="folder of `prepare`")
    second.add_argument("model", help="model folder or .gguf file")
    for name, value in vars(Settings()).items():
        second.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    third = commands.add_parser("merge", help="add the matrices to the weights")
    third.set_defaults(run=merge)
    third.add_argument("model", help="the model that was trained")
    third.add_argument("adapter", type=Path, help="file of `train`")
    for command in (first, second, third):
        command.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
