"""Crafting games as an environment of verifiers: tasks, a game that is the user, and rewards.

A model answers in text; each answer is an attempt, and the game's reply is the next message. The
reward is 1 for the goal. The reward of the form, of answers that the game reads, stands beside it.
"""

from typing import Any

import verifiers.v1 as vf

from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, crafting_rows, in_turn

__all__ = ["CraftingEnv", "CraftingTaskset", "load_environment"]


class CraftingConfig(vf.TasksetConfig):
    """The games: as the arguments of ``crafting_rows``."""

    graph: str = "everyday"
    """Graph folder, recipe book file, or name of a built-in book."""
    part: str = "train"
    """Tasks of the split: train, valid or test. Train on train, and report test."""
    depth: tuple[int, ...] = (1,)
    """Depths of tasks, 1 to 5; the games of several depths come in turn."""
    distractors: int = 8
    """Entities on the table that no plan needs."""
    attempts: int | None = None
    """Attempts in a game; None for the depth."""
    tables: int = 1
    """Tables for each task, with other distractors."""
    tasks: int | None = None
    """Most tasks of each depth, evenly spaced; None for all."""
    difficulty: tuple[float, float] | None = None
    """Least and largest measured difficulty of the tasks, such as (.2, .8); None for all."""


class CraftingData(vf.TaskData):
    """A game: its row says everything that it depends on."""

    row: dict[str, Any]


class CraftingTask(vf.Task[CraftingData, vf.State, vf.TaskConfig]):
    """A game, which its name identifies."""

    @property
    def key(self) -> str:
        """The game's name, such as everyday-train-1-8-17-0."""
        return str(self.data.name)


class CraftingTaskset(vf.Taskset[CraftingTask, CraftingConfig]):
    """The games of a part of a split."""

    def load(self) -> list[CraftingTask]:
        """Return a task for each game, with rules and state as its prompt."""
        names = ("part", "depth", "distractors", "attempts", "tables", "tasks", "difficulty")
        settings = {name: getattr(self.config, name) for name in names}
        tasks = []
        for row in in_turn(crafting_rows(self.config.graph, **settings)):
            # Answers are texts here, so the rules name no tool.
            game = {name: value for name, value in row.items() if name != "prompt"}
            data = CraftingData(name=row["task_id"], prompt=_begun(game).talk.opening, row=game)
            tasks.append(CraftingTask(data, self.config.task))
        return tasks


class CraftingEnvConfig(vf.EnvConfig):
    """The player, and the weight of the form."""

    # A loop of chat, on this machine: the games need no sandbox.
    player: vf.AgentConfig = vf.AgentConfig(
        harness=vf.HarnessConfig(id="null"), runtime=vf.SubprocessConfig()
    )
    form: float = 0.1
    """Weight of the reward of the form; 0 leaves only the goal's."""


class CraftingEnv(vf.Env[CraftingEnvConfig]):
    """A conversation with a game, until its end or the player's."""

    async def run(self, task: CraftingTask, agents: Any) -> None:
        """Play a game, and record its rewards."""
        game = _begun(task.data.row)
        talk = game.talk
        async with agents.player.interaction(task) as interaction:
            # The opening is the prompt, so the player speaks first.
            segment = await interaction.turn()
            while not segment.terminated:
                reply = talk.hear(segment.last_reply)
                if talk.is_over:
                    break
                segment = await interaction.turn(reply)
        trace = interaction.trace
        form = float(bool(talk.game.pairs) and not talk.invalid_actions)
        trace.record_reward("goal", game.get_reward(), 1.0)
        trace.record_reward("form", form, self.config.form)


def load_environment(**settings: Any) -> vf.Env:
    """Return the environment; ``settings`` are fields of :class:`CraftingConfig`, and ``form``."""
    form = settings.pop("form", CraftingEnvConfig.model_fields["form"].default)
    taskset = {"id": __name__, **settings}
    return vf.load_environment(vf.resolve_env_config({"taskset": taskset, "form": form}))


def _begun(row: dict[str, Any]) -> CraftingEnvironment:
    game = CraftingEnvironment()
    game.reset(**row)
    return game
