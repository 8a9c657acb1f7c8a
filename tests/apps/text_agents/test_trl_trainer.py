"""TRL's own trainer plays and rewards our games.

A tiny model has random weights, or scripted answers.
"""

import json
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, crafting_dataset, crafting_rows

trl = pytest.importorskip("trl", minversion="1.16", reason="the extra trl is not installed")
pytestmark = pytest.mark.slow
SPECIAL = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<tool_call>", "</tool_call>"]


@pytest.fixture(scope="module")
def tokenizer():
    return byte_tokenizer()


def byte_tokenizer():
    """Bytes as tokens: nothing is downloaded."""
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast
    from trl.chat_template_utils import qwen3_chat_template

    tokens = [*SPECIAL, *sorted(pre_tokenizers.ByteLevel.alphabet())]
    numbers = {token: number for number, token in enumerate(tokens)}
    made = Tokenizer(models.BPE(vocab=numbers, merges=[]))
    made.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    made.decoder = decoders.ByteLevel()
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=made, eos_token="<|im_end|>", pad_token="<|endoftext|>"
    )
    tokenizer.add_special_tokens({"additional_special_tokens": SPECIAL[1:]})
    tokenizer.chat_template = qwen3_chat_template
    return tokenizer


def tiny_model(tokenizer):
    """A model with random weights."""
    from transformers import Qwen3Config, Qwen3ForCausalLM

    size = {"hidden_size": 16, "intermediate_size": 16, "head_dim": 8}
    heads = {"num_hidden_layers": 1, "num_attention_heads": 2, "num_key_value_heads": 1}
    return Qwen3ForCausalLM(Qwen3Config(vocab_size=len(tokenizer), **size, **heads))


@pytest.fixture
def trainer(tokenizer, tmp_path, monkeypatch):
    monkeypatch.setenv("TRL_EXPERIMENTAL_SILENCE", "1")
    model = tiny_model(tokenizer)
    settings = {
        **{"per_device_train_batch_size": 2, "num_generations": 2, "max_steps": 1},
        **{"max_completion_length": 1_000, "report_to": [], "use_cpu": True, "logging_steps": 1},
    }
    return trl.GRPOTrainer(
        model=model,
        args=trl.GRPOConfig(output_dir=str(tmp_path), **settings),
        train_dataset=crafting_dataset("kitchen", distractors=2, tasks=1),
        processing_class=tokenizer,
        environment_factory=CraftingEnvironment,
    )


def test_a_trainer_calls_the_tool_and_takes_the_reward(trainer, tokenizer, monkeypatch):
    """The two rollouts of a group: one combines the right pair, the other calls nothing."""
    environment = CraftingEnvironment()
    environment.reset(**crafting_rows("kitchen", distractors=2, tasks=1)[0])
    game = environment.talk.game
    first, second = game.graph.labels(game.graph.recipes[game.tasks.plans[0][0][-1], :2].tolist())
    call = json.dumps({"name": "combine", "arguments": {"first": first, "second": second}})
    scripts = [f"<tool_call>\n{call}\n</tool_call><|im_end|>", "I do not know.<|im_end|>"]
    asked = []

    def answers(prompt_ids, *_, **__):
        asked.append([tokenizer.decode(ids) for ids in prompt_ids])
        texts = scripts if len(asked) == 1 else ["Done.<|im_end|>"] * len(prompt_ids)
        return [tokenizer(text)["input_ids"] for text in texts], None

    monkeypatch.setattr(trainer, "_generate_single_turn", answers)
    trainer.train()
    logged = trainer.state.log_history[0]
    assert logged["rewards/CraftingEnvironment/mean"] == 0.5
    assert logged["tools/failure_frequency"] == 0
    prompts, after_the_call = asked[0], asked[1]
    assert prompts[0] == prompts[1]  # one game for the group
    assert f"Goal: {game.goal}" in prompts[0]
    assert '"name": "combine"' in prompts[0]
    assert len(after_the_call) == 1
    assert f"You made the goal: {game.goal}" in after_the_call[0]


def test_the_example_trains_with_two_rewards_and_games_that_are_held_out(
    tokenizer, tmp_path, monkeypatch
):
    monkeypatch.setenv("TRL_EXPERIMENTAL_SILENCE", "1")
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples"))
    import grpo_on_gpu

    words = "tiny --graph kitchen --distractors 2 --tasks 12 --steps 1 --answers 2 --tokens 30"
    options = grpo_on_gpu.parse([*words.split(), "--eval-steps", "1", "--cpu", "--out", "here"])
    options.out = str(tmp_path)
    trainer = grpo_on_gpu.make_trainer(tiny_model(tokenizer), options, processing_class=tokenizer)
    assert [row["depth"] for row in trainer.train_dataset][:4] == [2, 1, 2, 1]
    trainer.train()
    logged = {name for entry in trainer.state.log_history for name in entry}
    assert {"rewards/form/mean", "rewards/CraftingEnvironment/mean"} <= logged
    assert "eval_rewards/CraftingEnvironment/mean" in logged
