"""Training an agent into a run folder.

:class:`AgentTraining` surrounds the trainer (:mod:`~wordcraft_kg.agents.impala`) with everything
that a run needs: inputs and their checks, learning curves, checkpoints, the final evaluation, the
model card. Read :meth:`AgentTraining.prepare`, :meth:`AgentTraining.fit` and ``_finish``, in this
order.

Checkpoints hold the complete trainer state, so that on a CPU an interrupted and continued run ends
with the same bits as an uninterrupted run.
"""

import logging
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from wordcraft_kg.agents.agent_config import AgentConfig
from wordcraft_kg.agents.agent_folder import AGENTS, INPUTS, METRICS_FILE, policy_at
from wordcraft_kg.agents.agent_records import (
    EPISODES_FILE,
    TERMINATION_REASONS,
    AgentProgress,
    AgentSummary,
    PlayedTask,
    read_summary,
)
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.plan_weights import fit_plan_weights
from wordcraft_kg.base import (
    ArtefactError,
    TaskError,
    as_values,
    check_memory,
    dump_json,
    json_text,
    write_atomically,
)
from wordcraft_kg.base.tensors import check_device, torch_threads
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.draws import MOST_TASKS
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import SPLITS, OpenedGraph, RecipeGraph, TaskPart
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.policies.policy_folder import (
    make_policy,
    usage,
    write_constants,
    write_parameters,
)
from wordcraft_kg.models.policies.sources import need_no_scorer
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.scorer_folder import FOLDS_TENSORS, MODEL, WEIGHTS
from wordcraft_kg.planning.source import BestPlan, P
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.record import RunFiles, RunRecord, front_matter, read_finished_run
from wordcraft_kg.runs.run_folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.trackers import Log, Tracker
from wordcraft_kg.runs.training import Training, train

OUTPUTS = (
    "policy.safetensors",
    "policy.json",
    "constants.safetensors",
    "evaluation.json",
    METRICS_FILE,
)
"""Files in a run folder that the end of training adds or completes; ``run.json`` hashes them."""
# Minimum share of pairs of an entity with itself for a warning about self edges.
_MANY_SELF_PAIRS = 0.25


@dataclass(frozen=True)
class TrainedAgent:
    """The result of an agent's training.

    Attributes:
        folder: run folder.
        summary: final evaluation.
    """

    folder: Path
    summary: AgentSummary


def train_agent(
    config: AgentConfig,
    out: str | Path | None = None,
    *,
    force: bool = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Progress | bool | None = None,
) -> TrainedAgent:
    """Train an agent into a run folder, or continue an interrupted run with the same settings.

    Args:
        config: all settings.
        out: run folder. Default: ``runs/<graph name>-<scorer folder or no-kg>``.
        force: train anew and replace the folder.
        trackers: places to which the lines of metrics go too, by name (tensorboard)
            or as objects.
        progress: called after each line of metrics; True shows a bar, None or False nothing.

    Returns:
        The run folder and the final evaluation.

    Raises:
        OutputExistsError: if the folder holds other files or a finished run, and ``force`` is
            False.
        ConfigError: if a setting contradicts the preset, an unfinished run has other settings or
            data, or the settings do not fit the graph or machine.
        MissingExtraError: if a tracker's library is not installed.
        GraphMismatchError: if the scorer belongs to another graph or split.
        ArtefactError: if the scorer, a graph folder or an interrupted run is damaged, or another
            process is training in the folder.
        TrainingError: if the loss becomes infinite or not a number.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        TaskError: if the split has no train tasks for these settings.
        LeakError: if a model of the scorer has seen all recipes of a train task's plan.
        KeyboardInterrupt: after Ctrl-C; the same call continues the run.

    Example:
        >>> trainer = ImpalaConfig(steps=1_024, eval_every=0)
        >>> config = AgentConfig("kitchen", "models/kitchen", trainer=trainer)
        >>> trained = train_agent(config, "runs/kitchen")
        >>> trained.summary.steps
        1024
    """
    config.check_preset()
    return train(
        AgentTraining,
        config,
        out,
        force=force,
        trackers=trackers,
        progress=progress,
    )


class AgentTraining(Training[AgentConfig, AgentProgress, TrainedAgent]):
    """The stages of an agent's training, called by :func:`~wordcraft_kg.runs.training.train`.

    Attributes:
        kind: kind of run: commands, unit of progress, checkpoints.
        config_type: type of the settings.
        policy: the policy in training, after :meth:`prepare` or from a checkpoint.
        impala: the trainer, from :meth:`fit` on.
        metrics: path of ``metrics.jsonl``.
        seconds: seconds of training so far, without evaluation and writing.
    """

    kind: ClassVar[RunKind[Any]] = AGENTS
    config_type = AgentConfig

    def __init__(self, config: AgentConfig, opened: OpenedGraph):
        """Check that the device is available, before a folder is replaced.

        Raises:
            ConfigError: if not.
        """
        super().__init__(config, opened)
        check_device(config.trainer.device)

    @classmethod
    def settled(cls, config: AgentConfig, opened: OpenedGraph) -> AgentConfig:  # noqa: D102
        graph = opened.graph
        if graph.has_pairs_only:
            return config
        settled = config.for_sets(graph.most_ingredients)
        if settled.policy.policy != config.policy.policy:
            logging.getLogger(__name__).warning(
                "`policy` attention in place of pairs: recipes of %s have up to %d ingredients.",
                graph.name,
                graph.most_ingredients,
            )
        return settled

    @cached_property
    def envs(self) -> State:
        """Environments at the start of the first episodes; slow to make for a large graph.

        Raises:
            ConfigError: if an update does not fit into memory, or the graph has too few entities
                for so many distractors.
            TaskError: if the split has no train tasks for these settings.
        """
        config = self.config
        trainer = config.trainer
        # First: tasks that the graph cannot pose are no question of memory.
        world = World(self.opened, config.tasks.environment("train"))
        # Bytes of tables (int64), and of activations for the gradients (float32).
        slots = world.num_given
        units = config.policy.value_size
        if config.policy.policy == "pairs":
            # A few for each pair, but for two steps together.
            units = 3 * config.policy.pair_size * slots * (slots + 1) // 2
        num_bytes = trainer.steps_per_update * (8 * slots + 4 * units)
        # The error names the larger setting, which is the one to reduce.
        name = "batch_size" if trainer.num_envs >= trainer.unroll_steps else "unroll"
        update = f"an update of {trainer.steps_per_update:,} steps"
        check_memory(name, getattr(trainer, name), update, num_bytes)
        assert trainer.tables is not None  # closed by `AgentConfig`
        repeat = math.ceil(trainer.tables / trainer.num_envs)
        engine = BatchEngine(world, trainer.num_envs, device=trainer.device, repeat=repeat)
        return engine.reset(trainer.seed)

    @property
    def step(self) -> int:
        """Number of environment steps so far."""
        return self.impala.update_number * self.config.trainer.steps_per_update

    @property
    def elapsed(self) -> float:
        """Seconds of the run so far, with evaluation, writing and earlier parts."""
        return time.perf_counter() - self._begun

    @classmethod
    def input_hashes(cls, config: AgentConfig) -> dict[str, str | None]:  # noqa: D102 - inherited
        if config.scorer is None:
            return {"scorer": None, "scorer_folds": None}
        outputs = read_finished_run(Path(config.scorer), MODEL, WEIGHTS).outputs
        # The folds are an input only if they are used.
        folds = None if config.policy.in_sample else outputs.get(FOLDS_TENSORS)
        return {"scorer": outputs[WEIGHTS], "scorer_folds": folds}

    def prepare(self) -> None:
        """Load the scorer and make the policy; :attr:`facts` are for the run's record.

        Raises:
            ConfigError: if the settings do not fit the graph or the scorer.
            GraphMismatchError: if the scorer belongs to another graph.
            LeakError: if a model of the scorer has seen all recipes of a train task's plan.
            ArtefactError: if the scorer's folder is unfinished or damaged.
            TaskError: if the split has no train tasks for these settings.
        """
        config = self.config
        scorer = None
        observed = None
        self.facts: dict[str, Any] = {}
        if config.scorer is not None:
            model = open_model(Path(config.scorer), self.opened.source)
            scorer = model.scorer
            observed = model.triples
            self.facts["kg"] = model.kg
            folds = folds_of(scorer)
            if folds is not None and not config.policy.in_sample:
                self.facts["cross_fitted"] = folds.count
            elif model.kg == "partial":
                is_set = config.policy.in_sample
                logging.getLogger(__name__).warning(
                    "%s, so scores for train tasks are in-sample, and the agent learns to trust "
                    "the scorer too much. Use a scorer with `folds` 5, and no `in_sample`.",
                    "`in_sample` is set" if is_set else "the scorer has no folds",
                )
            _warn_of_self_pairs(self.opened.graph, config)
        self.policy, features = make_policy(
            config.policy,
            self.opened.graph,
            self.envs.engine.num_slots,
            scorer=scorer,
            observed=observed,
            tasks=self.envs.world.tasks,
            seed=config.trainer.seed,
        )
        if config.policy.weigh_plans:
            plan = self.policy.sources[P.name]
            assert isinstance(plan, BestPlan)
            weights = fit_plan_weights(plan, self.envs.world, seed=config.trainer.seed)
            plan.weigh(weights)
        hashes = self.input_hashes(config)
        inputs = {name: value for name, value in hashes.items() if value is not None}
        inputs["features"] = features.sha256
        self.facts["inputs"] = inputs
        self.facts["plugins"] = config.plugins | SPLITS.plugins(self.opened.split.config.kind)

    def begin(  # noqa: D102 - inherited
        self,
        run: RunFolder[AgentProgress],
        report: Progress | None,
    ) -> dict[str, Any]:
        write_constants(run.path, self.policy)
        return {"files": INPUTS, **self.facts}

    def fit(
        self,
        run: RunFolder[AgentProgress],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[AgentProgress] | None,
    ) -> TrainedAgent:
        """Train to the end.

        Args:
            run: the run's folder, record and checkpoints.
            report: called after each line of metrics; None for no progress.
            log: sends lines of metrics to the trackers.
            checkpoint: state to continue from; None for a new run.

        Returns:
            The run folder and the final evaluation.

        Raises:
            KeyboardInterrupt: after Ctrl-C, when a checkpoint is saved.
            ArtefactError: if the checkpoint does not fit the run, or a file has changed.
            TrainingError: if the loss is no longer finite; the last checkpoint stays.
            ConfigError: if the settings do not fit the graph or the machine.
        """
        self._start(run, report, log, checkpoint)
        trainer = self.config.trainer
        log_every = self._in_updates(trainer.log_every)
        checkpoint_every = self._in_updates(trainer.checkpoint_every)
        # Without learning curves, there is a point at the end alone.
        eval_every = self._in_updates(trainer.eval_every) if trainer.eval_every else trainer.updates
        with torch_threads(self.impala.threads):
            # A checkpoint before the first update, so that a run killed early can be resumed.
            if run.checkpoints.last is None:
                self._save()
            if not self.step:  # the first points on the curves
                self._log({}, is_point=True)
            while self.impala.update_number < trainer.updates and not run.interrupted.is_set():
                begun = time.perf_counter()
                self.impala.update()
                updates = self.impala.update_number
                is_point = updates == trainer.updates or updates % eval_every == 0
                # On a device, reading waits for pending work, so it is part of the measured time.
                is_logged = is_point or updates % log_every == 0
                figures = self.impala.take_metrics() if is_logged else None
                self.seconds += time.perf_counter() - begun
                if figures is not None:
                    self._log(figures, is_point=is_point)
                if updates % checkpoint_every == 0:
                    self._save()
            # At the end, or after Ctrl-C.
            if run.checkpoints.last != self.step:
                self._save()
            if self.impala.update_number < trainer.updates:
                raise KeyboardInterrupt
            return self._finish()

    def _start(
        self,
        run: RunFolder[AgentProgress],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[AgentProgress] | None,
    ) -> None:
        """Make the trainer, and restore its state; arguments and errors as :meth:`fit`."""
        self._begun = time.perf_counter()
        if checkpoint is not None:
            self.policy = policy_at(RunFiles(run.path, run.record), checkpoint)
        self.run = run
        self.report = report
        self.impala = Impala(self.policy, self.envs, self.config.trainer)
        self.metrics = run.path / METRICS_FILE
        if self.metrics.is_symlink():  # through which another run would be written to
            raise ArtefactError(
                f"{self.metrics} is a link; expected a file. Train again with `force`."
            )
        self._track = log
        self._curves = evaluators(self.envs.world, curve=True)
        self.seconds = 0.0
        # Step and seconds of the last line of metrics, for the speed since then.
        self._logged = (0, 0.0)
        if checkpoint is not None:
            progress = checkpoint.progress
            self.seconds = progress.seconds
            self._begun -= progress.elapsed
            with run.restoring():
                self.impala.restore(checkpoint.tensors)
                if self.step != checkpoint.number:
                    raise ValueError(f"the checkpoint has step {self.step:,}")
                # Lines after the checkpoint will be written again.
                if self.metrics.stat().st_size < progress.metrics_bytes:
                    raise ValueError(f"{METRICS_FILE} is shorter than at the checkpoint")
                os.truncate(self.metrics, progress.metrics_bytes)
            self._logged = (self.step, self.seconds)
            run.resume(self.config)

    @classmethod
    def outcome(cls, files: RunFiles) -> TrainedAgent:  # noqa: D102 - inherited
        return TrainedAgent(files.folder, read_summary(files))

    def _in_updates(self, steps: int) -> int:
        """Return a number of environment steps as a number of updates, 1 or more."""
        return max(1, round(steps / self.config.trainer.steps_per_update))

    def _log(self, figures: dict[str, float | None], *, is_point: bool) -> None:
        """Add a line of metrics; with a point on the learning curves if ``is_point``."""
        step, seconds = self._logged
        duration = self.seconds - seconds
        rate = round((self.step - step) / duration) if duration > 0 else None
        self._logged = (self.step, self.seconds)
        row: dict[str, Any] = {"step": self.step, **figures}
        if is_point:
            player = PolicyPlayer(self.policy)
            for part, evaluator in self._curves.items():
                row[f"{part}_success"] = float(evaluator(player).success.mean())
        row["steps_per_second"] = rate
        row["seconds"] = round(self.elapsed, 3)
        # One write for a line, so that a reader sees whole lines but for the last; without NaN and
        # infinity, which JSON lacks.
        with self.metrics.open("ab") as file:
            file.write((json_text(row) + "\n").encode())
        self._track(self.step, {name: value for name, value in row.items() if name != "step"})
        if self.report and self.step:
            names = ("success", "test_success", "steps_per_second")
            shown = {name: row[name] for name in names if row.get(name)}
            trainer = self.config.trainer
            self.report(self.step, trainer.updates * trainer.steps_per_update, shown)

    def _save(self) -> None:
        # A checkpoint counts on lines that are on disk, also after a power failure.
        self.metrics.touch()
        with self.metrics.open("rb+") as file:
            os.fsync(file.fileno())
        progress = AgentProgress(
            seconds=self.seconds,
            elapsed=self.elapsed,
            metrics_bytes=self.metrics.stat().st_size,
        )
        self.run.checkpoints.save(self.step, self.impala.state(), progress)

    def _finish(self) -> TrainedAgent:
        """Evaluate the trained policy, and write the files of a finished run."""
        run = self.run
        world = self.impala.envs.world
        player = PolicyPlayer(self.policy)
        results = {part: evaluator(player) for part, evaluator in evaluators(world).items()}
        summary = AgentSummary(
            steps=self.step,
            seconds=round(self.elapsed, 3),
            # Speed without evaluation and writing.
            steps_per_second=round(self.step / self.seconds) if self.seconds else 0,
            parameters=sum(parameter.numel() for parameter in self.policy.parameters()),
            success={part: result.metrics() for part, result in results.items()},
            outcomes={part: result.shares() for part, result in results.items()},
            distractors=self.config.tasks.distractors,
        )
        # `run.finish` comes last: only its record makes the run count as finished.
        write_parameters(run.path, self.policy)
        write_atomically(run.path / "evaluation.json", dump_json(as_values(summary)))
        write_atomically(run.path / EPISODES_FILE, _episode_lines(world, results))
        run.finish(OUTPUTS, agent_card(self.opened, self.config, run.record, summary))
        return TrainedAgent(run.path, summary)


def _warn_of_self_pairs(graph: RecipeGraph, config: AgentConfig) -> None:
    """Warn where the default treatment of self edges hurts: in books of one-ingredient recipes."""
    share = graph.num_self_pairs / graph.num_pairs
    if config.policy.self_edges == "observed" and share >= _MANY_SELF_PAIRS:
        logging.getLogger(__name__).warning(
            "%.0f %% of pairs in %s combine an entity with itself, but `self_edges` observed "
            "scores an unseen self pair like an average pair. On such a book, keep and drop gave "
            "better agents.",
            100 * share,
            graph.name,
        )


def _episode_lines(world: World, results: Mapping[TaskPart, Evaluation]) -> Iterator[str]:
    """Yield a line for each evaluated task: the task, and how each of its episodes ended."""
    for part, result in results.items():
        tasks = world.variant(part=part).tasks
        for i, number in enumerate(result.tasks.tolist()):
            task = tasks[number]
            codes = result.terminations[i].tolist()
            row = PlayedTask(
                part=part,
                goal=task.goal,
                start=task.start,
                success=float(result.success[i].mean()),
                terminations=tuple(TERMINATION_REASONS[code] for code in codes),
                actions=tuple(result.actions[i].tolist()),
            )
            yield json_text(msgspec.to_builtins(row)) + "\n"


_NOTES: Mapping[str | None, str] = {
    "full": (
        "\nThe scorer was trained on all triples, including test triples: success on test tasks "
        "measures the use of a perfect source, not generalisation.\n"
    ),
    "none": (
        "\nThe scorer was not trained on any recipe in the graph, so it treats train and test "
        "tasks alike, unless its source (such as a language model) knew recipes in this book.\n"
    ),
}
"""Notes on scorers of other recipes than the train recipes."""


def agent_card(
    opened: OpenedGraph,
    config: AgentConfig,
    run: RunRecord,
    summary: AgentSummary,
) -> str:
    """Return the model card of a finished training, in Markdown.

    Args:
        opened: graph and split of the training.
        config: settings of the training.
        run: record of the run, which says what the scorer was trained on.
        summary: final evaluation.
    """
    rows = "\n".join(
        f"- {part}: {result.mean:.3f} [{result.ci_low:.3f}, {result.ci_high:.3f}], "
        f"{result.tasks:,} tasks with {result.distractor_seeds} distractor seeds each"
        for part, result in summary.success.items()
    )
    return f"""{front_matter("reinforcement-learning", "knowledge-graph")}
# Agent for {opened.graph.name}, {_guide(config, run)}

Plays crafting tasks of depth {config.tasks.depth} with {config.tasks.distractors} distractors on \
graph `{opened.graph.hash[:12]}`.
{_note_on_scores(run)}
Success of the greedy policy by split (95 % interval over tasks, for this seed):

{rows}

Trained for {summary.steps:,} steps in {summary.seconds:.0f} s, seed {config.trainer.seed}, \
policy {config.policy.policy}, {summary.parameters:,} parameters, preset {config.trainer.preset}. \
`config.toml` reproduces the run; `run.json` lists software versions.

{usage(opened.graph.entities)}
"""


def _guide(config: AgentConfig, run: RunRecord) -> str:
    """Return the knowledge that guides the agent, for the title."""
    if not config.scorer:
        has_sources = need_no_scorer(config.policy.sources)
        return f"with {config.policy.use}" if has_sources else "without a knowledge graph"
    sources = " and ".join(config.policy.sources)
    graph = "no recipes" if run.kg == "none" else f"the {run.kg} knowledge graph"
    return f"with {sources} from a scorer trained on {graph}"


def _note_on_scores(run: RunRecord) -> str:
    """Return a paragraph on what the scorer knew of the tasks; empty without a scorer."""
    if run.kg != "partial":
        return _NOTES.get(run.kg, "")
    if run.cross_fitted:
        return (
            f"\nThe scorer is cross-fitted in {run.cross_fitted} folds: a model trained without "
            "the recipes of a train task scores this task. So success on train tasks predicts "
            "success on test tasks.\n"
        )
    return (
        "\nOn train tasks the scores were in-sample: the scorer was trained on the recipes of "
        "these tasks.\n"
    )


EVALUATED: tuple[TaskPart, ...] = ("train", "test")
"""Parts of the split on which a trained agent is evaluated."""
CURVE_TASKS = 4_000
"""Most tasks per part of the split for a point on a learning curve.

The final evaluation uses far more, see ``MOST_TASKS`` in ``envs.draws``.
"""


def evaluators(world: World, *, curve: bool = False) -> dict[TaskPart, Evaluator]:
    """Return evaluators for train and test tasks, by part.

    Args:
        world: world of the training, in any part.
        curve: take fewer tasks and, for train tasks, one table each, for learning curves.

    Returns:
        Evaluators by part; none for a part without tasks.

    Raises:
        ConfigError: if the graph has too few entities for the distractors beside a part's tasks.
    """
    result = {}
    for part in EVALUATED:
        with suppress(TaskError):  # without held-out recipes, a graph has no test tasks
            result[part] = Evaluator(
                world.variant(part=part),
                # The curve of test tasks is the one that is read closely.
                distractor_seeds=1 if curve and part == "train" else None,
                limit=CURVE_TASKS if curve else MOST_TASKS,
            )
    return result
