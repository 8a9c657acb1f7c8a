"""Fine-tune a language model on train recipes or games, with torch and transformers alone.

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

With ``--chats`` it learns the answers in conversations instead, and plays by generation:

    wordcraft-kg chats everyday --style text --depth 1 --distractors 1,8 --out sft.jsonl
    python examples/finetune_language_model.py tuned everyday --chats sft.jsonl --out talking
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch.nn.functional import cross_entropy

from wordcraft_kg import RecipeGraph, open_graph
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.train_samples import make_folds

Tokens = Callable[[str], list[int]]
Recipes = NDArray[np.int64]
Parameters = dict[str, torch.nn.Parameter]
Row = dict[str, Any]
Prompts = Callable[[list[dict[str, str]], bool], list[int]]
"""From messages, and whether an answer follows, to tokens."""
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
    """Texts with an equal beginning as tokens, such as the recipes of a goal.

    Attributes:
        stem: the beginning, which is read once.
        branches: the continuations.
        told: for each branch, the number of its first tokens that are read without loss; empty if
            there are none.
        weights: for each branch, a factor of its loss; empty if all are 1.
    """

    stem: list[int]
    branches: list[list[int]]
    told: list[int] = field(default_factory=list)
    weights: list[float] = field(default_factory=list)

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
    """Return the mean loss of all tokens of the branches that are not told."""
    length = max(tree.size for tree in batch)
    ids = torch.zeros(len(batch), length, dtype=torch.long)
    positions = torch.zeros_like(ids)
    sees = torch.eye(length, dtype=torch.bool).repeat(len(batch), 1, 1)
    places: dict[tuple[int, int], int] = {}
    asked, targets, weights = [], [], []
    for row, tree in enumerate(batch):
        stem = len(tree.stem)
        ids[row, :stem] = torch.tensor(tree.stem)
        positions[row, :stem] = torch.arange(stem)
        sees[row, :stem, :stem] = torch.ones(stem, stem).tril().bool()
        start = stem
        told_of = tree.told or [0] * len(tree.branches)
        weight_of = tree.weights or [1.0] * len(tree.branches)
        for branch, told, weight in zip(tree.branches, told_of, weight_of, strict=True):
            read = len(branch) - 1
            end = start + read
            ids[row, start:end] = torch.tensor(branch[:-1], dtype=torch.long)
            positions[row, start:end] = torch.arange(stem, stem + read)
            sees[row, start:end, :stem] = True
            sees[row, start:end, start:end] = torch.ones(read, read).tril().bool()
            # The first token of each branch follows the stem's last, whose logits are made once.
            before = [stem - 1, *range(start, end)]
            for place, token in zip(before[told:], branch[told:], strict=True):
                asked.append(places.setdefault((row, place), len(places)))
                targets.append(token)
                weights.append(weight)
            start = end
    hidden = model.model(
        input_ids=ids, attention_mask=sees[:, None], position_ids=positions, use_cache=False
    ).last_hidden_state
    rows, columns = torch.tensor(list(places)).T
    logits = model.lm_head(hidden[rows, columns])
    losses = cross_entropy(logits[asked], torch.tensor(targets), reduction="none")
    return (losses * torch.tensor(weights)).mean()


def answers_in(row: Row) -> list[int]:
    """Return the places of the answers in a game's messages, without those that are mistakes."""
    mistakes = row.get("mistakes", ())
    return [
        place
        for place, message in enumerate(row["messages"])
        if message["role"] == "assistant" and place not in mistakes
    ]


def games_of(path: Path) -> Iterator[tuple[Row, list[tuple[str, str]]]]:
    """Yield the games of a file of `chats --style text`, each with the pairs of its answers.

    Raises:
        ValueError: for a line that this command does not write.
        OSError: if the file cannot be read.
    """
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            row = json.loads(line)
            said = [row["messages"][place]["content"] for place in answers_in(row)]
            last = [text.splitlines()[-1].split(" + ") for text in said]
            pairs = [(first, second) for first, second in last]
            # These are read later: fail here, with the number of the line.
            row["id"], row["part"], row["attempts"]
        except (ValueError, LookupError, TypeError, AttributeError):
            raise ValueError(
                f"line {number} of '{path}' is no game with answers 'first + second'; expected a "
                "line of `chats --style text`."
            ) from None
        yield row, pairs


def recipes_by_text(graph: RecipeGraph) -> dict[str, tuple[int, int, int]]:
    """Return recipes by their texts in both orders, such as ``water + earth -> mud``."""
    recipe_of = {}
    for one, other, goal in graph.recipes.tolist():
        for first, second in ((one, other), (other, one)):
            names = (graph.entities[number] for number in (first, second, goal))
            recipe_of["{} + {} -> {}".format(*names)] = (one, other, goal)
    return recipe_of


def reasons_in(row: Row, recipe_of: dict[str, tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Return the recipes that the reasons of a game's answers name.

    Raises:
        ValueError: for a reason that names something else.
    """
    reasons: list[tuple[int, int, int]] = []
    for place in answers_in(row):
        line, _, answer = row["messages"][place]["content"].partition("\n")
        named = line.removeprefix("Similar recipes: ").partition(". So ")[0]
        for text in named.split(", ") if answer else ():
            if text not in recipe_of:
                raise ValueError(f"'{row['id']}' names '{text}', which is no recipe of the book.")
            reasons.append(recipe_of[text])
    return reasons


def read_chats(path: Path, splits: Sequence[Split], folds: int) -> tuple[list[Row], list[Row]]:
    """Return conversations to learn, and those left out: a row is a line of the command `chats`.

    A conversation is learned if all that its answers make, or name as reasons, are recipes to
    learn; it is left out if an answer uses another train recipe. Conversations with a test recipe
    of some split are in neither list.

    Raises:
        ValueError: for a line that the command does not write, for a row of another part than
            train, and for one whose goal is made by a recipe that is a train recipe of no split.
        OSError: if the file cannot be read.
    """
    graph = splits[0].graph
    ids = {name: number for number, name in enumerate(graph.entities)}
    makes: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for one, other, goal in graph.recipes.tolist():
        makes.setdefault((one, other), []).append((one, other, goal))
    recipe_of = recipes_by_text(graph)
    to_learn = set(map(tuple, learned(splits, folds).tolist()))
    trains = [set(map(tuple, split.recipes("train").tolist())) for split in splits]
    kept: list[Row] = []
    left_out: list[Row] = []
    for row, pairs in games_of(path):
        name = row["id"]
        if row["part"] != "train":
            raise ValueError(f"'{name}' is of the part {row['part']}; expected train.")
        used = []
        for first, second in pairs:
            if first not in ids or second not in ids:
                raise ValueError(
                    f"'{name}' has the answer '{first} + {second}'; expected two items of "
                    f"'{graph.name}'. Write the games with `chats --style text` from this book."
                )
            one, other = sorted((ids[first], ids[second]))
            used += makes.get((one, other), [])
        used += reasons_in(row, recipe_of)
        for recipe in used:
            if not any(recipe in train for train in trains):
                raise ValueError(
                    f"'{name}' uses a recipe of '{graph.entities[recipe[2]]}' that is a train "
                    "recipe of no split: a model that reads it knows an answer of the test."
                )
        if to_learn.issuperset(used):
            kept.append(row)
        elif all(recipe in train for recipe in used for train in trains):
            left_out.append(row)
    return kept, left_out


def chat_trees(
    rows: Sequence[Row], prompts: Prompts, tokens: Tokens, end: int, most: int
) -> Callable[[np.random.Generator], list[Tree]]:
    """Return a function that returns an epoch's trees of at most ``most`` tokens.

    A tree is the rules, read once, with a branch for each answer: all that was said before, and the
    answer, which alone counts.
    """
    answers: dict[tuple[int, ...], list[tuple[list[int], int]]] = {}
    for row in rows:
        messages = row["messages"]
        rules = prompts(messages[:1], False)
        for place in answers_in(row):
            before = prompts(messages[:place], True)
            if before[: len(rules)] != rules:
                raise ValueError(f"'{row['id']}': the chat template changes the rules later.")
            branch = [*before[len(rules) :], *tokens(messages[place]["content"]), end]
            answers.setdefault(tuple(rules), []).append((branch, len(before) - len(rules)))

    def drawn(rng: np.random.Generator) -> list[Tree]:
        made: list[Tree] = []
        for rules, of in answers.items():
            tree = Tree(list(rules), [], [])
            for place in rng.permutation(len(of)):
                branch, told = of[place]
                if tree.branches and tree.size + len(branch) > most:
                    made.append(tree)
                    tree = Tree(list(rules), [], [])
                tree.branches.append(branch)
                tree.told.append(told)
            made.append(tree)
        return made

    return drawn


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


def right_pairs(
    split: Split, settings: Settings, number: int, answer: Callable[[str, list[str]], str]
) -> dict[str, Any]:
    """Ask for recipes left out; return how many answers are right by the train recipes."""
    left_out = np.zeros((0, 3), dtype=np.int64)
    if settings.folds:
        left_out = make_folds(split, settings.folds).recipes_of(LEFT_OUT)
    asked = list(tables(split, left_out, number, np.random.default_rng(settings.seed)))
    right = 0
    for goal, items, pairs in asked:
        right += frozenset(answer(goal, items).split(" + ")) in pairs
    return {
        "kind": split.config.kind,
        "hash": split.hash,
        "left_out": len(left_out),
        "asked": len(asked),
        "right": right,
    }


def equal_answers(
    rows: Sequence[Row],
    rng: np.random.Generator,
    number: int,
    answer: Callable[[list[dict[str, str]]], str],
) -> dict[str, int]:
    """Ask the first question of some conversations; return how many answers are theirs."""
    places = rng.permutation(len(rows))[:number].tolist()
    equal = 0
    for messages in (rows[place]["messages"] for place in places):
        said = answer(messages[:2])
        equal += set(said.split(" + ")) == set(messages[2]["content"].split(" + "))
    return {"left_out": len(rows), "asked": len(places), "equal": equal}


def parameters_to_train(model: Any, layers: int) -> Parameters:
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
    trained = parameters_to_train(model, settings.layers)
    optimiser = torch.optim.AdamW(trained.values(), lr=settings.lr, weight_decay=0.01)
    steps: list[list[Tree]] = []
    for epoch in range(settings.epochs):
        rng = np.random.default_rng([settings.seed, epoch])
        steps += batches(of(rng), settings.batch, rng)
    facts = {"settings": asdict(settings), "texts": _digest(steps)}
    begun = read_state(state, trained, optimiser, facts)
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
            write_state(state, trained, optimiser, facts | {"step": step + 1})


def _digest(steps: Sequence[Sequence[Tree]]) -> str:
    trees_of_steps = [
        [(tree.stem, tree.branches, *filter(None, [tree.told])) for tree in step] for step in steps
    ]
    return hashlib.sha256(json.dumps(trees_of_steps).encode()).hexdigest()


def write_state(folder: Path, trained: Parameters, optimiser: Any, facts: dict[str, Any]) -> None:
    """Write trained parameters and the optimiser's moments, with facts, among them the step."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors: dict[str, torch.Tensor] = {}
    for name, value in trained.items():
        moments = optimiser.state[value]
        tensors |= {f"weight.{name}": value.detach()}
        tensors |= {f"{key}.{name}": moments[key] for key in ("exp_avg", "exp_avg_sq")}
    # One file, renamed when it is complete: weights and step never differ.
    save_file(tensors, folder / "part", {"facts": json.dumps(facts)})
    (folder / "part").rename(folder / "state.safetensors")


def read_state(folder: Path, trained: Parameters, optimiser: Any, facts: dict[str, Any]) -> int:
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


def save_model(model: Any, tokenizer: Any, folder: Path) -> None:
    """Write a model's folder, which plays and trains on as others do."""
    # The weights of a .gguf file were expanded when they were read, and are saved as usual.
    if getattr(model, "hf_quantizer", None) is not None:
        model.hf_quantizer = None
        del model.config.quantization_config
    model.save_pretrained(folder)
    tokenizer.save_pretrained(folder)


def main() -> None:
    """Train, ask for the recipes left out, and write the model's folder."""
    from transformers.utils import logging
    from transformers_player import Reader, by_generation, by_recipes

    defaults = asdict(Settings())
    parser = argparse.ArgumentParser(
        description="Fine-tune a language model on train recipes or games."
    )
    parser.add_argument("model", help="model folder, .gguf file, or a name on the hub")
    parser.add_argument("graphs", nargs="+", help="graph folders, or a book for its default split")
    parser.add_argument("--out", type=Path, required=True, help="folder for the tuned model")
    parser.add_argument("--chats", type=Path, help="games to learn, by `chats --style text`")
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
    chats: list[Row] = []
    other_chats: list[Row] = []
    if options.chats:
        chats, other_chats = read_chats(options.chats, splits, settings.folds)
        if not chats:
            raise ValueError(
                f"'{options.chats}' has no game to learn: all use recipes that are left out, or "
                "that a split holds out."
            )
        grow = chat_trees(chats, reader.chat, reader.tokens, reader.end, settings.batch)
    else:

        def grow(rng: np.random.Generator) -> list[Tree]:
            return trees(splits, recipes, reader.tokens, rng)

    rows = train(reader.model, grow, settings, options.out / "state")
    with log.open("a", encoding="utf-8") as file:
        for row in rows:
            print(json.dumps(row), file=file, flush=True)
            print(json.dumps(row), file=sys.stderr, flush=True)
    reader.model.eval()
    if settings.epochs:
        save_model(reader.model, reader.tokenizer, options.out)

    # A step that ran twice, before and after an interruption, counts once.
    done = {row["step"]: row for row in map(json.loads, log.read_text("utf-8").splitlines())}
    weights = options.out / "model.safetensors"
    of_splits: list[dict[str, Any]] = []
    facts = {
        "settings": asdict(settings),
        "weights": {weights.name: sha256_of(weights)} if settings.epochs else {},
        "book": splits[0].graph.name,
        "recipes": len(recipes),
        "chats": len(chats),
        "tokens": sum(row["tokens"] for row in done.values()),
        "cpu_seconds": round(sum(row["cpu_seconds"] for row in done.values())),
        "splits": of_splits,
    }
    with torch.inference_mode():
        for split in splits:
            of_splits.append(
                right_pairs(
                    split,
                    settings,
                    options.tasks,
                    lambda goal, items: by_recipes(reader, goal, items, set()),
                )
            )
        if options.chats:
            facts["answers"] = equal_answers(
                other_chats,
                np.random.default_rng(settings.seed),
                options.tasks,
                lambda messages: by_generation(reader, reader.chat(messages, True), 12),
            )
    print(json.dumps(facts, indent=1))
    (options.out / "training.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except (WordCraftKGError, ValueError, OSError) as error:
        sys.exit(f"error: {error}")
