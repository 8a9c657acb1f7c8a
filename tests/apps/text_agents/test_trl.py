"""The environment and data set for TRL, by what TRL 1.16 asks of them."""

import json
from pathlib import Path

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env
from msgspec.structs import replace

from tests.apps.text_agents.scripted import plan_pairs
from wordcraft_kg.apps.text_agents.plays import open_play
from wordcraft_kg.apps.text_agents.results import record_of
from wordcraft_kg.apps.text_agents.text_env import LONGEST_ACTION, TextEnv
from wordcraft_kg.apps.text_agents.trl import (
    CraftingEnvironment,
    TableEnvironment,
    crafting_dataset,
    crafting_rows,
)
from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError


def rows_of(**settings):
    return crafting_rows("kitchen", **{"part": "all", "distractors": 2, **settings})


def play(environment, row, pairs):
    environment.reset(**row)
    return [environment.combine(*pair) for pair in pairs]


def begun(row, environment=None):
    environment = environment or CraftingEnvironment()
    environment.reset(**row)
    return environment


def record_in(environment):
    environment.talk.game.end()
    return replace(record_of(environment.talk), messages=())


@pytest.mark.parametrize("depth", [1, 2])
def test_the_pairs_of_a_plan_earn_the_reward(depth):
    for row in rows_of(depth=depth, tasks=20):
        environment = begun(row)
        *_, last = play(environment, row, plan_pairs(environment.talk.game))
        assert environment.get_reward() == 1
        assert "You made" in last
        assert record_in(environment).success


def test_all_rollouts_of_a_row_play_the_same_game():
    rows = rows_of(depth=[1, 2], distractors=[1, 8], tables=2, tasks=2)
    assert len(rows) == len({row["task_id"] for row in rows}) == 2 * 2 * 2 * 2
    pooled = CraftingEnvironment()
    for row in rows + rows[::-1]:
        alone = record_in(begun(row))
        assert record_in(begun(row, pooled)) == alone
        assert len(alone.table) >= row["distractors"] + 1
    # Other tables of a task have other distractors.
    first, second = (
        record_in(begun(row)).table for row in rows_of(depth=1, distractors=8, tables=2)[:2]
    )
    assert first != second


def test_a_game_is_replayed_to_the_byte_from_its_row_and_pairs():
    games = open_play("kitchen", "all", 2, 2, distractor_seeds=3)
    for row in rows_of(depth=2, tables=3, tasks=4):
        environment = begun(row)
        play(environment, row, [("1", "2"), *plan_pairs(environment.talk.game)])
        record = record_in(environment)
        again = games.begin(row["task"], row["distractor_seed"])
        for pair in record.pairs:
            again.combine(*pair)
        assert (again.game.pairs, again.game.is_made) == ([*record.pairs], record.success)
        assert again.game.start == record.table


def test_invalid_calls_are_counted_and_end_the_game_at_last():
    environment = begun(rows_of(depth=1)[0])
    for call in range(4):
        reply = environment.combine("no such item", "x" * 10_000_000)
        assert len(reply) < 1_000
        assert environment.talk.is_over == (call == 3)
    assert environment.talk.invalid_actions == 4
    before = record_in(environment)
    assert environment.combine("1", "2").startswith("This game is over.")
    assert record_in(environment) == before
    assert environment.get_reward() == 0


def test_the_tool_table_shows_the_state_and_takes_no_attempt():
    environment = begun(rows_of(depth=2)[0], TableEnvironment())
    for _ in range(5):
        assert environment.table() == environment.talk.game.state
    assert environment.talk.game.attempts_left == 2
    first, *_ = plan_pairs(environment.talk.game)
    made = environment.combine(*first)
    assert made.endswith(environment.table())
    environment.combine("1", "1")
    assert environment.table().startswith("This game is over.")
    assert "table" not in dir(CraftingEnvironment)


def test_a_row_of_another_split_or_a_changed_row_is_refused_by_name():
    row = rows_of(part="train", depth=1)[0]
    for changes, says in (
        ({"split_hash": "0" * 64}, "another split of 'kitchen'"),
        ({"goal": "unicorn"}, "the row's goal is 'unicorn'"),
        ({"task": None}, "no column 'task'"),
        ({"task_id": "kitchen-test-1-2-0-0"}, "task_id is 'kitchen-test-1-2-0-0'"),
        ({"part": "test"}, "task_id is 'kitchen-train-1-2-0-0'|the row's goal is"),
        ({"task": 10**9}, "task"),
        ({"depth": 99}, "depth"),
        ({"reward": "large"}, "reward"),
    ):
        with pytest.raises(ConfigError, match=says):
            CraftingEnvironment().reset(**{**row, **changes})
    with pytest.raises(EpisodeError, match="call reset"):
        CraftingEnvironment().combine("1", "2")


def test_the_prompt_is_complete_and_reset_adds_nothing_to_it():
    row = rows_of(depth=1)[0]
    environment = CraftingEnvironment()
    assert environment.reset(**row) is None
    prompt = row.pop("prompt")[0]["content"]
    assert environment.reset(**row) == prompt
    assert environment.talk.game.state in prompt


def made(**settings):
    settings = {"graph": "kitchen", "num_distractors": 2, **settings}
    return gym.make("WordCraft-Text-v0", **settings)


@pytest.mark.parametrize("settings", [{}, {"depth": 2}])
def test_gymnasium_accepts_it(settings):
    check_env(made(**settings).unwrapped)


def test_a_plan_in_words_earns_the_reward():
    env = made(depth=2)
    for seed in range(10):
        env.reset(seed=seed)
        *_, last = [
            env.step(f"We need it.\n{one} + {other}")
            for one, other in plan_pairs(env.unwrapped.talk.game)
        ]
        reply, reward, terminated, truncated, info = last
        assert reply.endswith(f"You made the goal: {info['goal']}.")
        assert (reward, terminated, truncated, info["is_success"]) == (1, True, False, True)
        with pytest.raises(EpisodeError):
            env.unwrapped.step("1 + 2")


def test_a_chosen_game_is_that_of_other_interfaces():
    env = made(part="test")
    shown, info = env.reset(options={"task": 3, "distractor_seed": 7})
    assert shown == open_play("kitchen", "test", 1, 2, None).begin(3, 7).opening
    assert (info["task"], info["distractor_seed"]) == (3, 7)


def test_actions_of_any_length_and_in_any_script_are_part_of_the_game():
    env = made()
    env.reset(seed=0)
    for action in ("", "Ω" * 10_000_000, "\ud800 + \x00", "word " * LONGEST_ACTION):
        reply, reward, _, _, info = env.step(action)
        assert reply in env.observation_space
        assert (reward, reply.startswith("Invalid answer")) == (0, True)
    assert info["invalid_actions"] == 4


@pytest.mark.parametrize(
    ("use", "error", "says"),
    [
        (lambda env: env.step("1 + 2"), EpisodeError, "call reset"),
        (lambda env: env.reset(options={"table": []}), ConfigError, "unknown reset option 'table'"),
        (lambda env: env.reset(options={"task": 10**9}), ConfigError, "task"),
        (lambda env: [env.reset(seed=0), env.step(3)], ActionError, "expected a text"),
        (
            lambda _: TextEnv("kitchen", knowledge="scorer"),
            ConfigError,
            "or none or partial without",
        ),
    ],
)
def test_mistakes_are_refused(use, error, says):
    env = TextEnv("kitchen", num_distractors=2)
    with pytest.raises(error, match=says):
        use(env)


SPECIAL = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<tool_call>", "</tool_call>"]


@pytest.fixture(scope="module")
def trl():
    return pytest.importorskip("trl", minversion="1.16", reason="the extra trl is not installed")


@pytest.fixture(scope="module")
def tokenizer(trl):
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
def trainer(trl, tokenizer, tmp_path, monkeypatch):
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


@pytest.mark.slow
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


@pytest.mark.slow
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
