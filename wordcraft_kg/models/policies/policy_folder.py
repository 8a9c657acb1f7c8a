"""Make policies for a graph; write and load policy folders.

A policy folder holds all that a policy needs: neither graph, scorer nor feature file is read again.
Parts that never change during training (features, scores) lie in ``constants.safetensors``, written
once at the start; trained parameters in ``policy.safetensors``.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.base import (
    MAX_DIM,
    ArtefactError,
    ConfigError,
    Count,
    NotRegisteredError,
    Record,
    as_values,
    dump_json,
    read_record,
    reason,
    staged_folder,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.tensors import MAX_WEIGHT, copied, largest, read_tensors, with_prefix
from wordcraft_kg.graphs import Ids, RecipeGraph, TaskSet
from wordcraft_kg.models.policies.networks import AttentionPolicy, MLPPolicy, NetworkPolicy
from wordcraft_kg.models.policies.pairs import PairPolicy
from wordcraft_kg.models.policies.policy import EntityVectors, Policy
from wordcraft_kg.models.policies.policy_config import POLICIES, PolicyConfig
from wordcraft_kg.models.policies.sources import need_no_scorer, with_letters
from wordcraft_kg.models.policies.sources.registry import make_sources, source_class
from wordcraft_kg.models.policies.sources.source import ScoreView, Source, share_lists
from wordcraft_kg.models.scorers.baselines import SymbolicScorer
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import EntityFeatures, make_features
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.runs.record import RunFiles, end_run, front_matter, read_finished_run, start_run

_POLICY_FILES = ("policy.json", "constants.safetensors", "policy.safetensors")


class _Description(Record, frozen=True, kw_only=True):
    """The file ``policy.json``: what the tensors are.

    Attributes:
        format: name and version of the file format.
        graph: content hash of the recipe graph.
        entities: labels in id order.
        settings: of :class:`~wordcraft_kg.models.policies.policy_config.PolicyConfig`, by name.
        sources: short names of the sources in mixing order; none without a scorer.
        num_slots: slots of an mlp; None for other policies.
        dim: length of entity vectors; 0 for one-hot vectors.
    """

    format: Literal["wordcraft-kg policy 1"] = "wordcraft-kg policy 1"
    graph: str
    entities: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    settings: dict[str, Any]
    sources: tuple[str, ...]
    num_slots: Count | None
    dim: Annotated[int, msgspec.Meta(ge=0, le=MAX_DIM)]


def make_policy(
    config: PolicyConfig,
    graph: RecipeGraph,
    num_slots: int,
    *,
    scorer: TripleScorer | None = None,
    observed: Ids | None = None,
    tasks: TaskSet | None = None,
    seed: int = 0,
) -> tuple[Policy, EntityFeatures]:
    """Return an untrained policy for a graph, and its entity features.

    Args:
        config: policy settings.
        graph: recipe graph.
        num_slots: table slots, used by an mlp only.
        scorer: knowledge graph model whose triple scores the policy mixes into its logits; None for
            no mixing. Each source in ``config.sources`` turns triple scores into slot scores.
        observed: ids of the scorer's training triples, shape (T, 3). Required if
            ``config.self_edges`` is "observed", which keeps the score of an entity combined with
            itself only for a training triple.
        tasks: training tasks, such as ``world.tasks``, required by cross-fitted scorers; None
            without.
        seed: random seed for parameters and random features; global generators stay unchanged.

    Returns:
        The policy, and its features.

    Raises:
        ConfigError: if settings conflict or do not fit the graph.
        GraphMismatchError: if the scorer belongs to another graph.
        LeakError: if a model has seen all recipes of a task's plan.
        ArtefactError: if a folder of vectors in the features is damaged.
    """
    config = config.closed()
    features = make_features(
        config.features,
        graph.entities,
        pooling=config.pooling,
        allow_missing=config.allow_missing,
        seed=seed,
    )
    sources: list[Source] = []
    if scorer is None and need_no_scorer(config.sources):
        # These sources read the labels alone.
        scorer = SymbolicScorer(graph, graph.triples[:0])
    if scorer is not None:
        if config.policy == "mlp":
            raise ConfigError("`policy` mlp cannot mix in scorer scores; leave out `scorer`.")
        check_scorer(scorer, graph)
        # In-sample scores are those of the model of all train recipes, without its folds.
        assert config.scale is not None  # closed above
        view = ScoreView(config.scale, config.self_edges, observed, width=config.plan_width)
        scorer = whole_of(scorer) if config.in_sample else scorer
        sources = make_sources(config.sources, scorer, view, tasks=tasks)
    # torch draws parameters from its global generator, which is set here and restored.
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)  # torch.manual_seed would seed all devices too
        vectors = None if features.is_one_hot else torch.tensor(features.vectors)
        entities = EntityVectors(graph.num_entities, vectors)
        most_picks = 0 if graph.has_pairs_only else graph.most_ingredients
        policy = _policy(config, entities, num_slots, sources, most_picks)
    policy.entities = graph.entities
    policy.graph_hash = graph.hash
    return policy, features


def _policy(
    config: PolicyConfig,
    vectors: EntityVectors,
    num_slots: int,
    sources: list[Source],
    most_picks: int,
) -> Policy:
    if most_picks and config.policy != "attention":
        raise ConfigError(
            f"`policy` {config.policy} takes recipes of two ingredients, and the graph has others. "
            "Choose `policy` attention."
        )
    pair_sources = [source.name for source in sources if not source.takes_sets]
    if most_picks and pair_sources:
        raise ConfigError(
            f"`use` {with_letters(pair_sources)} takes recipes of two ingredients so far, and the "
            "graph has others. Choose `use` combines,component,recipe,plan."
        )
    if vectors.is_one_hot and config.policy not in (None, "attention", "pairs"):
        raise ConfigError(
            f"`policy` {config.policy} takes no one-hot vectors; choose `features` random, which "
            "have no meaning either."
        )
    if config.policy == "mlp":
        return MLPPolicy(config, vectors, num_slots)
    if config.policy == "pairs":
        return PairPolicy(config, vectors, sources)
    if config.policy is not None and config.policy in POLICIES:
        # In memory even for a policy that is read: tensors that are no buffers are in no file.
        with torch.device("cpu"):
            network = POLICIES[config.policy](vectors.dim)
        return NetworkPolicy(config, vectors, sources, network)
    return AttentionPolicy(config, vectors, sources, most_picks=most_picks)


def write_constants(folder: Path, policy: Policy) -> None:
    """Write a policy's untrained parts (features, scores), which training never changes.

    The files are ``policy.json``, with the settings, and ``constants.safetensors``.

    Raises:
        ConfigError: if a number is not finite, or too large to be read again.
    """
    description = _Description(
        graph=policy.graph_hash,
        entities=policy.entities,
        settings=asdict(policy.config),
        sources=tuple(policy.sources),
        num_slots=policy.num_slots,
        dim=0 if policy.vectors.is_one_hot else policy.vectors.dim,
    )
    # Everything that is not a parameter: buffers of vectors and sources. Sources of one scorer may
    # share tensors, such as w and p the words; the file has a copy each.
    constants = copied(policy.state_dict())
    for name, _ in policy.named_parameters():
        del constants[name]
    _check_numbers(constants)
    write_atomically(folder / "constants.safetensors", safetensors.torch.save(constants))
    write_atomically(folder / "policy.json", dump_json(as_values(description)))


def _check_numbers(tensors: Mapping[str, Tensor]) -> None:
    """Raise ConfigError for numbers that :func:`read_policy` refuses."""
    for name, tensor in tensors.items():
        if not largest(tensor) <= MAX_WEIGHT:
            raise ConfigError(
                f"the policy's {name} has numbers that are not finite, or above {MAX_WEIGHT:g}; "
                "expected smaller ones. Train with a smaller `learning_rate` or smaller scores."
            )


def write_parameters(folder: Path, policy: Policy) -> None:
    """Write a policy's trained parameters: ``policy.safetensors``."""
    parameters = copied(dict(policy.named_parameters()))
    write_atomically(folder / "policy.safetensors", safetensors.torch.save(parameters))


def read_policy(
    folder: Path,
    constants: bytes,
    parameters: Mapping[str, Tensor],
) -> Policy:
    """Rebuild a policy from a folder's files, which may be damaged.

    Args:
        folder: folder with ``policy.json``.
        constants: content of ``constants.safetensors``, verified by the caller.
        parameters: trained parameters by name, of the end of training or of a checkpoint.

    Returns:
        The policy in evaluation mode, on the CPU.

    Raises:
        ArtefactError: if the files do not fit each other.
    """
    description = read_record(folder / "policy.json", _Description)
    tensors = read_tensors(folder / "constants.safetensors", constants)
    entities = description.entities
    size = len(entities)
    try:
        if len(set(entities)) < size:
            raise ValueError("a label occurs twice among the entities")
        config = PolicyConfig(**description.settings)
        if description.sources not in ((), config.sources):
            raise ValueError(f"sources {description.sources}, settings for {config.sources}")
        # From the files' own tensors, which they check.
        sources = [
            source_class(name).restored(size, with_prefix(tensors, f"sources.{name}."))
            for name in description.sources
        ]
        # Modules without memory, whatever sizes the description names: only shapes matter here.
        with torch.random.fork_rng(devices=[]), torch.device("meta"):
            dim = description.dim
            vectors = EntityVectors(size, torch.zeros(size, dim) if dim else None)
            # A learned term for each number of selections, if recipes have other sizes than two.
            most_picks = len(parameters.get("combine.counts", (0,))) - 1
            # Without a number, an mlp's weights do not fit.
            policy = _policy(config, vectors, description.num_slots or 1, sources, most_picks)
        # Constants, which have been checked, come before parameters of the same name.
        weights = {**parameters, **tensors}
        for name, expected in policy.state_dict().items():
            # load_state_dict would convert another type in silence.
            stored = weights.get(name, expected)
            if (stored.dtype, stored.shape) != (expected.dtype, expected.shape):
                raise ValueError(
                    f"{name} has type {stored.dtype}, shape {tuple(stored.shape)}; settings and "
                    f"entities need {expected.dtype}, {tuple(expected.shape)}"
                )
        # In a checkpoint, other numbers may be larger.
        _check_numbers(parameters)
        # Assigned, not copied: the tensors may be large.
        policy.load_state_dict(weights, assign=True)
        share_lists(policy.sources.values())
        policy.entities = entities
        policy.graph_hash = description.graph
    except NotRegisteredError as error:
        raise NotRegisteredError(f"'{folder}': {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise ArtefactError(
            f"{folder / 'policy.json'} and the weights do not make a policy ({reason(error)}). "
            "Train again, or restore a copy."
        ) from None
    return policy.eval()


def save_policy(
    folder: str | Path,
    policy: Policy,
    *,
    force: bool = False,
) -> Path:
    """Write a policy, such as one trained further, into a folder for :func:`load_policy`.

    Args:
        folder: folder to write.
        policy: a policy from :func:`make_policy` or :func:`load_policy`, which have entity labels.
        force: replace the folder if it exists.

    Returns:
        The folder.

    Raises:
        OutputExistsError: if ``folder`` exists and ``force`` is False.
        ConfigError: if the policy has no entity labels, or one of its numbers is not finite
            or too large.

    Example:
        >>> policy = load_policy("runs/kitchen")
        >>> load_policy(save_policy("policies/mine", policy)).entities == policy.entities
        True
    """
    if not policy.entities:
        raise ConfigError("the policy has no `entities`: use make_policy or load_policy.")
    _check_numbers(dict(policy.named_parameters()))
    # Written into a folder beside, which takes the place of the old one at the end.
    out = with_a_name(Path(folder))
    with staged_folder(out, force=force) as staging:
        write_constants(staging, policy)
        write_parameters(staging, policy)
        write_atomically(staging / "README.md", _card(policy))
        inputs = {"graph": policy.graph_hash}
        run = start_run(staging, "save-policy", inputs=inputs, plugins=policy.config.plugins)
        end_run(staging, run, "done", _POLICY_FILES)
    return out


def _card(policy: Policy) -> str:
    return f"""{front_matter("reinforcement-learning", "knowledge-graph")}
# A policy for crafting tasks

Decides among the {policy.num_entities:,} entities in graph `{policy.graph_hash[:12]}`. \
A program saved this policy with
wordcraft-kg, so training settings are not recorded here and training cannot be reproduced.

{usage(policy.entities)}
"""


def usage(entities: tuple[str, ...]) -> str:
    """Return the model card's section on using a policy for these entities."""
    goal, first, second = (entities * 3)[:3]
    return f"""```python
from wordcraft_kg import load_policy

policy = load_policy("this folder")
policy.act(goal={goal!r}, table=[{first!r}, {second!r}])  # the first action
```"""


def load_policy(folder: str | Path) -> Policy:
    """Load a policy from a finished run or a saved policy; neither graph nor scorer is needed.

    All files are verified by the hashes in ``run.json``.

    Raises:
        ArtefactError: if the run is unfinished, or a file is missing or damaged.

    Example:
        >>> policy = load_policy("runs/kitchen")
        >>> policy.entities[0], [label.symbol for label in policy.labels]
        ('animal', ['α', 'u', 'v'])
        >>> policy.act(goal="bread", table=["flour", "water"]).entity in ("flour", "water")
        True
    """
    folder = Path(folder)
    files = RunFiles(
        folder,
        read_finished_run(folder, "a run folder from train-agent", "policy.safetensors"),
    )
    files.bytes("policy.json")
    return read_policy(
        folder,
        files.bytes("constants.safetensors"),
        files.tensors("policy.safetensors"),
    )
