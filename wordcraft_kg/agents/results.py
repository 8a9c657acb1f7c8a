"""Output files of a finished training: weights, evaluation, episodes and model card."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from wordcraft_kg.agents.config import AgentConfig
from wordcraft_kg.agents.evaluation import Evaluation
from wordcraft_kg.agents.outcomes import TERMINATION_REASONS
from wordcraft_kg.agents.records import EPISODES_FILE, AgentSummary, PlayedTask
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.records import as_values
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.folder import usage, write_parameters
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.runs.cards import front_matter
from wordcraft_kg.runs.record import RunRecord

OUTPUTS = ("policy.safetensors", "policy.json", "constants.safetensors", "evaluation.json", "metrics.jsonl")


def write_results(
    folder: Path, policy: Policy, world: World, summary: AgentSummary, results: Mapping[TaskPart, Evaluation]
) -> None:
    """Write a policy's weights, the final evaluation and the evaluated episodes into a run folder."""
    write_parameters(folder, policy)
    write_atomically(folder / "evaluation.json", dump_json(as_values(summary)))
    write_atomically(folder / EPISODES_FILE, _episode_lines(world, results))


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
                terminations=tuple(TERMINATION_REASONS[code] for code in result.terminations[i].tolist()),
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


def model_card(opened: OpenedGraph, config: AgentConfig, run: RunRecord, summary: AgentSummary) -> str:
    """Return the text of a trained agent's model card, ``README.md``."""
    policy, tasks = config.policy, config.tasks
    kind = "Self-attention actor-critic" if policy.policy == "attention" else "One-layer MLP"
    guide = "without a knowledge graph"
    if config.scorer:
        trained_on = f"trained on the {run.kg} knowledge graph" if run.kg != "none" else "not trained on recipes"
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
