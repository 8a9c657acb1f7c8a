"""ComplEx as a PyKEEN model with the paper's regulariser and one matrix product for all candidates.

PyKEEN's interaction contracts head, relation and tail from left to right, which builds a (batch,
entities, dim) tensor when heads are scored. Here the two known factors are multiplied first, so all
candidates of a batch cost one product of (B, 2 d) and (2 d, E) real matrices, for heads and for
tails.

Shapes: B queries, N candidates, d complex dimensions, E entities.

The page docs/evidence/links.md#complex measures the model.
"""

import torch
from pykeen.losses import CrossEntropyLoss
from pykeen.models import ERModel
from pykeen.nn.modules import ComplExInteraction
from pykeen.regularizers import PowerSumRegularizer
from pykeen.triples import TriplesFactory

from wordcraft_kg.models.links.link_config import ComplExConfig
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
