"""Train a language model by tool calls with TRL's GRPO on a GPU; vLLM generates if it is installed.

    pip install trl vllm
    python examples/grpo_on_gpu.py Qwen/Qwen3-0.6B --out reinforced

Depths are interleaved, so that a batch has easy and hard games. The reward of the goal comes from
the environment; the reward of the form (a call of the tool that the game accepts) is a function of
its own, with a small weight, and is logged beside it. A twentieth of the tasks is held out, and
played every ``--eval-steps`` steps. All tasks are of the part train.

examples/reinforce_language_model.py does the same without TRL, in half an hour on two cores.
"""

import argparse
import importlib.util
from typing import Any

from datasets import Dataset
from trl import GRPOConfig, GRPOTrainer

from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, crafting_rows, in_turn

HELD_OUT = 20


def form(environments: list[CraftingEnvironment], **_: Any) -> list[float]:
    """Return 1 for each game in which every call was accepted and one was made, else 0."""
    talks = [environment.talk for environment in environments]
    return [
        float(talk is not None and bool(talk.game.pairs) and not talk.invalid_actions)
        for talk in talks
    ]


def make_trainer(model: Any, options: argparse.Namespace, **more: Any) -> GRPOTrainer:
    """Return a trainer; ``more`` are further arguments of it, such as a tokenizer."""
    rows = in_turn(
        crafting_rows(
            options.graph,
            depth=options.depths,
            distractors=options.distractors,
            tasks=options.tasks,
            difficulty=options.difficulty and (options.difficulty[0], options.difficulty[1]),
        )
    )
    learned = [row for number, row in enumerate(rows) if number % HELD_OUT]
    config = GRPOConfig(
        output_dir=options.out,
        max_steps=options.steps,
        num_generations=options.answers,
        per_device_train_batch_size=options.answers,
        per_device_eval_batch_size=options.answers,
        max_completion_length=options.tokens,
        learning_rate=options.lr,
        # The environment's reward, 1 for the goal, has weight 1.
        reward_weights=[options.form],
        eval_strategy="steps",
        eval_steps=options.eval_steps,
        logging_steps=1,
        use_vllm=options.vllm,
        vllm_mode="colocate",
        use_cpu=options.cpu,
        report_to=[],
        seed=options.seed,
    )
    return GRPOTrainer(
        model=model,
        args=config,
        reward_funcs=[form],
        train_dataset=Dataset.from_list(learned),
        eval_dataset=Dataset.from_list(rows[::HELD_OUT]),
        environment_factory=CraftingEnvironment,
        **more,
    )


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description="Train a language model by tool calls with GRPO.")
    parser.add_argument("model", help="model folder, or a name on the hub")
    parser.add_argument("--graph", default="everyday", help="graph folder or book")
    parser.add_argument("--depths", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--distractors", type=int, default=8)
    parser.add_argument("--tasks", type=int, help="most tasks of each depth")
    parser.add_argument("--difficulty", type=float, nargs=2, help="of tasks, such as .2 .8")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--answers", type=int, default=8, help="rollouts of a game")
    parser.add_argument("--tokens", type=int, default=1024, help="most tokens of a rollout")
    parser.add_argument("--lr", type=float, default=1e-6)
    parser.add_argument("--form", type=float, default=0.1, help="weight of the reward of the form")
    parser.add_argument("--eval-steps", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cpu", action="store_true", help="without a GPU, for a try")
    parser.add_argument("--out", default="reinforced")
    options = parser.parse_args(arguments)
    options.vllm = not options.cpu and importlib.util.find_spec("vllm") is not None
    return options


if __name__ == "__main__":
    chosen = parse()
    trainer = make_trainer(chosen.model, chosen)
    trainer.train()
    trainer.save_model(chosen.out)
