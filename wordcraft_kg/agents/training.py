"""Training an agent into a run folder: metrics, learning curves, checkpoints, and going on after an interruption.

The folder is there from the start, and ``run.json`` says how it stands: running, interrupted, failed or done. A
checkpoint holds all that the trainer knows, so on a CPU a resumed run ends with the same bits as an undisturbed one.
"""

import json
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from wordcraft_kg.agents.agent_folder import INPUTS, Checkpoints, constants_of, read_agent_run, read_run_config
from wordcraft_kg.agents.config import KIND, AgentConfig
from wordcraft_kg.agents.evaluation import ENDINGS, Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.impala import Impala, check_compiler
from wordcraft_kg.artefacts import check_output, dump_json, sha256_of, with_a_name, write_atomically
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.errors import ArtefactError, MissingExtraError, OutputExistsError, TaskError, TrainingError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.links.folder import open_model
from wordcraft_kg.models.policies.folder import make_policy, read_policy, write_constants, write_parameters
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.records import as_values
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.interruption import first_interrupt
from wordcraft_kg.runs.record import end_run, resume_run, start_run
from wordcraft_kg.tensors import check_device

PARTS: tuple[TaskPart, ...] = ("train", "test")
DRAWS = 5
CURVE_TASKS = 4_000
"""Tasks of a part that a point of a learning curve is made of, at most; the final figures are made of all."""
OUTPUTS = ("policy.safetensors", "policy.json", "constants.safetensors", "evaluation.json", "metrics.jsonl")
Progress = Callable[[int, int, dict[str, float]], None]
"""Called with environment steps done, all of them, and the latest figures."""


@dataclass(frozen=True)
class TrainedAgent:
    """What a training run came to.

    Attributes:
        folder: of the run.
        step: environment steps done.
        interrupted: whether Ctrl-C ended it; ``resume`` goes on.
        summary: steps, seconds, steps a second, success by part; empty for an interrupted run.
    """

    folder: Path
    step: int
    interrupted: bool
    summary: dict[str, Any]


def train_agent(
    opened: OpenedGraph,
    config: AgentConfig,
    out: Path,
    *,
    force: bool = False,
    tensorboard: bool = False,
    progress: Progress | None = None,
) -> TrainedAgent:
    """Train an agent and write its run folder.

    Args:
        opened: graph and split; ``config.graph`` says where they are.
        config: all settings.
        out: the folder to write.
        force: replace a run that is there.
        tensorboard: write TensorBoard's event files too.
        progress: called after each line of metrics.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False.
        ConfigError: if the settings do not fit the graph or the machine.
        GraphMismatchError: if the scorer belongs to another graph or split.
        TrainingError: if the loss is no longer finite.
    """
    out = with_a_name(out)
    check_agent_output(out, force=force)
    trainer = config.trainer
    check_device(trainer.device)
    if trainer.compile:
        check_compiler(torch.device(trainer.device))
    engine = _engine(opened, config)
    scorer, observed, kg = None, None, None
    inputs = {"graph": opened.graph.hash, "split": opened.split.hash}
    if config.scorer is not None:
        model = open_model(Path(config.scorer), opened.source)
        scorer, kg = model.scorer, model.kg
        observed = opened.triples(kg)
        inputs["scorer"] = model.provenance["weights"]
    policy, features = make_policy(
        config.policy, opened.graph, engine.num_slots, scorer=scorer, observed=observed, seed=trainer.seed
    )
    with _writer(out, tensorboard) as writer, _replacing(out):
        write_constants(out, policy)
        config.write(out)
        inputs |= {name: sha256_of(out / name) for name in INPUTS}
        if features is not None:
            inputs["features"] = features.sha256
        facts: dict[str, Any] = {"seed": trainer.seed, "device": trainer.device, "threads": trainer.threads}
        missing = [] if features is None else list(features.missing_words)
        facts |= {"kg": kg, "tensorboard": tensorboard, "missing_words": missing}
        run = start_run(out, KIND, **facts, inputs=inputs)
        return _Run(opened, config, out, run, policy, engine, writer, progress).go()


def resume_agent(folder: Path, *, graph: str | None = None, progress: Progress | None = None) -> TrainedAgent:
    """Go on with an interrupted run from its last checkpoint.

    Args:
        folder: of the run.
        graph: where the graph is now, if it has moved.
        progress: called after each line of metrics.

    Raises:
        ArtefactError: if the run is done, damaged, or under way elsewhere.
        GraphMismatchError: if the graph or its split is not the one that the run began with.
    """
    folder = with_a_name(folder)
    run = read_agent_run(folder)
    if run["status"] == "done":
        raise ArtefactError(
            f"'{folder}' is finished; there is nothing to resume. Judge it: wordcraft-kg evaluate-agent {folder}"
        )
    config = read_run_config(folder, run)
    opened = open_run_graph(folder, run, graph or config.graph)
    check_device(config.trainer.device)
    if run["versions"].get("torch") != torch.__version__:
        logging.getLogger(__name__).warning(
            "the run began with torch %s and goes on with %s: the result may differ in the last bits.",
            run["versions"].get("torch"),
            torch.__version__,
        )
    engine = _engine(opened, config)
    checkpoint = Checkpoints(folder).load()
    if checkpoint is None:
        raise ArtefactError(f"'{folder}' has no checkpoint; train it again with --force.")
    parameters = {name: value for name, value in checkpoint.tensors.items() if name.startswith("policy.")}
    policy = read_policy(
        folder, constants_of(folder, run), {name.removeprefix("policy."): value for name, value in parameters.items()}
    )
    step = int(checkpoint.record["step"])
    with _writer(folder, run.get("tensorboard", False), step) as writer, _locked(folder):
        ongoing = _Run(opened, config, folder, run, policy, engine, writer, progress)
        ongoing.restore(checkpoint.tensors, checkpoint.record)
        resume_run(folder, run)
        return ongoing.go()


def check_agent_output(out: Path, *, force: bool) -> None:
    """Refuse an output that exists; where an unfinished run is, say how to go on with it.

    Raises:
        OutputExistsError: if it exists and ``force`` is False.
    """
    if not force and (out / "run.json").is_file():
        run = read_agent_run(out)
        if run["status"] != "done":
            raise OutputExistsError(
                f"an unfinished run is in '{out}'. Go on: wordcraft-kg resume {out}, or start anew with --force."
            )
    check_output(out, force=force)


def interruption_message(folder: Path, step: int) -> str:
    """Say what an interrupted run has kept and how to go on."""
    return f"interrupted; step {step:,} is saved. Go on with: wordcraft-kg resume {folder}"


class _Run:
    """A training under way."""

    def __init__(
        self,
        opened: OpenedGraph,
        config: AgentConfig,
        folder: Path,
        run: dict[str, Any],
        policy: Policy,
        engine: BatchEngine,
        writer: Any,
        progress: Progress | None,
    ):
        self.opened, self.config, self.folder, self.run = opened, config, folder, run
        self.policy, self.writer, self.progress = policy, writer, progress
        self.impala = Impala(policy, engine, config.trainer)
        self.checkpoints = Checkpoints(folder)
        self.metrics = folder / "metrics.jsonl"
        self.seconds = self.eval_seconds = 0.0
        self._elapsed, self._begun = 0.0, time.perf_counter()
        trainer, per_update = config.trainer, config.trainer.steps_per_update
        every = {"log": trainer.log_every, "eval": trainer.eval_every, "checkpoint": trainer.checkpoint_every}
        self._every = {name: max(1, round(steps / per_update)) for name, steps in every.items()}
        if not trainer.eval_every:
            self._every["eval"] = trainer.updates
        self._saved = -1
        self._logged = (0, 0.0)

    @property
    def step(self) -> int:
        """Environment steps done."""
        return self.impala.update_number * self.config.trainer.steps_per_update

    @property
    def elapsed(self) -> float:
        """Seconds from start to now, of all parts of a run that was resumed; evaluations and writing included."""
        return self._elapsed + time.perf_counter() - self._begun

    def restore(self, tensors: dict[str, torch.Tensor], record: dict[str, Any]) -> None:
        """Go back to a checkpoint, and cut the metrics to it."""
        try:
            self.impala.restore(tensors)
            self.seconds, self.eval_seconds = record["seconds"], record["eval_seconds"]
            self._elapsed = record["elapsed"]
            if self.metrics.stat().st_size < record["metrics_bytes"]:
                raise ValueError("metrics.jsonl is shorter than it was")
            os.truncate(self.metrics, record["metrics_bytes"])
        except (KeyError, RuntimeError, TypeError, ValueError, OSError) as error:
            raise ArtefactError(
                f"the checkpoint in '{self.folder}' does not fit the run ({type(error).__name__}: {error}). Train anew."
            ) from None
        self._saved = self.step
        self._logged = (self.step, self.seconds)

    def go(self) -> TrainedAgent:
        """Train to the end, or to the first Ctrl-C."""
        before = torch.get_num_threads()
        torch.set_num_threads(self.config.trainer.threads)
        try:
            with first_interrupt() as interrupted:
                self._train(interrupted)
                if self.impala.update_number < self.config.trainer.updates:
                    end_run(self.folder, self.run, "interrupted")
                    return TrainedAgent(self.folder, self.step, True, {})
                return self._finish()
        except BaseException as error:
            with suppress(OSError):  # the disk may be full
                end_run(self.folder, self.run, "interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
            if self._saved < 0:
                raise
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(interruption_message(self.folder, self._saved)) from None
            kept = f"The checkpoint of step {self._saved:,} is safe"
            if isinstance(error, TrainingError):
                raise TrainingError(f"{error} {kept}, in '{self.folder}'.") from None
            if isinstance(error, OSError):
                raise ArtefactError(
                    f"'{self.folder}' cannot be written ({error.strerror or error}). {kept}; make room, then go on "
                    f"with: wordcraft-kg resume {self.folder}"
                ) from None
            raise
        finally:
            torch.set_num_threads(before)

    def _train(self, interrupted: threading.Event) -> None:
        trainer, every = self.config.trainer, self._every
        evaluators = self._evaluators(curve=True)
        if self._saved < 0:
            self.metrics.touch()
            self._save()
        if not self.step:  # where everything begins
            self._log({}, evaluators)
        while self.impala.update_number < trainer.updates and not interrupted.is_set():
            begun = time.perf_counter()
            self.impala.update()
            done = self.impala.update_number
            is_last = done == trainer.updates
            is_point = is_last or done % every["eval"] == 0
            # On a device this is where its work is waited for, so the clock goes on.
            figures = self.impala.take_figures() if is_point or done % every["log"] == 0 else None
            self.seconds += time.perf_counter() - begun
            if figures is not None:
                self._log(figures, evaluators if is_point else {})
            if done % every["checkpoint"] == 0:
                self._save()
        if self._saved != self.step:
            self._save()

    def _evaluators(self, *, curve: bool) -> dict[TaskPart, Evaluator]:
        """Return the players of all tasks of each part that has some."""
        found = {}
        for part in PARTS:
            with suppress(TaskError):  # a graph whose split holds nothing out has no test tasks
                world = self.impala.engine.world.variant(part=part)
                draws = 1 if curve and part == "train" else DRAWS
                found[part] = Evaluator(world, draws=draws, limit=CURVE_TASKS if curve else None)
        return found

    def _log(self, figures: dict[str, float | None], evaluators: dict[TaskPart, Evaluator]) -> None:
        step, seconds = self._logged
        rate = (self.step - step) / (self.seconds - seconds) if self.seconds > seconds else None
        self._logged = (self.step, self.seconds)
        row: dict[str, Any] = {"step": self.step, **figures}
        begun = time.perf_counter()
        for part, evaluator in evaluators.items():
            row[f"{part}_success"] = float(evaluator(PolicyPlayer(self.policy)).success.mean())
        self.eval_seconds += time.perf_counter() - begun
        row |= {"steps_per_second": rate and round(rate), "seconds": round(self.elapsed, 3)}
        with self.metrics.open("ab") as file:
            file.write((json.dumps(row, allow_nan=False) + "\n").encode())
        if self.writer is not None:
            for name, value in row.items():
                if name != "step" and value is not None:
                    self.writer.add_scalar(name, value, self.step)
        if self.progress and self.step:
            shown = {name: row[name] for name in ("success", "test_success", "steps_per_second") if row.get(name)}
            total = self.config.trainer.updates * self.config.trainer.steps_per_update
            self.progress(self.step, total, shown)

    def _save(self) -> None:
        facts = {"seconds": self.seconds, "eval_seconds": self.eval_seconds, "elapsed": self.elapsed}
        with self.metrics.open("rb+") as file:
            os.fsync(file.fileno())
        self.checkpoints.save(self.step, self.impala.state(), metrics_bytes=self.metrics.stat().st_size, **facts)
        self._saved = self.step

    def _finish(self) -> TrainedAgent:
        results = {
            part: evaluator(PolicyPlayer(self.policy)) for part, evaluator in self._evaluators(curve=False).items()
        }
        summary = {
            "steps": self.step,
            "seconds": round(self.elapsed, 3),
            # Of acting and learning alone; all else that the seconds hold is evaluation and writing.
            "steps_per_second": round(self.step / self.seconds) if self.seconds else 0,
            "curves_share": round(self.eval_seconds / self.elapsed, 4),
            "parameters": sum(parameter.numel() for parameter in self.policy.parameters()),
            "success": {part: as_values(result.figures()) for part, result in results.items()},
            "outcomes": {part: result.shares() for part, result in results.items()},
            "distractors": self.config.tasks.distractors,
        }
        write_parameters(self.folder, self.policy)
        write_atomically(self.folder / "evaluation.json", dump_json(summary))
        write_atomically(self.folder / "episodes.jsonl", _episode_lines(self.impala.engine.world, results))
        write_atomically(self.folder / "README.md", _model_card(self.opened, self.config, self.run, summary))
        end_run(self.folder, self.run, "done", OUTPUTS)
        shutil.rmtree(self.checkpoints.folder)
        return TrainedAgent(self.folder, self.step, False, summary)


@contextmanager
def _replacing(out: Path) -> Iterator[None]:
    """Make the run's folder; an earlier one is put aside, and comes back if the run leaves nothing to go on with."""
    aside = None
    if out.exists():
        aside = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.old."))
        os.rename(out, aside / "was")
    try:
        out.mkdir(parents=True)
        with _locked(out):
            yield
    finally:
        is_kept = (out / "policy.safetensors").exists() or bool(Checkpoints(out).records())
        if not is_kept:
            shutil.rmtree(out, ignore_errors=True)
            if aside is not None:
                os.rename(aside / "was", out)
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep others from training in a folder for as long as this process does; the lock ends with the process.

    Raises:
        ArtefactError: if another process does.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArtefactError(f"'{folder}' is being trained by another process; wait for it, or stop it.") from None
        yield
    finally:
        os.close(handle)


@contextmanager
def _writer(folder: Path, wanted: bool, step: int = 0) -> Iterator[Any]:
    """Yield TensorBoard's writer from a step on, or None."""
    if not wanted:
        yield None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingExtraError(
            "--tensorboard needs the package tensorboard. Install it: pip install 'wordcraft-kg[tensorboard]'"
        ) from None
    writer = None

    class Late:
        """Opens the event file with the first figure, when the folder is there."""

        def add_scalar(self, *values: Any) -> None:
            nonlocal writer
            writer = writer or SummaryWriter(str(folder / "tensorboard"), purge_step=step or None)
            writer.add_scalar(*values)

    try:
        yield Late()
    finally:
        if writer is not None:
            writer.close()


def _engine(opened: OpenedGraph, config: AgentConfig) -> BatchEngine:
    trainer = config.trainer
    world = World(opened, config.tasks.environment("train"))
    return BatchEngine(world, trainer.batch_size, device=trainer.device, seed=trainer.seed)


def _episode_lines(world: World, results: dict[TaskPart, Evaluation]) -> Iterator[str]:
    """One line a task: what it was, and how each draw of distractors ended."""
    for part, result in results.items():
        for i, task in enumerate(world.variant(part=part).tasks):
            row = {
                "part": part,
                "goal": task.goal,
                "start": task.start,
                "success": float(result.success[i].mean()),
                "endings": [ENDINGS[code] for code in result.endings[i].tolist()],
                "picks": result.picks[i].tolist(),
            }
            yield json.dumps(row, ensure_ascii=False) + "\n"


def _model_card(opened: OpenedGraph, config: AgentConfig, run: dict[str, Any], summary: dict[str, Any]) -> str:
    policy, tasks = config.policy, config.tasks
    kind = "Self-attention actor-critic" if policy.policy == "attention" else "One-layer MLP"
    guide = "without a knowledge graph"
    if config.scorer:
        own = "only" if policy.kg_only else "mixed into its logits"
        guide = f"with {' and '.join(policy.sources)} of a scorer of the {run['kg']} knowledge graph {own}"
    warning = (
        "\nThe scorer was trained on all triples, those of the test recipes included: success on test tasks says how "
        "well the agent uses a perfect source, not how well it generalises.\n"
        if run["kg"] == "full"
        else ""
    )
    rows = "\n".join(
        f"- {part}: {values['mean']:.3f} [{values['ci_low']:.3f}, {values['ci_high']:.3f}], "
        f"{values['tasks']:,} tasks with {values['draws']} draws of distractors each"
        for part, values in summary["success"].items()
    )
    return f"""# {kind} for {opened.graph.name}, {guide}

Plays crafting tasks of depth {tasks.depth} with {tasks.distractors} distractors on graph `{opened.graph.hash[:12]}`.
{warning}
Success, greedy, in the part's tasks (95 % interval over tasks; one training, so it says nothing about other seeds):

{rows}

Trained for {summary["steps"]:,} steps in {summary["seconds"]:.0f} s, seed {config.trainer.seed}, \
{summary["parameters"]:,} parameters. `config.toml` reproduces it; `run.json` says with which versions it was made.

```python
from wordcraft_kg.models.policies.folder import load_policy

policy = load_policy("this folder")
output = policy(goal, selection, table)  # ids; {opened.graph.num_entities} stands for nothing
```
"""
