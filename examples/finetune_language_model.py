"""Fine-tune a language model on train recipes as text, with torch and transformers alone.

    wordcraft-kg build-graph everyday --split by-goal --out graphs/by-goal
    python examples/finetune_language_model.py model.gguf everyday graphs/by-goal --out tuned

The model reads each recipe as ``Recipe: abacus = necklace + number``, in one of the two orders. The
recipes of a goal are a tree: ``Recipe: abacus =`` is read once, and each pair of ingredients sees
this text and itself alone, so the loss is that of the separate texts at about half their price. It
counts the ingredients alone. Embeddings stay as they are, and with ``--layers`` all layers but the
last.

With several splits of a book the model learns the recipes that are train recipes in all of them, so
that it may play the test tasks of each. Of each split a part of the train recipes (fold 0 of
``--folds``) is left out to choose settings by: for each of these recipes the model picks a pair
from ten items. Test recipes are never read. The same command continues an interrupted training,
with equal bits. Afterwards, the model plays by the texts that it learned:

    wordcraft-kg bench run goal-8-lite --out submission --weights tuned/model.safetensors \
        --player "program:python examples/transformers_player.py tuned --by recipes"
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch.nn.functional import cross_entropy

from wordcraft_kg import open_graph
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.graphs.splits import Split

Tokens = Callable[[str], list[int]]
Recipes = NDArray[np.int64]
Parameters = dict[str, torch.nn.Parameter]
STEM = "Recipe: {} ="
LEFT_OUT = 0
"""Fold of the train recipes by which settings are chosen."""
DISTRACTORS = 8


@dataclass(frozen=True)
class Settings:
    """Settings of a training.

    Attributes:
        folds: folds of each split's train recipes; one is left out. 0 leaves out none.
        layers: last layers to train; 0 for all.
        epochs: passes over the recipes.
        lr: highest learning rate; after a warm-up of a tenth it falls to 0 in a line.
        batch: most tokens in a step.
        seed: seed of the orders.
    """

    folds: int = 20
    layers: int = 0
    epochs: int = 3
    lr: float = 5e-4
    batch: int = 512
    seed: int = 0


@dataclass(frozen=True)
class Tree:
    """Recipes of a goal as tokens: a text that is read once, and its continuations."""

    stem: list[int]
    branches: list[list[int]]

    @property
    def size(self) -> int:
        """Tokens to read: nothing follows the last token of a branch, so it is not read."""
        return len(self.stem) + sum(len(branch) - 1 for branch in self.branches)


def learned(splits: Sequence[Split], folds: int) -> Recipes:
    """Return the recipes to learn, shape (n, 3): in all splits of the part train, and not left out.

    Raises:
        ValueError: for splits of different books.
    """
    graph = splits[0].graph
    kept = np.ones(graph.num_recipes, dtype=bool)
    for split in splits:
        if split.graph.hash != graph.hash:
            raise ValueError(f"'{split.graph.name}' is another book than '{graph.name}'.")
        kept &= make_folds(split, folds).seen([LEFT_OUT]) if folds else split.is_in("train")
    return graph.recipes[kept]


def refuse_held_out(splits: Sequence[Split], recipes: Recipes) -> None:
    """Raise ValueError if a recipe is no train recipe of a split."""
    names = splits[0].graph.entities
    for split in splits:
        train = set(map(tuple, split.recipes("train").tolist()))
        for recipe in map(tuple, recipes.tolist()):
            if recipe not in train:
                one, other, goal = (names[number] for number in recipe)
                raise ValueError(
                    f"'{one} + {other} -> {goal}' is no train recipe of the {split.config.kind} "
                    "split: a model that reads it knows an answer of the test."
                )


def trees(
    splits: Sequence[Split], recipes: Recipes, tokens: Tokens, rng: np.random.Generator
) -> list[Tree]:
    """Return a tree for each goal; which ingredient of a recipe comes first is drawn.

    Raises:
        ValueError: if a recipe is no train recipe of a split.
    """
    refuse_held_out(splits, recipes)
    names = splits[0].graph.entities
    branches: dict[int, list[list[int]]] = {}
    for (one, other, goal), turned in zip(recipes.tolist(), rng.random(len(recipes)), strict=True):
        first, second = (other, one) if turned < 0.5 else (one, other)
        branch = tokens(f" {names[first]} + {names[second]}")
        branches.setdefault(goal, []).append(branch)
    return [Tree(tokens(STEM.format(names[goal])), branches[goal]) for goal in sorted(branches)]


def batches(of: Sequence[Tree], most: int, rng: np.random.Generator) -> list[list[Tree]]:
    """Return the trees in batches of at most ``most`` tokens with padding, in random order.

    Trees of about equal size are together, so that little is padding.
    """
    jitter = rng.random(len(of))
    order = sorted(range(len(of)), key=lambda number: of[number].size + 4 * jitter[number])
    made: list[list[Tree]] = [[]]
    for number in order:
        # In rising order, the tree to add is about the longest.
        if made[-1] and (len(made[-1]) + 1) * (of[number].size + 4) > most:
            made.append([])
        made[-1].append(of[number])
    return [made[place] for place in rng.permutation(len(made))]


def loss_of(model: Any, batch: Sequence[Tree]) -> torch.Tensor:
    """Return the mean loss of all tokens of the branches."""
    length = max(tree.size for tree in batch)
    ids = torch.zeros(len(batch), length, dtype=torch.long)
    positions = torch.zeros_like(ids)
    sees = torch.eye(length, dtype=torch.bool).repeat(len(batch), 1, 1)
    places: dict[tuple[int, int], int] = {}
    asked, targets = [], []
    for row, tree in enumerate(batch):
        stem = len(tree.stem)
        ids[row, :stem] = torch.tensor(tree.stem)
        positions[row, :stem] = torch.arange(stem)
        sees[row, :stem, :stem] = torch.ones(stem, stem).tril().bool()
        start = stem
        for branch in tree.branches:
            read = len(branch) - 1
            end = start + read
            ids[row, start:end] = torch.tensor(branch[:-1], dtype=torch.long)
            positions[row, start:end] = torch.arange(stem, stem + read)
            sees[row, start:end, :stem] = True
            sees[row, start:end, start:end] = torch.ones(read, read).tril().bool()
            # The first token of each branch follows the stem's last, whose logits are made once.
            for place, token in zip([stem - 1, *range(start, end)], branch, strict=True):
                asked.append(places.setdefault((row, place), len(places)))
                targets.append(token)
            start = end
    hidden = model.model(
        input_ids=ids, attention_mask=sees[:, None], position_ids=positions, use_cache=False
    ).last_hidden_state
    rows, columns = torch.tensor(list(places)).T
    logits = model.lm_head(hidden[rows, columns])
    return cross_entropy(logits[asked], torch.tensor(targets))


def tables(
    split: Split, recipes: Recipes, number: int, rng: np.random.Generator
) -> Iterator[tuple[str, list[str], set[frozenset[str]]]]:
    """Yield some of the recipes' goals with ten items, and the right pairs by the train recipes."""
    names = split.graph.entities
    train = split.recipes("train")
    for place in sorted(rng.permutation(len(recipes))[:number]):
        one, other, goal = recipes[place].tolist()
        others = [item for item in range(len(names)) if item not in (one, other, goal)]
        table = {one, other, *rng.choice(others, DISTRACTORS, replace=False).tolist()}
        of_goal = train[train[:, 2] == goal]
        right = {frozenset((names[a], names[b])) for a, b, _ in of_goal.tolist()}
        yield names[goal], [names[item] for item in sorted(table)], right


def _trained(model: Any, layers: int) -> Parameters:
    """Return the parameters to train by name; all others are frozen."""
    model.requires_grad_(False)
    blocks = model.model.layers
    for block in blocks[len(blocks) - layers if layers else 0 :]:
        block.requires_grad_(True)
    model.model.norm.requires_grad_(True)
    return {name: value for name, value in model.named_parameters() if value.requires_grad}


def train(
    model: Any,
    of: Callable[[np.random.Generator], list[Tree]],
    settings: Settings,
    state: Path,
    *,
    save_every: int = 40,
    stop_after: int | None = None,
) -> Iterator[dict[str, float]]:
    """Train a model, and yield the figures of each step; continues from ``state`` if it is there.

    Args:
        model: a causal language model of transformers, which is changed.
        of: returns the trees of an epoch.
        settings: settings, which the state must have been trained with.
        state: folder for the state: weights and moments as safetensors, and the next step.
        save_every: steps between two states.
        stop_after: number of the step before which training stops; None for the end.
    """
    trained = _trained(model, settings.layers)
    optimiser = torch.optim.AdamW(trained.values(), lr=settings.lr, weight_decay=0.01)
    steps: list[list[Tree]] = []
    for epoch in range(settings.epochs):
        rng = np.random.default_rng([settings.seed, epoch])
        steps += batches(of(rng), settings.batch, rng)
    facts = {"settings": asdict(settings), "texts": _digest(steps)}
    begun = _read_state(state, trained, optimiser, facts)
    model.train()
    for step in range(begun, min(len(steps), stop_after or len(steps))):
        warm = (step + 1) / max(1, len(steps) // 10)
        left = 1 - step / len(steps)
        optimiser.param_groups[0]["lr"] = settings.lr * min(warm, left)
        started = time.process_time()
        loss = loss_of(model, steps[step])
        torch.autograd.backward(loss)
        norm = torch.nn.utils.clip_grad_norm_(trained.values(), 1.0)
        optimiser.step()
        optimiser.zero_grad()
        yield {
            "step": step + 1,
            "of": len(steps),
            "loss": round(loss.item(), 4),
            "norm": round(float(norm), 2),
            "tokens": sum(tree.size for tree in steps[step]),
            "cpu_seconds": round(time.process_time() - started, 2),
        }
        if (step + 1) % save_every == 0 or step + 1 in (len(steps), stop_after):
            _write_state(state, trained, optimiser, facts | {"step": step + 1})


def _digest(steps: Sequence[Sequence[Tree]]) -> str:
    trees_of_steps = [[(tree.stem, tree.branches) for tree in step] for step in steps]
    return hashlib.sha256(json.dumps(trees_of_steps).encode()).hexdigest()


def _write_state(folder: Path, trained: Parameters, optimiser: Any, facts: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    tensors: dict[str, torch.Tensor] = {}
    for name, value in trained.items():
        moments = optimiser.state[value]
        tensors |= {f"weight.{name}": value.detach()}
        tensors |= {f"{key}.{name}": moments[key] for key in ("exp_avg", "exp_avg_sq")}
    # One file, renamed when it is complete: weights and step never differ.
    save_file(tensors, folder / "part", {"facts": json.dumps(facts)})
    (folder / "part").rename(folder / "state.safetensors")


def _read_state(folder: Path, trained: Parameters, optimiser: Any, facts: dict[str, Any]) -> int:
    """Read a state into the parameters and the optimiser; return the next step."""
    path = folder / "state.safetensors"
    if not path.exists():
        return 0
    with safe_open(path, "pt") as file:
        found = json.loads(file.metadata()["facts"])
    step = int(found.pop("step"))
    if found != facts:
        raise ValueError(f"{path} has other settings or texts: {found}; choose another --out.")
    tensors = load_file(path)
    with torch.no_grad():
        for name, value in trained.items():
            value.copy_(tensors[f"weight.{name}"])
            optimiser.state[value] = {
                "step": torch.tensor(float(step)),
                **{key: tensors[f"{key}.{name}"] for key in ("exp_avg", "exp_avg_sq")},
            }
    return step


def main() -> None:
    """Train, ask for the recipes left out, and write the model's folder."""
    from transformers.utils import logging
    from transformers_player import Reader, by_recipes

    defaults = asdict(Settings())
    parser = argparse.ArgumentParser(description="Fine-tune a language model on train recipes.")
    parser.add_argument("model", help="model folder, .gguf file, or a name on the hub")
    parser.add_argument("graphs", nargs="+", help="graph folders, or a book for its default split")
    parser.add_argument("--out", type=Path, required=True, help="folder for the tuned model")
    for name, value in defaults.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    parser.add_argument("--tasks", type=int, default=100, help="tasks of recipes left out a split")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    settings = Settings(**{name: getattr(options, name) for name in defaults})

    splits = [open_graph(graph).split for graph in options.graphs]
    recipes = learned(splits, settings.folds)
    reader = Reader(options.model)
    options.out.mkdir(parents=True, exist_ok=True)
    log = options.out / "training.jsonl"
    rows = train(
        reader.model,
        lambda rng: trees(splits, recipes, reader.tokens, rng),
        settings,
        options.out / "state",
    )
    with log.open("a", encoding="utf-8") as file:
        for row in rows:
            print(json.dumps(row), file=file, flush=True)
            print(json.dumps(row), file=sys.stderr, flush=True)
    reader.model.eval()
    if settings.epochs:
        # The weights of a .gguf file were expanded when they were read, and are saved as usual.
        if getattr(reader.model, "hf_quantizer", None) is not None:
            reader.model.hf_quantizer = None
            del reader.model.config.quantization_config
        reader.model.save_pretrained(options.out)
        reader.tokenizer.save_pretrained(options.out)

    # A step that ran twice, before and after an interruption, counts once.
    done = {row["step"]: row for row in map(json.loads, log.read_text("utf-8").splitlines())}
    weights = options.out / "model.safetensors"
    of_splits: list[dict[str, Any]] = []
    facts = {
        "settings": asdict(settings),
        "weights": {weights.name: sha256_of(weights)} if settings.epochs else {},
        "book": splits[0].graph.name,
        "recipes": len(recipes),
        "tokens": sum(row["tokens"] for row in done.values()),
        "cpu_seconds": round(sum(row["cpu_seconds"] for row in done.values())),
        "splits": of_splits,
    }
    for split in splits:
        left_out = np.zeros((0, 3), dtype=np.int64)
        if settings.folds:
            left_out = make_folds(split, settings.folds).recipes_of(LEFT_OUT)
        rng = np.random.default_rng(settings.seed)
        right = 0
        asked = list(tables(split, left_out, options.tasks, rng))
        with torch.inference_mode():
            for goal, items, pairs in asked:
                answer = by_recipes(reader, goal, items, set())
                right += frozenset(answer.split(" + ")) in pairs
        of_splits.append(
            {
                "kind": split.config.kind,
                "hash": split.hash,
                "left_out": len(left_out),
                "asked": len(asked),
                "right": right,
            }
        )
    print(json.dumps(facts, indent=1))
    (options.out / "training.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
