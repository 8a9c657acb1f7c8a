"""Stored recipe knowledge: its tensors and their check, copies with other parts, and lists.

Compiled loops check no bounds, so a file from anywhere must not reach them unchecked. They read and
write arrays that follow from the stored ones (:mod:`.lists`), and rely on these facts:

- word vectors and neighbours by words have a row for each of T entities;
- the E own entities come first, and E is not above T: ids on tables, goals and keys are below E;
- recipes hold ids from 0 to T - 1, neighbours by words from -1, the end of a list, to T - 1;
- types are those that the loops are compiled for;
- all numbers are finite, and word vectors have length 1 at most, so that no score is NaN.

Everything else that loops rely on, :func:`~.lists.make_lists` makes of these: recipes in ascending
order with the smaller ingredient first, lists by similarity with -1 at their end, starts that
ascend, hash tables of which a quarter is filled at most, and signatures as long as the book.
:meth:`StoredKnowledge.ids` checks the ids of tables, goals and keys.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from torch import Tensor, nn

from wordcraft_kg.base.tensors import check_tensors, largest, torch_threads
from wordcraft_kg.graphs import RELATIONS, Ids
from wordcraft_kg.models.scorers.neighbours.links import LINK_FEATURES, OF_COMBINES, OF_COMPONENTS
from wordcraft_kg.models.scorers.neighbours.lists import Lists, make_lists
from wordcraft_kg.models.scorers.neighbours.pair_encoder import ENCODER, PairEncoder
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES, OF_ENCODER
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

LINK_TABLES = tuple(f"{relation}_table" for relation in RELATIONS)
"""Names of the tables of link scores."""
_LONGEST = 1.001
"""Largest number in a word vector of length 1, rounded to half precision."""


def _ranker_axes(prefix: str, features: str) -> dict[str, str]:
    """Return axis names and types of a ranker's weights, whose names begin with ``prefix``."""
    return {
        f"{prefix}first": f"models {features} {prefix}hidden float32",
        f"{prefix}first_bias": f"models {prefix}hidden float32",
        f"{prefix}second": f"models {prefix}hidden float32",
        f"{prefix}bias": "models float32",
    }


# Axis names and types of the stored tensors, for `check_tensors`. Entities come first, as they set
# the sizes.
_LAYOUTS = {
    "num_own": "one int32",
    "vectors": "T D float16",
    "near_words": "T K int32",
    "recipes": "recipes three int32",
    "seen": "models recipes bool",
    **_ranker_axes("", "features"),
    **_ranker_axes("combinesWith_", "pairs"),
    **_ranker_axes("componentOf_", "parts"),
    **dict.fromkeys(LINK_TABLES, "models side side float16"),
}
# Of further tensors in a model with a pair encoder: the encoder, and the ranker of `.results`.
_OF_ENCODER = {
    "encoder_used": "models T U float16",
    "encoder_made": "models T Z float16",
    "encoder_bias": "models T float32",
    "encoder_first": "models inputs V float32",
    "encoder_first_bias": "models V float32",
    "encoder_second": "models V Z float32",
    "encoder_second_bias": "models Z float32",
    "encoder_pair": "models V float32",
    "encoder_pair_bias": "models float32",
    "encoder_used_words": "models D U float32",
    "encoder_used_bias": "models U float32",
    "encoder_made_words": "models D Z float32",
    "encoder_made_bias": "models Z float32",
    "encoder_bias_words": "models D float32",
    "encoder_bias_base": "models float32",
    **_ranker_axes("results_", "features"),
}


def _layouts(names: Collection[str]) -> dict[str, str]:
    """Return the layouts of all tensors of a model: more if any name is that of an encoder."""
    return _LAYOUTS if _OF_ENCODER.keys().isdisjoint(names) else _LAYOUTS | _OF_ENCODER


def num_features(*, has_encoder: bool) -> int:
    """Return the number of features of a pair and a goal."""
    return len(FEATURES) + (len(OF_ENCODER) if has_encoder else 0)


def check_stored(
    constants: Mapping[str, Tensor],
    num_entities: int,
    num_models: int | None = None,
) -> None:
    """Check that stored tensors are safe for compiled loops, as the module says.

    Args:
        constants: the tensors by name, as found, perhaps damaged.
        num_entities: E, which the tensors must agree with.
        num_models: M likewise; None for any number.

    Raises:
        KeyError: if a tensor is missing.
        ValueError: if a tensor has another type or shape, or holds an id or number out of range.
    """
    layouts = _layouts(constants)
    has_encoder = ENCODER[0] in layouts
    sizes = {
        "one": 1,
        "three": 3,
        "features": num_features(has_encoder=has_encoder),
        "pairs": len(OF_COMBINES),
        "parts": len(OF_COMPONENTS),
        # Tables of link scores, or none.
        "side": num_entities if constants[LINK_TABLES[0]].numel() else 0,
    }
    if num_models is not None:
        sizes["models"] = num_models
    if has_encoder:
        # A pair has the sum, the product and the distance of two vectors.
        sizes["inputs"] = 3 * (constants["encoder_used"].shape or [0])[-1]
    check_tensors(constants, layouts, **sizes)
    num_own = int(constants["num_own"])
    if num_own != num_entities:
        raise ValueError(f"num_own is {num_own}; expected {num_entities}, the number of entities")
    size = len(constants["vectors"])
    if size < num_entities:
        raise ValueError(
            f"vectors has {size} rows; expected one for each of {num_entities} entities"
        )
    if largest(constants["vectors"]) > _LONGEST:
        raise ValueError("vectors holds numbers above 1; expected vectors of length 1")
    _check_ids(constants, "recipes", 0, size)
    # -1 ends a list.
    _check_ids(constants, "near_words", -1, size)


def _check_ids(constants: Mapping[str, Tensor], name: str, low: int, size: int) -> None:
    ids = constants[name]
    if ids.numel() and not low <= int(ids.min()) <= int(ids.max()) < size:
        raise ValueError(f"{name} contains numbers outside {low} .. {size - 1}")


class StoredKnowledge(nn.Module):
    """Recipes, words and rankers, from which neighbour lists follow, for M models.

    The lists of a model are made when they are first needed, on the CPU, and are not stored: see
    the package for their mathematics and cost.

    Attributes:
        num_own: shape (1,), int32: E, so that a file tells which entities are its own.
        vectors: shape (T, D), half: unit word vectors; D is 0 without words. Entities from E on are
            those of other books, which are neither on tables nor goals.
        near_words: shape (T, K_w), int32: neighbours by words, -1 at the end.
        recipes: shape (n, 3), int32: training recipes of all models together.
        seen: shape (M, n), bool: training recipes of each model.
        num_entities: E, also the id of an empty slot.
        has_encoder: whether there is a pair encoder.
        bias: shape (M,), of the recipe rankers, whose other weights have the names in
            :data:`~wordcraft_kg.models.scorers.ranker.RANKER`.

    The link rankers' weights are buffers whose names begin with the relation, shaped as those of
    the recipe rankers. Where links have features from outside the recipes, tables of their
    scores stand for the rankers: buffers with the names in :data:`LINK_TABLES`, shape (M,
    E, E), half, row = head; (M, 0, 0) elsewhere.
    """

    num_entities: int
    bias: Tensor
    num_own: Tensor
    vectors: Tensor
    near_words: Tensor
    recipes: Tensor
    seen: Tensor
    results_second: Tensor

    def __init__(
        self,
        constants: Mapping[str, Tensor],
        num_entities: int | None = None,
        num_models: int | None = None,
    ):
        """Take the stored tensors by name, on which all loops rely.

        Args:
            constants: the tensors, perhaps from a damaged file.
            num_entities: E, which the tensors must agree with; None for the stored number.
            num_models: M likewise.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor does not fit, see :func:`check_stored`.
        """
        super().__init__()
        if num_entities is None:
            num_entities = int(constants["num_own"].sum())
        check_stored(constants, num_entities, num_models)
        self.num_entities = num_entities
        self._names = tuple(_layouts(constants))
        for name in self._names:
            self.register_buffer(name, constants[name])
        self.has_encoder = ENCODER[0] in self._names
        self._lists: dict[int, Lists] = {}
        self.register_load_state_dict_post_hook(_renew)

    @classmethod
    def of_recipes(
        cls,
        recipes: Ids,
        vectors: NDArray[np.float16],
        near_words: Any,
        link_rankers: Mapping[int, Ranker] = MappingProxyType({}),
        encoder: PairEncoder | None = None,
        lists: Lists | None = None,
    ) -> Self:
        """Return the knowledge of recipes for a single model without ranker.

        Args:
            recipes: training recipes, ids (n, 3).
            vectors: unit word vectors, shape (E, D), zeros for entities without words.
            near_words: neighbours by words, shape (E, K_w), int32, -1 at the end.
            link_rankers: by relation; scores are 0 without one.
            encoder: pair encoder of the same words; None without.
            lists: the recipes' lists, if they are made; else they are made when needed.
        """
        pair_ranker = Ranker.empty(num_features(has_encoder=encoder is not None))
        rows = torch.from_numpy(recipes.astype(np.int32))
        constants = {
            "num_own": torch.tensor([len(vectors)], dtype=torch.int32),
            "vectors": torch.from_numpy(vectors),
            "near_words": torch.from_numpy(near_words),
            "recipes": rows,
            "seen": torch.ones(1, len(rows), dtype=torch.bool),
            **named_weights(pair_ranker),
        }
        for number, relation in enumerate(RELATIONS):
            ranker = link_rankers.get(number) or Ranker.empty(len(LINK_FEATURES[number]))
            constants |= named_weights(ranker, f"{relation}_")
            constants[f"{relation}_table"] = torch.zeros(1, 0, 0, dtype=torch.half)
        if encoder is not None:
            constants |= named_weights(encoder, "encoder_")
            constants |= named_weights(pair_ranker, "results_")
        knowledge = cls(constants)
        knowledge._lists = {} if lists is None else {0: lists}
        return knowledge

    @classmethod
    def stacked(cls, models: Sequence[Self]) -> Self:
        """Combine single models' knowledge, M = 1 each, with the same entities, along axis M."""
        # Models of folds share most recipes: each is stored once, with a mask for each model.
        recipes = torch.cat([model.recipes for model in models])
        distinct, place = recipes.unique(dim=0, return_inverse=True)
        places = place.split([len(model.recipes) for model in models])
        seen = torch.zeros(len(models), len(distinct), dtype=torch.bool)
        for mask, rows, model in zip(seen, places, models, strict=True):
            mask[rows] = model.seen[0]
        constants = {
            "num_own": models[0].num_own,
            "vectors": models[0].vectors,
            "near_words": models[0].near_words,
            "recipes": distinct,
            "seen": seen,
        }
        # All others have a first axis of models.
        for name in models[0]._names:
            if name not in constants:
                constants[name] = torch.cat([getattr(model, name) for model in models])
        stack = cls(constants)
        # Lists that are made already serve the stack, too.
        stack._lists = {row: model._lists[0] for row, model in enumerate(models) if model._lists}
        return stack

    def with_tensors(self, tensors: dict[str, Tensor]) -> Self:
        """Return a copy with some stored tensors replaced, by name."""
        return type(self)(self.constants() | tensors)

    def with_ranker(self, ranker: Ranker, prefix: str = "") -> Self:
        """Return a copy with a single ranker; only for a single model, M = 1.

        Args:
            ranker: the ranker.
            prefix: empty for the ranker of recipes, ``results_`` for that of results.
        """
        return self.with_tensors(named_weights(ranker, prefix))

    def with_link_tables(self, tables: Mapping[int, Tensor]) -> Self:
        """Return a copy whose links are scored by tables; only for a single model, M = 1.

        Args:
            tables: scores by relation, shape (E, E) each, row = head.
        """
        # With a first axis for the single model.
        tensors_by_name = {
            f"{RELATIONS[key]}_table": table.half()[None] for key, table in tables.items()
        }
        return self.with_tensors(tensors_by_name)

    def of_entities(self, own: Tensor) -> Self:
        """Return the knowledge about the entities ``own``, ids (n,), which get the ids from 0.

        All other entities come last, and are no more than a source of knowledge.
        """
        is_other = torch.ones(self.num_entities, dtype=torch.bool)
        is_other[own] = False
        # The old id of each new one, and the new id of each old one.
        order = torch.cat([own, is_other.nonzero()[:, 0]])
        place = torch.argsort(order)
        near = self.near_words[order].long()
        # -1, the end of a list, stays.
        renumbered = torch.where(near < 0, near, place[near.clamp(min=0)])
        recipes = place[self.recipes.long()]
        # As in a graph, the smaller ingredient comes first.
        recipes[:, :2] = recipes[:, :2].sort(1).values
        tensors = {
            "num_own": torch.tensor([len(own)], dtype=torch.int32),
            "vectors": self.vectors[order],
            "near_words": renumbered.int(),
            "recipes": recipes.int(),
        }
        for name in LINK_TABLES:
            table = getattr(self, name)
            if table.numel():
                tensors[name] = table[:, own][:, :, own]
        return self.with_tensors(tensors)

    def constants(self) -> dict[str, Tensor]:
        """Return the stored tensors by name."""
        return {name: getattr(self, name) for name in self._names}

    @property
    def num_models(self) -> int:
        """Number of models M."""
        return len(self.bias)

    @property
    def has_result_ranker(self) -> bool:
        """Whether there is an encoder with a ranker of results; that of other books has none."""
        return self.has_encoder and bool(self.results_second.any())

    def ranker(self, prefix: str = "") -> Ranker:
        """Return the rankers of all models: of recipes, or those whose names have a prefix."""
        return Ranker(*(getattr(self, f"{prefix}{name}") for name in RANKER))

    def encoder(self, model: int = 0) -> PairEncoder:
        """Return a model's pair encoder; only if there is one."""
        return PairEncoder(*(getattr(self, name)[model] for name in ENCODER))

    def lists(self, model: int = 0) -> Lists:
        """Return a model's lists; made at the first call by one thread, so that none differ."""
        if model not in self._lists:
            recipes = self.recipes[self.seen[model]].cpu().numpy().astype(np.int64)
            near_words = self.near_words.cpu().numpy()
            earlier_lists = list(self._lists.values())
            # All models have the same words: their lists share one copy.
            vectors = (
                earlier_lists[0].vectors if earlier_lists else self.vectors.float().cpu().numpy()
            )
            with torch_threads(1), threadpool_limits(1):
                lists = make_lists(recipes, vectors, near_words)
            if earlier_lists:
                lists = lists._replace(cosines=earlier_lists[0].cosines)
            self._lists[model] = lists
        return self._lists[model]

    def share_lists(self, other: "StoredKnowledge") -> None:
        """Take lists from ``other``, now and later, if it has the same recipes and words.

        Copies, and sources of a restored policy, would make and keep the same lists otherwise.
        """
        names = ("vectors", "near_words", "recipes", "seen")
        if all(torch.equal(getattr(self, name), getattr(other, name)) for name in names):
            self._lists = other._lists

    def ids(self, entities: Tensor) -> Ids:
        """Return ids for compiled loops, which check no bounds: -1 for E, the empty slot.

        Raises:
            IndexError: for an id that is not 0 .. E.
        """
        ids = entities.cpu().numpy()
        if ids.size and not 0 <= ids.min() <= ids.max() <= self.num_entities:
            raise IndexError(f"entity ids must be 0 .. {self.num_entities}")
        return np.where(ids == self.num_entities, -1, ids)


def named_weights(network: Ranker | PairEncoder, prefix: str = "") -> dict[str, Tensor]:
    """Return a network's weights by prefixed name, with a first axis for a single model."""
    return {f"{prefix}{name}": weights[None] for name, weights in network._asdict().items()}


def _renew(knowledge: nn.Module, _: object) -> None:
    """Check tensors that were loaded, and drop lists that were made from other recipes."""
    assert isinstance(knowledge, StoredKnowledge)
    check_stored(knowledge.constants(), knowledge.num_entities)
    knowledge._lists = {}
