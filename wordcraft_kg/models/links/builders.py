"""Build PyKEEN models and training loops from settings, and extract scorer tensors."""

from contextlib import suppress
from typing import Any

import torch
from pykeen.losses import loss_resolver
from pykeen.models import DistMult, ERModel, Model, model_resolver
from pykeen.training import TrainingLoop, training_loop_resolver
from pykeen.triples import TriplesFactory

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import nearest, refuse
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.complex import ComplExN3
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig, LinkSettings
from wordcraft_kg.models.links.popularity import with_popularity
from wordcraft_kg.models.links.pykeen_bridge import all_scores, pykeen_guard, quiet_pykeen
from wordcraft_kg.models.links.symmetric_lcwa import (
    IndexedSymmetricLCWATrainingLoop,
    SampledSymmetricLCWATrainingLoop,
)
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer


def make_training_loop(
    config: LinkSettings, factory: TriplesFactory, num_entities: int | None = None
) -> TrainingLoop:
    """Build a PyKEEN loop with its model, or raise ConfigError; the first ``num_entities`` are the graph's."""
    if isinstance(config, ComplExConfig):
        return _complex_loop(config, factory, num_entities)
    return _pykeen_loop(config, factory)


def check_table_fits(model: str, num_entities: int) -> None:
    """Raise ConfigError for an unknown PyKEEN model, or one without embeddings and with too large a table."""
    needed = table_bytes(num_entities)
    if not issubclass(model_class(model), (ComplExN3, DistMult)) and needed > TABLE_LIMIT:
        raise ConfigError(
            f"`model` {model!r} needs a score table, {needed / 2**30:,.1f} GiB for {num_entities:,} entities; "
            f"expected at most {TABLE_LIMIT / 2**30:.2f} GiB. Models that need no table: distmult, and ComplEx "
            "(wordcraft-kg train-complex)."
        )


def scorer_kind(config: LinkSettings, num_entities: int) -> str:
    """Return ``complex`` (embeddings) or ``table`` (scores); errors as :func:`check_table_fits`."""
    if isinstance(config, ComplExConfig):
        return ComplExScorer.kind
    check_table_fits(config.model, num_entities)
    return TableScorer.kind if table_bytes(num_entities) <= TABLE_LIMIT else ComplExScorer.kind


def scorer_tensors(
    config: LinkSettings, model: Model, triples: Ids, num_entities: int | None = None
) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the kind and tensors of a scorer: the graph's embeddings with popularity, or a score table."""
    kind = scorer_kind(config, model.num_entities)
    if kind == TableScorer.kind:
        scores = all_scores(model, torch.arange(model.num_entities), range(len(RELATIONS)))
        return kind, {"scores": scores} | {
            f"pykeen.{name}": value.cpu() for name, value in model.state_dict().items()
        }
    return kind, with_popularity(
        _embeddings(model, num_entities), triples, getattr(config, "popularity", None) or 0.0
    )


def _complex_loop(
    config: ComplExConfig, factory: TriplesFactory, num_entities: int | None
) -> TrainingLoop:
    config = config.fixed()
    model = ComplExN3(
        triples_factory=factory,
        embedding_dim=config.dim,
        init_scale=config.init_scale,
        regularizer="powersum" if config.n3 else None,
        regularizer_kwargs={"weight": config.n3} if config.n3 else None,
        random_seed=config.seed,
    ).to(config.device)
    settings: dict[str, Any] = {
        "triples_factory": factory,
        "automatic_memory_optimization": False,
        "optimizer": "Adagrad",
        "optimizer_kwargs": {"lr": config.learning_rate},
    }
    if factory.num_relations > len(RELATIONS):
        settings |= {"num_own": num_entities, "outside_weight": config.outside_weight}
    negatives = config.for_size(factory.num_entities).negatives
    if negatives:
        return SampledSymmetricLCWATrainingLoop(model, num_sampled=negatives, **settings)
    return IndexedSymmetricLCWATrainingLoop(model, **settings)


def _embeddings(model: Model, num_entities: int | None) -> dict[str, torch.Tensor]:
    tensors: dict[str, torch.Tensor] = {}
    for name, (representation,), size in (
        ("entity", model.entity_representations, num_entities),
        ("relation", model.relation_representations, len(RELATIONS)),
    ):
        embedding = representation()[:size].detach().cpu()
        if not embedding.is_complex():  # DistMult is ComplEx without imaginary parts
            embedding = torch.complex(embedding, torch.zeros_like(embedding))
        tensors |= {
            f"{name}_real": embedding.real.contiguous(),
            f"{name}_imag": embedding.imag.contiguous(),
        }
    return tensors


def model_class(name: str) -> type[Model]:
    """Return the PyKEEN model class with a given name; ConfigError for ComplEx, which has its own training command."""
    if name.lower() == "complex":
        raise ConfigError(
            f"`model` {name!r}: ComplEx is trained with the paper's objective, by `wordcraft-kg train-complex`. For "
            'PyKEEN\'s ComplEx with sampled negatives, use pipeline(dataset="wordcraft", model="ComplEx").'
        )
    if name.lower() not in model_resolver.lookup_dict:
        raise refuse(
            "model", name, "a PyKEEN model", nearest(name.lower(), model_resolver.lookup_dict)
        )
    kind: type[Model] = model_resolver.lookup_dict[name.lower()]
    if not issubclass(kind, ERModel):
        raise ConfigError(
            f"`model` {name!r} learns no embeddings; expected a PyKEEN embedding model, as 'rotate'."
        )
    return kind


def trainable_models() -> list[type[Model]]:
    """Return all PyKEEN embedding model classes that need only triples for training, by name."""
    three = torch.tensor([[0, 0, 1], [1, 0, 0], [0, 1, 2]])
    factory = TriplesFactory(
        three, {"a": 0, "b": 1, "c": 2}, {name: i for i, name in enumerate(RELATIONS)}
    )
    trainable = []
    with pykeen_guard(0, threads=1), quiet_pykeen():
        for name, kind in sorted(model_resolver.lookup_dict.items()):
            with suppress(ConfigError):
                make_training_loop(LinkModelConfig(model=name, dim=4), factory)
                trainable.append(kind)
    return trainable


def _pykeen_loop(config: LinkModelConfig, factory: TriplesFactory) -> TrainingLoop:
    is_softmax = config.loop == "symmetric"
    kind = model_class(config.model)
    try:
        model = kind(
            triples_factory=factory,
            embedding_dim=config.dim,
            loss=loss_resolver.make("crossentropy" if is_softmax else "nssa"),
            random_seed=config.seed,
        ).to(config.device)
    except (TypeError, ValueError, NotImplementedError, AttributeError, AssertionError) as error:
        # Raised by models that need more than triples (literals, inverse triples).
        raise ConfigError(
            f"`model` {config.model!r}: PyKEEN cannot build this model for a recipe graph ({error!r})."
        ) from None
    return training_loop_resolver.lookup("symmetriclcwa" if is_softmax else "slcwa")(
        model=model,
        triples_factory=factory,
        # PyKEEN searches the largest batch for GPUs; on a CPU the search would only waste two batches.
        automatic_memory_optimization=model.device.type == "cuda",
        optimizer="Adam",
        optimizer_kwargs={"lr": config.learning_rate},
        **(
            {}
            if is_softmax
            else {"negative_sampler_kwargs": {"num_negs_per_pos": config.negatives}}
        ),
    )
