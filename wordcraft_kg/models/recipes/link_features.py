"""What recipes say about a link that none of them gives: the input of the link ranker.

All of these are sums over recipes or links, weighted by how alike entities are; each generalises in its own way, and
which of them to trust for which relation is what the ranker learns.
"""

import torch
from torch import Tensor

from wordcraft_kg.models.recipes.base import Base
from wordcraft_kg.models.scorers.pair_features import FLOOR


def link_features(base: Base) -> tuple[Tensor, Tensor]:
    """Return the features of all combinesWith and componentOf links, shapes (E, E, F), row = head.

    Those of combinesWith are symmetric, as the relation is.
    """
    return torch.stack(_of_pairs(base), dim=-1), torch.stack(_of_parts(base), dim=-1)


def _of_pairs(base: Base) -> list[Tensor]:
    combines, similar = base.combines, _to_others(base.structure)
    made = base.components.sum(0).log1p()
    degree = combines.sum(1).log1p()
    return [
        base.pairs,
        _log(base.completed),
        _log(_symmetric(similar @ combines)),
        _log(_symmetric(similar**3 @ combines)),
        _log(_symmetric(_to_others(base.words_like) @ combines)),
        _log(_symmetric(base.alike[:, base.first] @ base.alike[:, base.second].T)),
        _log(_symmetric(base.words_like[:, base.first] @ base.words_like[:, base.second].T)),
        base.text,
        base.kernel,
        degree[:, None] + degree,
        (degree[:, None] - degree).abs(),
        made[:, None] + made,
        torch.eye(len(combines)),
        torch.diag((base.alike @ combines.diagonal()) / base.alike[:, base.seen].sum(1).clamp(min=FLOOR)),
    ]


def _of_parts(base: Base) -> list[Tensor]:
    components, similar, words = base.components, _to_others(base.structure), _to_others(base.words_like)
    used, made = components.sum(1).log1p(), components.sum(0).log1p()
    ingredient = base.alike[:, base.first] + base.alike[:, base.second]
    by_words = base.words_like[:, base.first] + base.words_like[:, base.second]
    result = base.alike[:, base.result]
    shape = components.shape
    return [
        base.parts,
        _log(similar @ components),
        _log(similar**3 @ components),
        _log(components @ similar),
        _log(components @ similar**3),
        _log(words @ components),
        _log(components @ words),
        _log(ingredient @ result.T),
        _log(by_words @ base.words_like[:, base.result].T),
        base.text,
        base.kernel,
        _log(base.combines @ components),
        _log(components @ components),
        base.combines,
        used[:, None].expand(shape),
        used.expand(shape),
        made[:, None].expand(shape),
        made.expand(shape),
    ]


def _log(sums: Tensor) -> Tensor:
    return (sums.clamp(min=0) + FLOOR).log()


def _symmetric(table: Tensor) -> Tensor:
    return table + table.T


def _to_others(similarity: Tensor) -> Tensor:
    """Return how alike different entities are."""
    return similarity - torch.diag(similarity.diagonal())
