"""Making policies for a graph, and keeping them in a folder that needs nothing else to be used again."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.artefacts import dump_json, read_json, write_atomically
from wordcraft_kg.errors import ArtefactError, ConfigError
from wordcraft_kg.feature_spec import LEARNED
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.policies.actor_critic import AttentionPolicy
from wordcraft_kg.models.policies.attention import EntityVectors
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.mixing import KnowledgeScores
from wordcraft_kg.models.policies.mlp import MLPPolicy
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.scorers.features import EntityFeatures, make_features
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.scales import scaled_scorer
from wordcraft_kg.runs.record import read_finished_run, verified_bytes
from wordcraft_kg.tensors import read_tensors

POLICY_FORMAT = "wordcraft-kg policy 1"


def make_policy(
    config: PolicyConfig,
    graph: RecipeGraph,
    num_slots: int,
    *,
    scorer: TripleScorer | None = None,
    observed: Ids | None = None,
    seed: int = 0,
) -> tuple[Policy, EntityFeatures | None]:
    """Return an untrained policy for a graph, and its features if they are not learned.

    Args:
        config: its settings.
        graph: whose entities it decides among.
        num_slots: of the tables; only an mlp depends on it.
        scorer: what to mix in, see :func:`~wordcraft_kg.models.scorers.scales.scaled_scorer`.
        observed: triples that the scorer was trained on, for ``self_edges`` ``observed``.
        seed: of the parameters and of random features; no global generator is left changed.

    Raises:
        ConfigError: if the settings do not fit each other or the graph.
        GraphMismatchError: if the scorer belongs to another graph.
    """
    features = None
    if config.features != LEARNED:
        features = make_features(
            config.features, graph.entities, pooling=config.pooling, allow_missing=config.allow_missing, seed=seed
        )
    if scorer is not None:
        if config.policy == "mlp":
            raise ConfigError("--policy mlp has no logits to mix a scorer's with; leave out --scorer.")
        check_scorer(scorer, graph)
        scorer = scaled_scorer(scorer, scale=config.scale, self_edges=config.self_edges, observed=observed)
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)  # torch.manual_seed would seed those of all devices too
        vectors = None
        if features is not None and not features.is_one_hot:
            vectors = torch.tensor(features.vectors)
        entities = EntityVectors(
            graph.num_entities, vectors, learned_dim=config.embedding_size if config.features == LEARNED else 0
        )
        if config.policy == "mlp":
            return MLPPolicy(config, entities, num_slots), features
        knowledge = None
        if scorer is not None:
            knowledge = KnowledgeScores(graph.num_entities, config.sources, scorer)
        return AttentionPolicy(config, entities, knowledge), features


def write_constants(folder: Path, policy: Policy, graph: RecipeGraph) -> None:
    """Write what training never changes: ``policy.json`` and ``constants.safetensors`` (features, scores)."""
    knowledge = policy.knowledge if isinstance(policy, AttentionPolicy) else None
    description = {
        "format": POLICY_FORMAT,
        "graph": graph.hash,
        "entities": graph.entities,
        "settings": asdict(policy.config),
        "sources": [] if knowledge is None else knowledge.sources,
        "num_slots": policy.num_slots if isinstance(policy, MLPPolicy) else None,
        "dim": 0 if policy.vectors.is_one_hot else policy.vectors.dim,
    }
    constants = {name: tensor.cpu().contiguous() for name, tensor in policy.state_dict().items()}
    for name, _ in policy.named_parameters():
        del constants[name]
    write_atomically(folder / "constants.safetensors", safetensors.torch.save(constants))
    write_atomically(folder / "policy.json", dump_json(description))


def write_parameters(folder: Path, policy: Policy) -> None:
    """Write what training changed: ``policy.safetensors``."""
    parameters = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in policy.named_parameters()}
    write_atomically(folder / "policy.safetensors", safetensors.torch.save(parameters))


def read_policy(folder: Path, constants: bytes, parameters: Mapping[str, Tensor]) -> Policy:
    """Put a policy together from its folder's files.

    Raises:
        ArtefactError: if they do not fit each other.
    """
    description = read_json(folder / "policy.json")
    try:
        if description["format"] != POLICY_FORMAT:
            raise ValueError(f"its format is {description['format']!r}")
        config = PolicyConfig(**description["settings"])
        size, dim = len(description["entities"]), description["dim"]
        is_learned = config.features == LEARNED
        policy: Policy
        with torch.random.fork_rng(devices=[]):  # modules draw the parameters that are to be replaced
            vectors = EntityVectors(
                size, torch.zeros(size, dim) if dim and not is_learned else None, learned_dim=dim if is_learned else 0
            )
            if config.policy == "mlp":
                policy = MLPPolicy(config, vectors, description["num_slots"])
            else:
                sources = tuple(description["sources"])
                policy = AttentionPolicy(config, vectors, KnowledgeScores(size, sources) if sources else None)
        policy.load_state_dict({**read_tensors(folder / "constants.safetensors", constants), **parameters})
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise ArtefactError(
            f"{folder / 'policy.json'} and the weights do not make a policy ({type(error).__name__}: {error}). "
            "Train it again, or restore a copy."
        ) from None
    return policy.eval()


def load_policy(folder: str | Path) -> tuple[Policy, dict[str, Any]]:
    """Load a trained policy, and what ``policy.json`` says of it: ``graph`` (hash), ``entities`` in id order, ...

    The folder is all it needs: neither the graph nor the scorer nor the feature file has to be there.

    Raises:
        ArtefactError: if the run is unfinished, or a file in it is missing or damaged.
    """
    folder = Path(folder)
    run = read_finished_run(folder, "wordcraft-kg train-agent")
    parameters = read_tensors(folder / "policy.safetensors", verified_bytes(folder, run, "policy.safetensors"))
    description = json.loads(verified_bytes(folder, run, "policy.json"))
    return read_policy(folder, verified_bytes(folder, run, "constants.safetensors"), parameters), description
