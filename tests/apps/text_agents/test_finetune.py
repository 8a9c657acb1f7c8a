"""Fine-tuning and reinforcement by examples/, with a tiny random model."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from wordcraft_kg import SplitConfig, make_split, open_graph
from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.cli import main
from wordcraft_kg.graphs.train_samples import make_folds

EXAMPLES = Path(__file__).parents[3] / "examples"
SCRIPT = runpy.run_path(str(EXAMPLES / "finetune_language_model.py"), run_name="script")
Settings = SCRIPT["Settings"]
Tree = SCRIPT["Tree"]
SMALL = Settings(folds=5, layers=1, epochs=1, lr=1e-2, batch=200)


def tokens(text):
    """Return a number below 100 for each pair of letters: words have several tokens."""
    letters = text.replace(" ", "_")
    return [sum(map(ord, letters[at : at + 2])) % 100 for at in range(0, len(letters), 2)]


@pytest.fixture(scope="module")
def splits():
    graph = open_graph("kitchen").graph
    return [make_split(graph, SplitConfig(kind)) for kind in ("by-recipe", "by-goal")]


def tiny(seed=0):
    from transformers import LlamaConfig, LlamaForCausalLM

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return LlamaForCausalLM(
            LlamaConfig(
                vocab_size=100,
                hidden_size=16,
                intermediate_size=24,
                num_hidden_layers=2,
                num_attention_heads=2,
                num_key_value_heads=1,
                tie_word_embeddings=True,
                # Embeddings stay as they are: with the usual small ones no logit could be large.
                initializer_range=0.5,
            )
        )


def grown(splits):
    recipes = SCRIPT["learned"](splits, 5)
    return lambda rng: SCRIPT["trees"](splits, recipes, tokens, rng)


def test_the_learned_recipes_are_train_recipes_of_all_splits_and_not_left_out(splits):
    learned = set(map(tuple, SCRIPT["learned"](splits, 5).tolist()))
    assert len(learned) > 100
    for split in splits:
        assert learned <= set(map(tuple, split.recipes("train").tolist()))
        assert not learned & set(map(tuple, split.recipes("test").tolist()))
        assert not learned & set(map(tuple, make_folds(split, 5).recipes_of(0).tolist()))
    everything = set(map(tuple, SCRIPT["learned"](splits[:1], 0).tolist()))
    assert everything == set(map(tuple, splits[0].recipes("train").tolist()))


@pytest.mark.parametrize("kind", [0, 1])
def test_a_leaked_test_recipe_is_refused_by_name(splits, kind):
    leaked = splits[kind].recipes("test")[:1]
    recipes = np.concatenate([SCRIPT["learned"](splits, 5), leaked])
    goal = splits[0].graph.entities[leaked[0, 2]]
    with pytest.raises(ValueError, match=f"-> {goal}' is no train recipe of the by-"):
        SCRIPT["trees"](splits, recipes, tokens, np.random.default_rng(0))


@pytest.mark.parametrize(
    "track",
    [
        pytest.param("craft-1-lite", marks=pytest.mark.slow),
        pytest.param("craft-8-lite", marks=pytest.mark.slow),
        "goal-8-lite",
    ],
)
def test_no_recipe_that_solves_a_task_of_a_track_is_learned(track):
    """The splits of the built-in book are those of the tracks, and the tasks are not learned."""
    opened = open_track(track)
    graph = opened.opened.graph
    kinds = ("by-recipe", "by-goal")
    own = [make_split(open_graph("everyday").graph, SplitConfig(kind)) for kind in kinds]
    assert opened.opened.split.hash in {split.hash for split in own}
    learned = set(map(tuple, SCRIPT["learned"](own, 20).tolist()))
    asked = {
        tuple(graph.recipes[plan[-1]].tolist())
        for task in opened.frozen.tasks
        for plan in task.plans
    }
    assert len(asked) >= 100
    assert not asked & learned


@torch.no_grad()
def test_told_tokens_have_no_loss_and_weights_multiply_that_of_a_branch():
    model = tiny()
    tree = Tree([1, 2, 3], [[4, 5, 6], [4, 7], [8]], told=[2, 1, 0], weights=[2.0, -1.0, 0.5])
    total = 0.0
    for branch, told, weight in zip(tree.branches, tree.told, tree.weights, strict=True):
        text = [*tree.stem, *branch]
        rows = model(torch.tensor([text])).logits[0].log_softmax(-1)
        places = range(len(tree.stem) + told, len(text))
        total -= weight * sum(float(rows[place - 1, text[place]]) for place in places)
    assert float(SCRIPT["loss_of"](model, [tree])) == pytest.approx(total / 3, abs=1e-5)


def prompts(messages, is_asked):
    """Return tokens of messages, each with its role, as a chat template does."""
    text = "".join(f"<{message['role']}>{message['content']}" for message in messages)
    return list(map(ord, text + "<assistant>" * is_asked))


@pytest.fixture(scope="module")
def written(splits, tmp_path_factory):
    """Conversations of depths 1 and 2 on the default split's train tasks."""
    out = tmp_path_factory.mktemp("chats") / "sft.jsonl"
    line = ["chats", "kitchen", "--style", "text", "--depth", "1,2", "--out", str(out)]
    assert main([*line, "--quiet"]) == 0
    return out


def combined(row):
    return [text["content"].split(" + ") for text in row["messages"] if text["role"] == "assistant"]


def test_conversations_with_recipes_of_a_test_or_left_out_are_not_learned(splits, written):
    kept, left_out = SCRIPT["read_chats"](written, splits, 5)
    graph = splits[0].graph
    ids = {name: number for number, name in enumerate(graph.entities)}
    learned = set(map(tuple, SCRIPT["learned"](splits, 5).tolist()))
    assert len(kept) > 100
    assert len(left_out) > 20
    rows = [json.loads(line) for line in written.read_text().splitlines()]
    assert len(kept) + len(left_out) < len(rows)
    for row, is_learned in [*((row, True) for row in kept), *((row, False) for row in left_out)]:
        pairs = [tuple(sorted(ids[name] for name in pair)) for pair in combined(row)]
        used = {one for one in map(tuple, graph.recipes.tolist()) if one[:2] in pairs}
        assert (used <= learned) == is_learned
        for split in splits:
            assert used <= set(map(tuple, split.recipes("train").tolist()))


def test_each_answer_is_a_branch_behind_the_rules_and_counts_alone(splits, written):
    kept, _ = SCRIPT["read_chats"](written, splits, 5)
    few = [row for row in kept if row["depth"] == 2][:5] + kept[:20]
    grow = SCRIPT["chat_trees"](few, prompts, lambda text: list(map(ord, text)), 1, 2_000)
    trees = grow(np.random.default_rng(0))
    assert len(trees) > 2
    assert all(tree.size <= 2_000 for tree in trees)
    read = sorted(
        (tree.stem + branch[:told], branch[told:])
        for tree in trees
        for branch, told in zip(tree.branches, tree.told, strict=True)
    )
    expected = sorted(
        (prompts(row["messages"][:place], True), [*map(ord, row["messages"][place]["content"]), 1])
        for row in few
        for place in range(len(row["messages"]))
        if row["messages"][place]["role"] == "assistant"
    )
    assert len(expected) == 5 * 2 + 20
    assert read == expected


def test_a_conversation_of_a_test_task_is_refused_by_name(splits, written, put):
    split = splits[0]
    names = split.graph.entities
    tests = [set(map(tuple, one.recipes("test").tolist())) for one in splits]
    one, other, goal = min(tests[0] & tests[1])
    row = json.loads(written.read_text().splitlines()[0])
    answer = {"role": "assistant", "content": f"{names[other]} + {names[one]}"}
    leaked = put(
        json.dumps(row | {"messages": [*row["messages"][:2], answer]}) + "\n", "leaked.jsonl"
    )
    with pytest.raises(ValueError, match=f"{row['id']}' uses a recipe of '{names[goal]}'"):
        SCRIPT["read_chats"](leaked, splits, 5)
    leaked.write_text(json.dumps(row | {"part": "test"}) + "\n")
    with pytest.raises(ValueError, match=f"'{row['id']}' is of the part test"):
        SCRIPT["read_chats"](leaked, splits, 5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({}, "line 2 of '.*' is no game .* `chats --style text`"),
        ({"messages": None}, "line 1 of '.*' is no game"),
        ({"messages": [{"role": "assistant", "content": ""}]}, "line 1 of '.*' is no game"),
        (
            {"messages": [{"role": "assistant", "content": "water + moon dust"}]},
            "water \\+ moon dust",
        ),
    ],
    ids=["another line", "no messages", "tool call", "another book"],
)
def test_a_file_that_chats_by_text_did_not_write_is_refused(splits, written, put, changed, message):
    row = json.loads(written.read_text().splitlines()[0])
    other = put(json.dumps(row | changed) + "\n{}\n", "other.jsonl")
    with pytest.raises(ValueError, match=message):
        SCRIPT["read_chats"](other, splits, 5)


def test_training_in_two_parts_gives_the_same_bits(splits, tmp_path):
    whole, parts = tiny(), tiny()
    of = grown(splits)
    rows = list(SCRIPT["train"](whole, of, SMALL, tmp_path / "whole"))
    middle = len(rows) // 2
    begun = list(SCRIPT["train"](parts, of, SMALL, tmp_path / "parts", stop_after=middle))
    assert len(begun) == middle
    parts = tiny()
    # The rest is as before an interruption: also the steps after the last state run again.
    rest = list(SCRIPT["train"](parts, of, SMALL, tmp_path / "parts"))
    assert [row["loss"] for row in begun + rest] == [row["loss"] for row in rows]
    for name, value in whole.state_dict().items():
        assert torch.equal(value, parts.state_dict()[name]), name
