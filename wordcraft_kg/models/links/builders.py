"""Build PyKEEN models and training loops from settings, and extract scorer tensors.

Popularity (log counts in the training triples) is a part of ComplEx, in further dimensions: a
softmax over entities first learns how often each entity is an answer, and on a small book the
embeddings learn little more. As dimensions, the counts need no other kind of scorer.

A new kind of link predictor is a class of settings in ``link_config.py`` and branches here.

PyKEEN's interaction of ComplEx contracts head, relation and tail from left to right, which builds a
(batch, entities, dim) tensor when heads are scored. Here the two known factors are multiplied
first, so all candidates of a batch cost one product of (B, 2 d) and (2 d, E) real matrices, for
heads and for tails; B queries, d complex dimensions, E entities.

The page docs/link-prediction.md says which models there are, under *Train*, and
docs/evidence/links.md#complex measures ComplEx.
"""

from typing import Any

import numpy as np
import torch
from pykeen.losses import CrossEntropyLoss, loss_resolver
from pykeen.models import DistMult, ERModel, Model, model_resolver
from pykeen.nn.modules import ComplExInteraction
from pykeen.regularizers import PowerSumRegularizer
from pykeen.training import TrainingLoop, training_loop_resolver
from pykeen.triples import TriplesFactory

from wordcraft_kg.base import ConfigError, nearest, refuse
from wordcraft_kg.graphs import RELATIONS, Ids
from wordcraft_kg.models.links.link_config import (
    ComplExConfig,
    LinkSettings,
)
from wordcraft_kg.models.links.pykeen_bridge import all_scores
from wordcraft_kg.models.links.symmetric_lcwa import (
    IndexedSymmetricLCWATrainingLoop,
    SampledSymmetricLCWATrainingLoop,
)
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer, real_dot
from wordcraft_kg.models.scorers.score_limits import TABLE_LIMIT, has_table, table_bytes


def make_training_loop(
    config: LinkSettings, factory: TriplesFactory, num_entities: int | None = None
) -> TrainingLoop:
    """Build the PyKEEN model for some settings and the loop that trains it.

    Args:
        config: model and training settings.
        factory: training triples.
        num_entities: number of the graph's entities, which have the first ids; needed only for
            joint training with triples from outside the book, whose nodes follow.

    Raises:
        ConfigError: if PyKEEN has no such model, or cannot build it with these settings.
    """
    if isinstance(config, ComplExConfig):
        return _complex_loop(config, factory, num_entities)
    # Any other model of PyKEEN, with its objective: softmax, or sampled negatives.
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
            f"`model` {config.model!r}: PyKEEN cannot build this model for a recipe graph "
            f"({error!r})."
        ) from None
    negatives = {"negative_sampler_kwargs": {"num_negs_per_pos": config.negatives}}
    sampling: dict[str, Any] = {} if is_softmax else negatives
    return training_loop_resolver.lookup("symmetriclcwa" if is_softmax else "slcwa")(
        model=model,
        triples_factory=factory,
        # PyKEEN searches the largest batch for GPUs; on a CPU the search would only waste two
        # batches.
        automatic_memory_optimization=model.device.type == "cuda",
        optimizer="Adam",
        optimizer_kwargs={"lr": config.learning_rate},
        **sampling,
    )


def check_table_fits(model: str, num_entities: int) -> None:
    """Check that a PyKEEN model can be stored for so many entities.

    DistMult is stored as embeddings; all other models become a score table.

    Raises:
        ConfigError: if PyKEEN has no such model, or its table would be too large.
    """
    needs_table = not issubclass(model_class(model), DistMult)
    if needs_table and not has_table(num_entities):
        raise ConfigError(
            f"`model` {model!r} needs a score table, {table_bytes(num_entities) / 2**30:,.1f} GiB "
            f"for {num_entities:,} entities; expected at most {TABLE_LIMIT / 2**30:.2f} GiB. "
            "Models that need no table: distmult, and ComplEx (wordcraft-kg train-complex)."
        )


def scorer_tensors(
    config: LinkSettings, model: Model, triples: Ids, num_entities: int | None = None
) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the kind and tensors of the scorer that a trained model becomes.

    ComplEx becomes its embeddings, popularity included; any other model becomes a table of all
    triples' scores, where that fits the limit. In a larger book only DistMult passes the check: it
    is ComplEx without imaginary parts.

    Args:
        config: settings of the model.
        model: the trained PyKEEN model.
        triples: training triples, ids of shape (T, 3), counted for popularity.
        num_entities: number of the graph's entities, which have the first ids; None for all.

    Raises:
        ConfigError: as :func:`check_table_fits`.
    """
    if isinstance(config, ComplExConfig):
        embeddings = _embeddings(model, num_entities)
        return ComplExScorer.kind, with_popularity(embeddings, triples, config.popularity or 0.0)
    check_table_fits(config.model, model.num_entities)
    if not has_table(model.num_entities):
        return ComplExScorer.kind, _embeddings(model, num_entities)
    entities = torch.arange(model.num_entities)
    return TableScorer.kind, {"scores": all_scores(model, entities, range(len(RELATIONS)))}


def _complex_loop(
    config: ComplExConfig, factory: TriplesFactory, num_entities: int | None
) -> TrainingLoop:
    # A model that is built without a training has no chosen weights.
    config = config.fixed()
    model = complex_model(factory, config).to(config.device)
    settings: dict[str, Any] = {
        "triples_factory": factory,
        # Without PyKEEN's search for batches that fit into memory: it takes time, and results must
        # not depend on the machine.
        "automatic_memory_optimization": False,
        "optimizer": "Adagrad",
        "optimizer_kwargs": {"lr": config.learning_rate},
    }
    # More relations than the game's two: joint training with triples from outside the book.
    if factory.num_relations > len(RELATIONS):
        settings |= {"num_own": num_entities, "outside_weight": config.outside_weight}
    negatives = config.for_size(factory.num_entities).negatives
    if negatives:
        return SampledSymmetricLCWATrainingLoop(model, num_sampled=negatives, **settings)
    return IndexedSymmetricLCWATrainingLoop(model, **settings)


def _embeddings(model: Model, num_entities: int | None) -> dict[str, torch.Tensor]:
    """Return the embeddings of the graph's entities and relations, without outside nodes."""
    tensors: dict[str, torch.Tensor] = {}
    for name, (representation,), size in (
        ("entity", model.entity_representations, num_entities),
        ("relation", model.relation_representations, len(RELATIONS)),
    ):
        embedding = representation()[:size].detach().cpu()
        # DistMult is ComplEx without imaginary parts.
        if not embedding.is_complex():
            embedding = torch.complex(embedding, torch.zeros_like(embedding))
        tensors[f"{name}_real"] = embedding.real.contiguous()
        tensors[f"{name}_imag"] = embedding.imag.contiguous()
    return tensors


def model_class(name: str) -> type[Model]:
    """Return the PyKEEN model class with a given name, in any case of letters.

    Raises:
        ConfigError: for an unknown model or one without embeddings (the error names all with
            embeddings, and the nearest), or ComplEx, which means the paper's model and has its own
            training command.
    """
    if name.lower() == "complex":
        raise ConfigError(
            f"`model` {name!r}: ComplEx is trained with the paper's objective, by `wordcraft-kg "
            "train-complex`. For "
            "PyKEEN's ComplEx with sampled negatives, use "
            'pipeline(dataset="wordcraft", model="ComplEx").'
        )
    models = model_resolver.lookup_dict.items()
    embedding_models = {known: kind for known, kind in models if issubclass(kind, ERModel)}
    if name.lower() not in embedding_models:
        names = sorted(embedding_models)
        raise refuse("model", name, f"one of {', '.join(names)}", nearest(name.lower(), names))
    return embedding_models[name.lower()]


# --- popularity -----------------------------------------------------------------------------------


def log_counts(triples: Ids, num_entities: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Count entities as heads and as tails.

    Args:
        triples: ids of shape (T, 3).
        num_entities: number of entities E.

    Returns:
        ``log(1 + n)`` of the counts as head and as tail, by relation: two float32 tensors of shape
        (R, E).
    """
    heads, relations, tails = triples.T

    def log_count(ends: Ids) -> torch.Tensor:
        cells = relations * num_entities + ends
        counts = np.bincount(cells, minlength=len(RELATIONS) * num_entities)
        logs = np.log1p(counts).astype(np.float32)
        return torch.from_numpy(logs).reshape(len(RELATIONS), num_entities)

    return log_count(heads), log_count(tails)


def with_popularity(
    embeddings: dict[str, torch.Tensor], triples: Ids, weight: float
) -> dict[str, torch.Tensor]:
    """Add ``weight * (log(1 + n_head) + log(1 + n_tail))`` to all scores of ComplEx embeddings.

    Let ``f`` be the head term, ``g`` the tail term, ``x = (f + g) / 2`` and ``y = (f - g) / 2``. In
    a relation's three dimensions, entities have ``s + x / 2s``, ``s - x / 2s`` and ``s + i y / s``,
    and the relation has 1, -1 and -i:

    ``(s + x_h/2s)(s + x_t/2s) - (s - x_h/2s)(s - x_t/2s) = x_h + x_t`` and
    ``Re[-i (s + i y_h/s)(s - i y_t/s)] = y_h - y_t``, together ``f_h + g_t``. Any s > 0 is correct;
    ``s^2 = max |x| / 2`` keeps the cancelling terms as small as the sum.

    Args:
        embeddings: ``entity_real``, ``entity_imag`` (E, d), ``relation_real`` and ``relation_imag``
            (R, d).
        triples: the counted triples, ids of shape (T, 3).
        weight: 0 or more; 0 changes nothing.

    Returns:
        the same tensors with d + 6 dimensions.
    """
    if not weight:
        return embeddings
    as_head, as_tail = log_counts(triples, len(embeddings["entity_real"]))
    entity = []
    relation = []
    for number in range(len(RELATIONS)):
        f = weight * as_head[number]
        g = weight * as_tail[number]
        x = (f + g) / 2
        y = (f - g) / 2
        # Above 0 even if all counts are 0, because s is a divisor.
        s = (x.abs().max() / 2).sqrt().clamp(min=1e-3)
        half = x / (2 * s)
        entity.append(torch.stack([s + half, s - half, s + 1j * y / s], dim=1))
        # Other relations have zeros in these dimensions, so their scores do not change.
        rows = torch.zeros(len(RELATIONS), 3, dtype=torch.cfloat)
        rows[number] = torch.tensor([1, -1, -1j])
        relation.append(rows)
    of_entity_dims = torch.cat(entity, dim=1)
    more_of_relations = torch.cat(relation, dim=1)
    dims = {
        "entity_real": of_entity_dims.real,
        "entity_imag": of_entity_dims.imag,
        "relation_real": more_of_relations.real,
        "relation_imag": more_of_relations.imag,
    }
    return {name: torch.cat([embeddings[name], part], dim=1) for name, part in dims.items()}


# --- ComplEx --------------------------------------------------------------------------------------


class MatmulComplExInteraction(ComplExInteraction):
    """ComplEx score function for PyKEEN that scores many candidates by one real matrix product."""

    def forward(self, h: torch.Tensor, r: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        """Score triples, ``Re<h, r, conj(t)>``, the real part of the sum over dimensions.

        Args:
            h: shape: ``(*batch, d)``, complex. Head embeddings.
            r: shape: ``(*batch, d)``, complex. Relation embeddings.
            t: shape: ``(*batch, d)``, complex. Tail embeddings.

        Returns:
            shape: ``batch``, float. The batch dimensions broadcast. If heads or tails have shape
            (1, N, d) and the others (B, 1, d), the (B, N) scores cost one real matrix product.
        """
        if _is_all(t) and _is_one(h) and _is_one(r):
            return real_dot((h * r).squeeze(dim=1), t.squeeze(dim=0))
        # Re(h r conj(t)) = Re((conj(r) t) conj(h)): the number and its conjugate have equal real
        # parts.
        if _is_all(h) and _is_one(r) and _is_one(t):
            return real_dot((r.conj() * t).squeeze(dim=1), h.squeeze(dim=0))
        # Two factors first again: the plain formula avoids PyKEEN's search for an einsum path.
        products = h * r * t.conj()
        return torch.real(products).sum(dim=-1)


def _is_all(x: torch.Tensor) -> bool:
    """Return whether a tensor holds candidates, the same for all queries: shape (1, N, d)."""
    return x.ndim == 3 and x.shape[0] == 1


def _is_one(x: torch.Tensor) -> bool:
    """Return whether a tensor has a single row for each query: shape (B, 1, d)."""
    return x.ndim == 3 and x.shape[1] == 1


def complex_model(factory: TriplesFactory, config: ComplExConfig) -> ERModel:
    """Return ComplEx with cross entropy and the N3 regulariser (sum of cubed moduli).

    Entities and relations have complex embeddings, shapes (E, d) and (R, d); the regulariser of a
    batch is ``n3 * mean_b Σ_d (|h|³ + |r|³ + |t|³)``. From PyKEEN's standard normal, the model does
    not learn: initial embeddings are smaller.

    Args:
        factory: training triples.
        config: dimensions, scale of the initial embeddings, weight of N3 and seed.

    Source: Trouillon et al. 2016 (model), Lacroix et al. 2018 (objective), Jiang et al. 2020
    (dimension).
    """
    embedding = {
        "shape": config.dim,
        "dtype": torch.cfloat,
        "initializer": "normal",
        "initializer_kwargs": {"std": config.init_scale},
    }
    if config.n3:
        # The power sum without a root: cubed moduli, summed over dimensions.
        weights = {"weight": config.n3, "p": 3.0, "normalize": False}
        embedding |= {"regularizer": PowerSumRegularizer, "regularizer_kwargs": weights}
    return ERModel(
        triples_factory=factory,
        interaction=MatmulComplExInteraction,
        entity_representations_kwargs=embedding,
        relation_representations_kwargs=embedding,
        # The mean over the batch, so that the learning rate does not depend on its size.
        loss=CrossEntropyLoss(reduction="mean"),
        random_seed=config.seed,
    )
