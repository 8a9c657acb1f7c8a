"""Settings of an agent's training, with defaults, units and allowed ranges.

Imports no torch, so that commands show these settings in ``--help`` at once. The class docstrings
are the help texts, and defaults live here only.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import (
    MAX_SIZE,
    MAX_THREADS,
    SMALLEST,
    number_in,
    one_of,
    require,
    whole,
)
from wordcraft_kg.envs.world_config import (
    REWARDS,
    DistractorWeighting,
    WordCraftConfig,
)
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.sources import need_no_scorer
from wordcraft_kg.runs.config_file import RunConfig

_WHOLE_NUMBERS: Mapping[str, tuple[int, int | None]] = {
    "steps": (1, None),
    "batch_size": (1, MAX_SIZE),
    "unroll": (1, MAX_SIZE),
    "policy_lag": (0, MAX_SIZE),
    "tables": (0, MAX_SIZE),
    "seed": (0, None),
    "threads": (1, MAX_THREADS),
    "log_every": (1, None),
    "eval_every": (0, None),
    "checkpoint_every": (1, None),
}
"""Lowest and highest value of the trainer's whole numbers; None without a limit of its own."""
_LARGE = 1e9
_POSITIVE = (SMALLEST, _LARGE, f"a number above 0, at most {_LARGE:g}")
_COST = (0, _LARGE, f"0 or more, at most {_LARGE:g}")
_SHARE = (0, 1, "0 to 1")
_NUMBERS: Mapping[str, tuple[float, float, str]] = {
    "learning_rate": _POSITIVE,
    "rms_epsilon": _POSITIVE,
    "clip": _POSITIVE,
    "entropy_cost": _COST,
    "baseline_cost": _COST,
    "memory_cost": _COST,
    "scorer_cost": _COST,
    "discount": _SHARE,
    "rms_decay": _SHARE,
}
"""Lowest and highest value of the trainer's other numbers, and both in words."""
_LEFT_OPEN = ("batch_size", "unroll", "learning_rate", "tables", "scorer_cost")
"""Settings of the trainer that may be None."""
_WEIGHED_DEPTH = 2
"""Depth at which weights of plans help for certain, see docs/evidence/planning.md#plan-weights."""
Preset = Literal["recommended", "paper"]
"""Names of the presets of trainer and policy."""
RECOMMENDED: Mapping[str, Any] = {"batch_size": 512, "learning_rate": 0.008}
"""The recommended preset's values with one attempt."""
SEVERAL: Mapping[str, Any] = {"batch_size": 128, "learning_rate": 0.005}
"""Those with several attempts, where an update has more steps of each environment."""
MEMORY = 1.0
"""The recommended preset's weight of the memory."""
PAPER: Mapping[str, Any] = {
    "policy": "attention",
    "memory_cost": 0.0,
    "batch_size": 128,
    "unroll": 2,
    "learning_rate": 0.001,
    "sees_attempts": False,
    "scale": "ranks",
    "mixing": "free",
    "weigh_plans": False,
    "tables": 0,
}
"""Settings that the two presets do not share, and the paper's preset's values.

The scale is no setting in the paper: it is that of our reproduction, see
``docs/explanation/decisions.md``.
"""


@dataclass(frozen=True)
class TaskConfig:
    """Settings for training and evaluation tasks.

    Attributes:
        depth: minimum attempts to solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        max_attempts: attempts per episode. Default: depth.
        reward: sparse (1 for the goal), official (with the penalties and sub-goals in the paper's
            released code), or a plugin's; success counts only goals in all cases.
        distractor_weighting: sample distractors by use (weight 1 + number of train recipes that
            use the entity as an ingredient) or uniform.
        pays_held_out: let held-out pairs make their results in training too, as the paper's
            released code does. Such an agent is paid for test recipes: for comparison only.

    Raises:
        ConfigError: for a value out of range.

    Example:
        >>> TaskConfig(depth=2, distractors=4).environment("test").part
        'test'
    """

    depth: int = WordCraftConfig.depth
    distractors: int = WordCraftConfig.num_distractors
    max_attempts: int | None = None
    reward: str = "sparse"
    distractor_weighting: DistractorWeighting = WordCraftConfig.distractor_weighting
    pays_held_out: bool = False

    def __post_init__(self) -> None:
        self.environment("train")  # checks all values

    @property
    def episode(self) -> int:
        """Actions in the longest episode: two for each attempt."""
        return 2 * (self.max_attempts or self.depth)

    def environment(self, part: TaskPart, distractors: int | None = None) -> WordCraftConfig:
        """Return the environment settings for a part of the split.

        Args:
            part: part of the split, or ``all``.
            distractors: number of distractors instead of this object's; None for this object's.

        Raises:
            ConfigError: for a value out of range.
        """
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        num_distractors = settings.pop("distractors")
        amount = num_distractors if distractors is None else distractors
        return WordCraftConfig(
            part=part,
            num_distractors=amount,
            **settings,
        )


@dataclass(frozen=True)
class ImpalaConfig:
    """IMPALA, with recommended settings or the paper's.

    Attributes:
        preset: recommended (chosen on validation tasks), or paper for the paper's values in every
            setting that is not given.
        steps: environment steps (actions) for training, rounded up to whole updates; 3,000,000 in
            the paper.
        batch_size: parallel environments, each with one unroll per update. Default: 512, or 128
            with several attempts; 128 in the paper.
        unroll: steps per environment and update. Default: an episode's actions (two for each
            attempt); 2 in the paper.
        policy_lag: delay between acting and learning policy, in updates; 0 makes all importance
            ratios 1.
        discount: γ; 0.99 in the paper.
        learning_rate: initial RMSProp learning rate, decayed linearly to 0. Default: 0.008, or
            0.005 with several attempts; 0.001 in the paper.
        rms_decay: RMSProp decay rate for squared gradients; 0.99 in the paper's released code.
        rms_epsilon: RMSProp ε; 0.01 in the paper.
        entropy_cost: entropy weight; 0.01 in the paper.
        baseline_cost: value loss weight; 0.5 in the paper's released code.
        memory_cost: weight of the loss on a memory of own successes: whenever a pair that led to a
            goal is on the goal's table again, its probability is raised (self-imitation); 0 for no
            memory. Default: 1; 0 in the paper.
        scorer_cost: weight of the divergence from the softmax of w, the policy of the scorer alone,
            which limits attention that remembers train tasks; only with w, and at depth 1, where w
            is the probability of success. Default: 1 (attention: 0.3), or 3 with fewer than
            1,000 train tasks.
        clip: maximum gradient norm; 40 in the paper's released code.
        tables: number of different first tables, which are played again and again, so that a recipe
            scorer scores them once; 0 for a new table in each episode. Default: 32,768 with w or p,
            otherwise 0.
        seed: root seed for initialisation, environments and actions.
        device: torch device for environments, actor and learner: cpu or cuda.
        threads: CPU threads, with a recipe scorer those of its loops. Without one, 2 are about as
            fast as 1, because the matrices are small.
        log_every: environment steps between two lines in metrics.jsonl.
        eval_every: environment steps between two points on the learning curves; 0 evaluates only
            after training.
        checkpoint_every: environment steps between two checkpoints.

    Raises:
        ConfigError: for a value out of range.

    Example:
        >>> ImpalaConfig(steps=1_000, preset="paper").updates
        4
        >>> ImpalaConfig(steps=1_000).for_episodes(4).updates
        2
    """

    preset: Preset = "recommended"
    steps: int = 3_000_000
    batch_size: int | None = None
    unroll: int | None = None
    policy_lag: int = 0
    discount: float = 0.99
    learning_rate: float | None = None
    rms_decay: float = 0.99
    rms_epsilon: float = 0.01
    entropy_cost: float = 0.01
    baseline_cost: float = 0.5
    memory_cost: float | None = None
    scorer_cost: float | None = None
    clip: float = 40.0
    tables: int | None = None
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    log_every: int = 10_000
    eval_every: int = 100_000
    checkpoint_every: int = 100_000

    def __post_init__(self) -> None:
        one_of("preset", self.preset, get_args(Preset))
        values = PAPER if self.preset == "paper" else {"memory_cost": MEMORY}
        for name in ("batch_size", "learning_rate", "unroll", "tables", "memory_cost"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, values.get(name))
        # What is left open gets its value from the tasks, their number or the sources.
        is_open = {name for name in _LEFT_OPEN if getattr(self, name) is None}
        for name, limits in _WHOLE_NUMBERS.items():
            if name not in is_open:
                whole(name, getattr(self, name), *limits)
        for name, bounds in _NUMBERS.items():
            if name not in is_open:
                number_in(name, getattr(self, name), *bounds)
        # Whether the device exists is checked when training begins, not when settings are read.
        # A name such as cuda:1 chooses among several devices.
        is_text = isinstance(self.device, str)
        is_known = is_text and (self.device == "cpu" or self.device.startswith("cuda"))
        require(self, "device", is_known, "cpu or cuda")

    def for_episodes(self, actions: int) -> "ImpalaConfig":
        """Return the settings with values for episodes with so many actions where these were open.

        In an unroll shorter than an episode, actions before the last attempt learn from the value
        alone.

        Raises:
            ConfigError: if ``unroll`` is open and ``actions`` is out of range.
        """
        values = {"unroll": actions, **(RECOMMENDED if actions <= 2 else SEVERAL)}
        is_open = {name: value for name, value in values.items() if getattr(self, name) is None}
        return replace(self, **is_open)

    @staticmethod
    def has_scorer_cost(sources: Collection[str], depth: int) -> bool:
        """Return whether agents with these sources and tasks of this depth have the penalty.

        Deeper tasks have none: there w says nothing about later attempts.
        """
        return "w" in sources and depth == 1

    @property
    def unroll_steps(self) -> int:
        """Steps per environment and update; those of one attempt while they are open."""
        return self.unroll or 2

    @property
    def first_rate(self) -> float:
        """The initial learning rate; that of one attempt while it is open."""
        return self.learning_rate or float(RECOMMENDED["learning_rate"])

    @property
    def num_envs(self) -> int:
        """The number of parallel environments; that of one attempt while it is open."""
        return self.batch_size or int(RECOMMENDED["batch_size"])

    @property
    def steps_per_update(self) -> int:
        """Environment steps per update, in all environments together."""
        return self.num_envs * self.unroll_steps

    @property
    def updates(self) -> int:
        """Number of updates in the whole training."""
        # Rounded up, by whole numbers, which are exact at any size.
        return (self.steps + self.steps_per_update - 1) // self.steps_per_update


TABLES = 2**15
"""Tables of a training with scores of slot pairs.

On everyday, by recipe, 8 distractors, 200,000 steps with 8,192 tables and with new ones end at the
same success, .807; scoring a table takes as long as some ten steps of an agent without scores.
"""
TABLES_OF_SETS = 2**13
"""The same for sets, whose search takes about 20 CPU milliseconds a table."""
KNOWLEDGE_SETTINGS = (
    "use",
    "kg_only",
    "weigh_plans",
    "mixing",
    "scale",
    "self_edges",
    "in_sample",
)
"""Names of the policy settings that only have an effect with a scorer."""


@dataclass(frozen=True)
class AgentConfig(RunConfig):
    """All settings for training an agent, as ``config.toml`` keeps them.

    Settings of the policy and the trainer that are left open get their values here, from the
    preset and the tasks. For other tasks, begin with a new policy and trainer.

    Attributes:
        graph: graph folder, recipe book's file or built-in book's name.
        commands: names of the commands that write such a run.
        scorer: model folder, or None.
        tasks: training and evaluation tasks.
        policy: network and knowledge sources.
        trainer: optimisation and logging.

    Raises:
        ConfigError: for a setting that needs a scorer, and no scorer.

    Example:
        >>> AgentConfig("kitchen", "models/kitchen", TaskConfig(distractors=2)).differing()
        {'graph': 'kitchen', 'scorer': 'models/kitchen', 'distractors': 2}
    """

    commands: ClassVar[tuple[str, ...]] = ("train-agent",)

    scorer: str | None = None
    tasks: TaskConfig = TaskConfig()
    policy: PolicyConfig = PolicyConfig()  # noqa: RUF009 - frozen
    trainer: ImpalaConfig = ImpalaConfig()

    def __post_init__(self) -> None:
        trainer = self.trainer.for_episodes(self.tasks.episode)
        has_pair_scores = not {"w", "p"}.isdisjoint(self.policy.sources)
        if trainer.tables is None:
            trainer = replace(trainer, tables=TABLES if has_pair_scores else 0)
        is_recommended = trainer.preset == "recommended"
        # Settings that only attention has.
        has_attention = self.policy.kg_only or self.policy.mixing in ("free", "softmax")
        is_pairs = is_recommended and not has_attention
        kind = self.policy.policy or ("pairs" if is_pairs else "attention")
        # In a single attempt, the number of attempts left is constant.
        sees = is_recommended and kind in ("pairs", "attention") and self.tasks.episode > 2
        has_scorer = self.scorer is not None or need_no_scorer(self.policy.sources)
        # Measured with u and v in a single attempt; w has a penalty instead, and with p an agent
        # starts as its planner, without attention.
        is_single = self.tasks.episode == 2
        # Measured with as many attempts as a plan needs: then a failed attempt ends all plans.
        is_tight = self.tasks.episode <= 2 * self.tasks.depth
        weighs = is_recommended and has_scorer and is_tight and "p" in self.policy.sources
        is_residual = is_recommended and has_scorer and is_single and not has_pair_scores
        policy = self.policy.closed(
            policy=kind,
            sees_attempts=sees,
            has_scorer=has_scorer,
            mixing="residual" if is_residual else "free",
            weigh_plans=weighs and self.tasks.depth == _WEIGHED_DEPTH,
        )
        # A run's file has all values, so that another version with other presets repeats the run.
        object.__setattr__(self, "trainer", trainer)
        object.__setattr__(self, "policy", policy)
        if has_scorer:
            return
        default = PolicyConfig(kind).closed(has_scorer=False)
        for name in KNOWLEDGE_SETTINGS:
            if getattr(policy, name) != getattr(default, name):
                raise ConfigError(f"`{name}` configures the use of a scorer: give a `scorer` too.")

    def for_sets(self, most_ingredients: int) -> "AgentConfig":
        """Return the settings for recipes of up to so many ingredients.

        A policy of pairs becomes attention, and an unroll that was left open as long as the longest
        episode, with the batches and the rate of several attempts.
        """
        # The weights of plans are those of pairs.
        policy = replace(self.policy, weigh_plans=False)
        if policy.policy == "pairs":
            # Without a scorer, nothing is mixed: the value that attention has then.
            mixing = policy.mixing if self.scorer else "free"
            policy = replace(policy, policy="attention", mixing=mixing)
        actions = self.tasks.episode // 2 * most_ingredients
        defaults = {"unroll": self.tasks.episode, "tables": TABLES, **RECOMMENDED}
        values = {"unroll": actions, "tables": TABLES_OF_SETS, **SEVERAL}
        trainer = self.trainer
        if trainer.preset == "recommended":
            is_open = {name for name in values if getattr(trainer, name) == defaults[name]}
            trainer = replace(trainer, **{name: values[name] for name in sorted(is_open)})
        return replace(self, policy=policy, trainer=trainer)

    @property
    def plugins(self) -> dict[str, str]:
        """Hashes of the plugin files that the agent needs, by file name."""
        return self.policy.plugins | REWARDS.plugins(self.tasks.reward)

    def check_preset(self) -> None:
        """Check that the settings are the preset's, for a preset that is to be kept to the letter.

        Raises:
            ConfigError: for the preset paper and a setting with another value.
        """
        if self.trainer.preset != "paper":
            return
        values = self.values()
        for name, expected in PAPER.items():
            # The paper has an mlp, too.
            if values[name] not in (expected, "mlp"):
                raise ConfigError(
                    f"`{name}` {values[name]!r} contradicts `preset` paper, where it is "
                    f"{expected!r}. Leave out `{name}`, or leave out `preset` and set each value."
                )

    def default_folder(self, graph_name: str) -> Path:  # noqa: D102 - inherited
        guide = Path(self.scorer).name if self.scorer else "no-kg"
        return Path("runs") / f"{graph_name}-{guide}"

    def differing(self) -> dict[str, Any]:
        """Return the settings that differ from the defaults and the preset's values, by name."""
        default = AgentConfig("").values()
        # Values that follow from others, as they would be if none of them were given.
        preset = ImpalaConfig(preset=self.trainer.preset)
        policy = PolicyConfig(self.policy.policy, use=self.policy.use)
        followed = AgentConfig("", self.scorer, self.tasks, policy, preset).values()
        default |= {name: followed[name] for name in PAPER}
        default["policy"] = AgentConfig("", trainer=preset).policy.policy
        values = self.values()
        return {name: value for name, value in values.items() if default.get(name) != value}
