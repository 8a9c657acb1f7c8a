"""Training an agent into a run folder.

Checkpoints hold the complete trainer state, so that on a CPU an interrupted and continued run ends with the same bits
as an uninterrupted run.
"""

import json
import logging
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import torch

from wordcraft_kg.agents.agent_folder import AGENTS, INPUTS, policy_at
from wordcraft_kg.agents.config import AgentConfig
from wordcraft_kg.agents.curves import MetricsFile, evaluators
from wordcraft_kg.agents.evaluation import Evaluation, PolicyPlayer
from wordcraft_kg.agents.impala import Impala, check_compiler
from wordcraft_kg.agents.outcomes import TERMINATION_REASONS
from wordcraft_kg.agents.records import (
    EPISODES_FILE,
    AgentProgress,
    AgentSummary,
    PlayedTask,
    read_summary,
)
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.base.tensors import check_device, torch_threads
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.folder import (
    make_policy,
    usage,
    write_constants,
    write_parameters,
)
from wordcraft_kg.models.policies.sources.registry import pairs_need_factors
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.folder import FOLDS_TENSORS, MODEL, WEIGHTS
from wordcraft_kg.runs.cards import front_matter
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.record import RunRecord, read_finished_run
from wordcraft_kg.runs.trackers import Log, Tracker
from wordcraft_kg.runs.training import Training, train

OUTPUTS = (
    "policy.safetensors",
    "policy.json",
    "constants.safetensors",
    "evaluation.json",
    "metrics.jsonl",
)
_MANY_SELF_PAIRS = 0.25  # minimum share for a warning about self edges


@dataclass(frozen=True)
class TrainedAgent:
    """The result of an agent's training: run folder, number of environment steps so far, and the final evaluation.

    ``summary`` is None for an interrupted run, which the same call would continue.
    """

    folder: Path
    step: int
    summary: AgentSummary | None

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the run."""
        return self.summary is None


def train_agent(
    config: AgentConfig,
    out: str | Path | None = None,
    *,
    force: bool = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Progress | bool | None = None,
) -> TrainedAgent:
    """Train an agent into a run folder, or continue an interrupted run with the same settings.

    ``out`` is by default ``runs/<graph name>-<scorer folder or no-kg>``. ``progress`` is called after each line of
    metrics. Further arguments and errors are those of :func:`~wordcraft_kg.runs.training.train`.

    Example:
        >>> config = AgentConfig("kitchen", "models/kitchen", trainer=ImpalaConfig(steps=512, eval_every=0))
        >>> trained = train_agent(config, "runs/kitchen")
        >>> trained.step
        512
    """
    return train(AgentTraining, config, out, force=force, trackers=trackers, progress=progress)


class AgentTraining(Training[AgentConfig, AgentProgress, TrainedAgent]):
    """The stages of an agent's training, called by :func:`~wordcraft_kg.runs.training.train`."""

    kind: ClassVar[RunKind[Any]] = AGENTS
    config_type = AgentConfig

    def __init__(self, config: AgentConfig, opened: OpenedGraph):
        """Check that the device and the compiler are available; ConfigError otherwise."""
        super().__init__(config, opened)
        check_device(config.trainer.device)
        if config.trainer.compile:
            check_compiler(torch.device(config.trainer.device))

    @cached_property
    def envs(self) -> State:
        """Environments at the start of the first episodes; creating tasks takes time for a large graph."""
        config, trainer = self.config, self.config.trainer
        # Tables, and activations for the gradients.
        slots = config.tasks.distractors + config.tasks.depth + 1
        needed = trainer.steps_per_update * (8 * slots + 4 * config.policy.value_size)
        name, size = max(
            ("batch_size", trainer.batch_size),
            ("unroll", trainer.unroll),
            key=lambda setting: setting[1],
        )
        check_memory(name, size, f"an update of {trainer.steps_per_update:,} steps", needed)
        world = World(self.opened, config.tasks.environment("train"))
        return BatchEngine(world, trainer.batch_size, device=trainer.device).reset(trainer.seed)

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
        folds = None if config.policy.in_sample else outputs.get(FOLDS_TENSORS)
        return {"scorer": outputs[WEIGHTS], "scorer_folds": folds}

    def prepare(self) -> None:
        """Load the scorer and make the policy."""
        config, opened, scorer = self.config, self.opened, None
        observed, self.facts = None, dict[str, Any]()
        if config.scorer is not None:
            model = open_model(Path(config.scorer), opened.source)
            scorer, observed = model.scorer, model.triples
            # Checked before the tasks are made.
            whole = whole_of(scorer) if config.policy.in_sample else scorer
            pairs_need_factors(config.policy.sources, whole, config.policy.scale)
            self.facts["kg"] = model.kg
            folds = folds_of(scorer)
            if folds is not None and not config.policy.in_sample:
                self.facts["cross_fitted"] = folds.count
            elif model.kg == "partial":
                _warn_of_in_sample_scores(config)
            _warn_of_self_pairs(opened.graph, config)
        world, slots, seed = self.envs.world, self.envs.engine.num_slots, config.trainer.seed
        self.policy, features = make_policy(
            config.policy,
            opened.graph,
            slots,
            scorer=scorer,
            observed=observed,
            tasks=world.tasks,
            seed=seed,
        )
        inputs = {
            name: value for name, value in self.input_hashes(config).items() if value is not None
        }
        if features is not None:
            inputs["features"] = features.sha256
            self.facts["missing_words"] = tuple(features.missing_words)
        self.facts["inputs"] = inputs

    def begin(self, run: RunFolder[AgentProgress], report: Progress | None) -> dict[str, Any]:  # noqa: D102 - inherited
        write_constants(run.path, self.policy)
        return {"files": INPUTS, **self.facts}

    def fit(  # noqa: D102 - inherited
        self,
        run: RunFolder[AgentProgress],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[AgentProgress] | None,
    ) -> TrainedAgent:
        self._begun = time.perf_counter()
        if checkpoint is not None:
            self.policy = policy_at(RunFiles(run.path, run.record), checkpoint)
        self.run, self.report = run, report
        self.impala = Impala(self.policy, self.envs, self.config.trainer)
        self.metrics = MetricsFile(run.path, self.envs.world, log)
        self.seconds, self._logged = 0.0, (0, 0.0)
        if checkpoint is not None:
            with run.restoring():
                self._restore(checkpoint)
            run.resume(self.config)
        with torch_threads(self.config.trainer.threads):
            self._train()
            if self.impala.update_number < self.config.trainer.updates:
                run.interrupt()
                return TrainedAgent(run.path, self.step, None)
            return self._finish()

    @classmethod
    def outcome(cls, files: RunFiles) -> TrainedAgent:  # noqa: D102 - inherited
        summary = read_summary(files)
        return TrainedAgent(files.folder, summary.steps, summary)

    def _restore(self, checkpoint: Checkpoint[AgentProgress]) -> None:
        self.impala.restore(checkpoint.tensors)
        if self.step != checkpoint.number:
            raise ValueError(f"the checkpoint has step {self.step:,}")
        progress = checkpoint.progress
        self.seconds, self.metrics.eval_seconds = progress.seconds, progress.eval_seconds
        self._begun -= progress.elapsed
        self.metrics.cut(progress.metrics_bytes)
        self._logged = (self.step, self.seconds)

    def _train(self) -> None:
        trainer = self.config.trainer
        log_every, checkpoint_every, eval_every = (
            max(1, round(steps / trainer.steps_per_update))
            for steps in (trainer.log_every, trainer.checkpoint_every, trainer.eval_every)
        )
        if not trainer.eval_every:
            eval_every = trainer.updates
        if self.run.checkpoints.last is None:
            self._save()
        if not self.step:  # the first points on the curves
            self._log({}, is_point=True)
        while self.impala.update_number < trainer.updates and not self.run.interrupted.is_set():
            begun = time.perf_counter()
            self.impala.update()
            done = self.impala.update_number
            is_point = done == trainer.updates or done % eval_every == 0
            # On a device, reading waits for pending work, so reading is part of the measured time.
            figures = self.impala.take_figures() if is_point or done % log_every == 0 else None
            self.seconds += time.perf_counter() - begun
            if figures is not None:
                self._log(figures, is_point=is_point)
            if done % checkpoint_every == 0:
                self._save()
        if self.run.checkpoints.last != self.step:
            self._save()

    def _log(self, figures: dict[str, float | None], *, is_point: bool) -> None:
        step, seconds = self._logged
        rate = (
            round((self.step - step) / (self.seconds - seconds)) if self.seconds > seconds else None
        )
        self._logged = (self.step, self.seconds)
        row = {
            "step": self.step,
            **figures,
            **(self.metrics.evaluate(self.policy) if is_point else {}),
        }
        row |= {"steps_per_second": rate, "seconds": round(self.elapsed, 3)}
        self.metrics.add(row)
        if self.report and self.step:
            names = ("success", "test_success", "steps_per_second")
            shown = {name: value for name in names if (value := row.get(name))}
            self.report(
                self.step, self.config.trainer.updates * self.config.trainer.steps_per_update, shown
            )

    def _save(self) -> None:
        eval_seconds, size = self.metrics.eval_seconds, self.metrics.size()
        times = {"seconds": self.seconds, "eval_seconds": eval_seconds, "elapsed": self.elapsed}
        progress = AgentProgress(**times, metrics_bytes=size)
        self.run.checkpoints.save(self.step, self.impala.state(), progress)

    def _finish(self) -> TrainedAgent:
        run, config = self.run, self.config
        player = PolicyPlayer(self.policy)
        results = {
            part: evaluator(player)
            for part, evaluator in evaluators(self.impala.envs.world).items()
        }
        summary = AgentSummary(
            steps=self.step,
            seconds=round(self.elapsed, 3),
            # Speed without evaluation and writing.
            steps_per_second=round(self.step / self.seconds) if self.seconds else 0,
            curves_share=round(self.metrics.eval_seconds / self.elapsed, 4),
            parameters=sum(parameter.numel() for parameter in self.policy.parameters()),
            success={part: result.figures() for part, result in results.items()},
            outcomes={part: result.shares() for part, result in results.items()},
            distractors=config.tasks.distractors,
        )
        write_parameters(run.path, self.policy)
        write_atomically(run.path / "evaluation.json", dump_json(as_values(summary)))
        write_atomically(run.path / EPISODES_FILE, _episode_lines(self.impala.envs.world, results))
        run.finish(OUTPUTS, _model_card(self.opened, config, run.record, summary))
        return TrainedAgent(run.path, self.step, summary)


def _warn_of_in_sample_scores(config: AgentConfig) -> None:
    cause, remedy = "the scorer has no folds", " Train the scorer with `folds` 5."
    if config.policy.in_sample:
        cause, remedy = "`in_sample` is set", ""
    message = "%s, so scores for train tasks are in-sample, and the agent learns to trust the scorer too much.%s"
    logging.getLogger(__name__).warning(message, cause, remedy)


def _warn_of_self_pairs(graph: RecipeGraph, config: AgentConfig) -> None:
    share = graph.num_self_pairs / graph.num_pairs
    if config.policy.self_edges == "observed" and share >= _MANY_SELF_PAIRS:
        logging.getLogger(__name__).warning(
            "%.0f %% of pairs in %s combine an entity with itself, but `self_edges` observed scores an unseen self pair"
            " like an average pair. On such a book, keep and drop gave better agents.",
            100 * share,
            graph.name,
        )


def _episode_lines(world: World, results: Mapping[TaskPart, Evaluation]) -> Iterator[str]:
    for part, result in results.items():
        tasks = world.variant(part=part).tasks
        for i, number in enumerate(result.tasks.tolist()):
            task = tasks[number]
            row = PlayedTask(
                part=part,
                goal=task.goal,
                start=task.start,
                success=float(result.success[i].mean()),
                terminations=tuple(
                    TERMINATION_REASONS[code] for code in result.terminations[i].tolist()
                ),
                actions=tuple(result.actions[i].tolist()),
            )
            yield json.dumps(msgspec.to_builtins(row), ensure_ascii=False) + "\n"


def _note_on_scores(run: RunRecord) -> str:
    if run.kg is None:
        return ""
    if run.kg == "full":
        return (
            "\nThe scorer was trained on all triples, including test triples: success on test tasks measures the use "
            "of a perfect source, not generalisation.\n"
        )
    if run.kg == "none":
        return (
            "\nThe scorer was not trained on any recipe in the graph, so it treats train and test tasks alike, unless "
            "its source (such as a language model) knew recipes in this book.\n"
        )
    if run.cross_fitted:
        return (
            f"\nThe scorer is cross-fitted in {run.cross_fitted} folds: a model trained without the recipes of a "
            "train task scores this task. So success on train tasks predicts success on test tasks.\n"
        )
    return "\nOn train tasks the scores were in-sample: the scorer was trained on the recipes of these tasks.\n"


def _model_card(
    opened: OpenedGraph, config: AgentConfig, run: RunRecord, summary: AgentSummary
) -> str:
    policy, tasks = config.policy, config.tasks
    kind = "Self-attention actor-critic" if policy.policy == "attention" else "One-layer MLP"
    guide = "without a knowledge graph"
    if config.scorer:
        trained_on = (
            f"trained on the {run.kg} knowledge graph"
            if run.kg != "none"
            else "not trained on recipes"
        )
        use = "as the only logits" if policy.kg_only else "mixed into the logits"
        guide = f"with {' and '.join(policy.sources)} from a scorer {trained_on}, {use}"
    rows = "\n".join(
        f"- {part}: {result.mean:.3f} [{result.ci_low:.3f}, {result.ci_high:.3f}], "
        f"{result.tasks:,} tasks with {result.distractor_seeds} distractor seeds each"
        for part, result in summary.success.items()
    )
    return f"""{front_matter("reinforcement-learning", "knowledge-graph")}
# {kind} for {opened.graph.name}, {guide}

Plays crafting tasks of depth {tasks.depth} with {tasks.distractors} distractors on graph `{opened.graph.hash[:12]}`.
{_note_on_scores(run)}
Success of the greedy policy by split (95 % interval over tasks, for this seed):

{rows}

Trained for {summary.steps:,} steps in {summary.seconds:.0f} s, seed {config.trainer.seed}, \
{summary.parameters:,} parameters. `config.toml` reproduces the run; `run.json` lists software versions.

{usage(opened.graph.entities)}
"""
