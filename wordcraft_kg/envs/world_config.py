"""Settings for the crafting environments."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from wordcraft_kg.base import (
    MAX_SIZE,
    ConfigError,
    UnknownSettingError,
    check_choices,
    nearest,
    require,
    whole,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.graphs.tasks import DRAWN_TASKS, MAX_DEPTH, TaskPart

MAX_ATTEMPTS = 1_000
"""Most attempts in an episode; each attempt adds free slots to every table."""
DistractorWeighting = Literal["use", "uniform"]
Observation = dict[str, Any]
Info = dict[str, Any]
METADATA: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 4}
"""The environments' metadata for gymnasium; ``ansi`` renders the state in words."""


def check_mode(mode: str | None) -> None:
    """Check a render mode, None or ``ansi``.

    Raises:
        ConfigError: for another mode.
    """
    if mode not in (None, "ansi"):
        raise ConfigError(f"`render_mode` {mode!r}: expected None or 'ansi'.")


@dataclass(frozen=True)
class RewardConfig:
    """Shaped rewards in addition to +1 for the goal.

    Attributes:
        wrong_pair_penalty: subtracted if an attempt makes nothing.
        irrelevant_penalty: subtracted if an attempt makes neither the goal nor an intermediate (an
            earlier product of a plan).
        intermediate_reward: added when an attempt first makes an intermediate.
    """

    wrong_pair_penalty: float = 0.0
    irrelevant_penalty: float = 0.0
    intermediate_reward: float = 0.0


RewardFunction = Callable[[Any, Any, Any], Any]
"""Rewards (N,) of a step, from the batched state before, the state after, and the
:class:`~wordcraft_kg.envs.batch.Step`, whose reward is 1 for the goal.
"""
REWARDS: Registry[RewardConfig | RewardFunction] = Registry(
    "wordcraft_kg.rewards",
    {"sparse": RewardConfig(), "official": RewardConfig(0.1, 0.1, 1.0)},
)
"""Rewards by name: presets, those of your own, and functions of plugins.

``official`` has the values in the paper's released code, with sub-goal rewards enabled.
"""


@dataclass(frozen=True)
class WordCraftConfig:
    """Settings for a crafting environment.

    Attributes:
        part: the part of the split with the tasks: ``train``, ``valid``, ``test``, or ``all``.
        depth: fewest attempts that solve a task, 1 to 5.
        num_distractors: entities on the table that no plan needs, beside the ``depth + 1``
            ingredients of the largest plan; 1, 2 and 8 in the paper. A task with fewer ingredients
            has more, so that all tables have the same size.
        max_attempts: attempts in an episode; None means ``depth``.
        reward: a name in :data:`REWARDS`: ``sparse``, ``official``, or that of a plugin's function.
        distractor_weighting: weights of entities for drawing distractors without replacement:
            ``use`` is 1 + the number of train recipes that use the entity as an ingredient,
            ``uniform`` is equal. By ``use``, entities with few uses are rarely distractors, so the
            player :func:`~wordcraft_kg.agents.players.fewest_uses` is better than chance.
        pays_held_out: whether held-out pairs make their results in the part ``train`` too, as in
            the paper's released code. Training is then paid for test recipes: for comparison only.
        num_tasks: number of tasks to sample at depth 3 and above, and at depth 2 in large graphs.
        task_seed: random seed for this sample; at depth 2 for the sample of tasks that use no
            entity twice, see :data:`~wordcraft_kg.graphs.tasks.TWICE_SHARE`.
        rewards: the shaped rewards that ``reward`` stands for; derived, not a setting.
        attempts: attempts in an episode; derived, not a setting.

    Raises:
        ConfigError: if a value is out of range, or ``max_attempts`` does not fit ``depth``.

    Example:
        >>> WordCraftConfig(depth=2, num_distractors=8).attempts
        2
    """

    part: TaskPart = "train"
    depth: int = 1
    num_distractors: int = 8
    max_attempts: int | None = None
    reward: str = "sparse"
    distractor_weighting: DistractorWeighting = "use"
    pays_held_out: bool = False
    num_tasks: int = DRAWN_TASKS
    task_seed: int = 0
    rewards: RewardConfig | RewardFunction = field(
        init=False,
        repr=False,
        compare=False,
    )
    attempts: int = field(
        init=False,
        repr=False,
        compare=False,
    )

    def __post_init__(self) -> None:
        self._whole("depth", 1, MAX_DEPTH)
        self._whole("num_distractors", 0, MAX_SIZE)
        if self.max_attempts is not None:
            self._whole("max_attempts", 1, MAX_ATTEMPTS)
            is_solvable = self.max_attempts >= self.depth
            expected = f"{self.depth} or more, which a task of depth {self.depth} takes"
            require(self, "max_attempts", is_solvable, expected)
        self._whole("num_tasks", 1, MAX_SIZE)
        self._whole("task_seed", 0, None)
        check_choices(self)
        REWARDS.check("reward", self.reward)
        # A frozen dataclass sets its derived fields by the way around.
        object.__setattr__(self, "rewards", REWARDS[self.reward])
        object.__setattr__(self, "attempts", self.max_attempts or self.depth)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "WordCraftConfig":
        """Create a configuration from keyword arguments.

        Raises:
            UnknownSettingError: for an unknown name, with the nearest known name.
            ConfigError: for a value out of range.
        """
        names = [entry.name for entry in fields(cls) if entry.init]
        for name in settings:
            if name not in names:
                raise UnknownSettingError(
                    f"unexpected keyword argument '{name}'; "
                    f"expected one of {', '.join(names)}.{nearest(name, names)}"
                )
        return cls(**settings)

    def variant(self, **changes: Any) -> "WordCraftConfig":
        """Return a copy with new values for the settings named in ``changes``.

        Raises:
            UnknownSettingError: for an unknown name.
            ConfigError: for a value out of range.
        """
        settings = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.init}
        return self.of(settings | changes)

    def _whole(
        self,
        name: str,
        low: int,
        high: int | None,
    ) -> None:
        """Check a whole number, and store it as an int: NumPy's numbers would not be saved."""
        object.__setattr__(self, name, whole(name, getattr(self, name), low, high))
