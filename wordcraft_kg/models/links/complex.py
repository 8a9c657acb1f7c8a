"""ComplEx as a PyKEEN model with the paper's regulariser and one matrix product for all candidates.

PyKEEN's interaction contracts head, relation and tail from left to right, which builds a (batch,
entities, dim) tensor when heads are scored. Here the two known factors are multiplied first, so all
candidates of a batch cost one product of (B, 2 d) and (2 d, E) real matrices, for heads and for
tails.

Shapes: B queries, N candidates, d complex dimensions, E entities.

The page docs/evidence/links.md#complex measures the model.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from pykeen.losses import CrossEntropyLoss, Loss
from pykeen.models import ERModel, model_resolver
from pykeen.nn.modules import ComplExInteraction, interaction_resolver
from pykeen.regularizers import PowerSumRegularizer

from wordcraft_kg.models.links.link_config import N3_PARTIAL, PAPER_DIM, ComplExConfig
from wordcraft_kg.models.scorers.factors import real_dot


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
            return _grid(h * r, t)
        # Re(h r conj(t)) = Re((conj(r) t) conj(h)): the number and its conjugate have equal real
        # parts.
        if _is_all(h) and _is_one(r) and _is_one(t):
            return _grid(r.conj() * t, h)
        # Two factors first again: the plain formula avoids PyKEEN's search for an einsum path.
        products = h * r * t.conj()
        return torch.real(products).sum(dim=-1)


def _grid(queries: torch.Tensor, candidates: torch.Tensor) -> torch.Tensor:
    """Return ``Re<q, conj(c)>`` of queries (B, 1, d) and candidates (1, N, d), shape (B, N)."""
    return real_dot(queries.squeeze(dim=1), candidates.squeeze(dim=0))


def _is_all(x: torch.Tensor) -> bool:
    """Return whether a tensor holds candidates, the same for all queries: shape (1, N, d)."""
    return x.ndim == 3 and x.shape[0] == 1


def _is_one(x: torch.Tensor) -> bool:
    """Return whether a tensor has a single row for each query: shape (B, 1, d)."""
    return x.ndim == 3 and x.shape[1] == 1


class ComplExN3(ERModel):
    """PyKEEN model: ComplEx with cross entropy and the N3 regulariser (sum of cubed moduli).

    Entities and relations have complex embeddings, shapes (E, d) and (R, d); the regulariser of a
    batch is ``weight * mean_b Σ_d (|h|³ + |r|³ + |t|³)``.

    PyKEEN's ``pipeline`` and ``hpo_pipeline`` accept ``model="ComplExN3"``. Train with
    ``training_loop="IndexedSymmetricLCWA"``, which regularises each looked-up factor once. PyKEEN's
    stock ``SymmetricLCWA`` looks up the batch and all entities twice and regularises both, so about
    half the ``regularizer_kwargs["weight"]`` has the same effect there.

    Attributes:
        hpo_default: range of the dimension for PyKEEN's ``hpo_pipeline``.
        loss_default: softmax cross entropy, the paper's objective.
        loss_default_kwargs: mean over the batch, so the learning rate does not depend on its size.
        regularizer_default: PyKEEN's power sum, which N3 is a case of.
        regularizer_default_kwargs: the weight, and p = 3 without a root: N3 sums the cubed moduli
            over dimensions and averages over the batch.

    Source: Trouillon et al. 2016 (model), Lacroix et al. 2018 (objective), Jiang et al. 2020
    (dimension).
    """

    hpo_default: ClassVar[Mapping[str, Any]] = {
        "embedding_dim": {"type": "int", "low": 32, "high": 256, "q": 32}
    }
    loss_default: ClassVar[type[Loss]] = CrossEntropyLoss
    loss_default_kwargs: ClassVar[Mapping[str, Any]] = {"reduction": "mean"}
    regularizer_default: ClassVar[type[PowerSumRegularizer]] = PowerSumRegularizer
    regularizer_default_kwargs: ClassVar[Mapping[str, Any]] = {
        "weight": N3_PARTIAL,
        "p": 3.0,
        "normalize": False,
    }

    def __init__(
        self,
        *,
        embedding_dim: int = PAPER_DIM,
        init_scale: float = ComplExConfig.init_scale,
        regularizer: Any = PowerSumRegularizer,
        regularizer_kwargs: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        """Set up embeddings and score function.

        Args:
            embedding_dim: number of complex dimensions d.
            init_scale: initial standard deviation of real and imaginary parts; from PyKEEN's
                standard normal, the model does not learn.
            regularizer: regulariser of each embedding that a batch looks up; None for none.
            regularizer_kwargs: its settings, which override the defaults key by key, so a weight
                alone is enough.
            kwargs: passed to :class:`pykeen.models.ERModel`.
        """
        # PyKEEN would replace the defaults as a whole, and a weight alone would lose p = 3.
        settings = {**self.regularizer_default_kwargs, **(regularizer_kwargs or {})}
        embedding = {
            "shape": embedding_dim,
            "dtype": torch.cfloat,
            "initializer": "normal",
            "initializer_kwargs": {"std": init_scale},
            "regularizer": regularizer,
            "regularizer_kwargs": settings if regularizer is not None else None,
        }
        super().__init__(
            interaction=MatmulComplExInteraction,
            entity_representations_kwargs=embedding,
            relation_representations_kwargs=embedding,
            **kwargs,
        )


# By name, for PyKEEN's pipeline; a second import finds the same classes.
interaction_resolver.register(MatmulComplExInteraction, raise_on_conflict=False)
model_resolver.register(ComplExN3, raise_on_conflict=False)
