"""The model card of a trained agent: ``README.md`` in its run folder.

A card says what the agent plays, how often it succeeds, and what its scores were trained on:
readers who never saw the training must not take success with test recipes in the scorer for
generalisation.
"""

from wordcraft_kg.agents.config import AgentConfig
from wordcraft_kg.agents.records import AgentSummary
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.policies.config import PolicyKind
from wordcraft_kg.models.policies.folder import usage
from wordcraft_kg.runs.record import RunRecord, front_matter

_KINDS: dict[PolicyKind, str] = {
    "pairs": "Actor-critic on pairs",
    "attention": "Self-attention actor-critic",
    "mlp": "One-layer MLP",
}


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
    kind = _KINDS[config.policy.policy or "attention"]
    rows = "\n".join(
        f"- {part}: {result.mean:.3f} [{result.ci_low:.3f}, {result.ci_high:.3f}], "
        f"{result.tasks:,} tasks with {result.distractor_seeds} distractor seeds each"
        for part, result in summary.success.items()
    )
    return f"""{front_matter("reinforcement-learning", "knowledge-graph")}
# {kind} for {opened.graph.name}, {_guide(config, run)}

Plays crafting tasks of depth {config.tasks.depth} with {config.tasks.distractors} distractors on \
graph `{opened.graph.hash[:12]}`.
{_note_on_scores(run)}
Success of the greedy policy by split (95 % interval over tasks, for this seed):

{rows}

Trained for {summary.steps:,} steps in {summary.seconds:.0f} s, seed {config.trainer.seed}, \
{summary.parameters:,} parameters, preset {config.trainer.preset}. `config.toml` reproduces the \
run; `run.json` lists software versions.

{usage(opened.graph.entities)}
"""


def _guide(config: AgentConfig, run: RunRecord) -> str:
    """Return the knowledge that guides the agent, for the title."""
    if not config.scorer:
        return "without a knowledge graph"
    trained_on = "not trained on recipes"
    if run.kg != "none":
        trained_on = f"trained on the {run.kg} knowledge graph"
    use = "as the only logits" if config.policy.kg_only else "mixed into the logits"
    return f"with {' and '.join(config.policy.sources)} from a scorer {trained_on}, {use}"


def _note_on_scores(run: RunRecord) -> str:
    """Return a paragraph on what the scorer knew of the tasks; empty without a scorer."""
    if run.kg is None:
        return ""
    if run.kg == "full":
        return (
            "\nThe scorer was trained on all triples, including test triples: success on test "
            "tasks measures the use of a perfect source, not generalisation.\n"
        )
    if run.kg == "none":
        return (
            "\nThe scorer was not trained on any recipe in the graph, so it treats train and test "
            "tasks alike, unless its source (such as a language model) knew recipes in this "
            "book.\n"
        )
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
