"""The stored tensors of recipe knowledge: their names, shapes and types, and the check of them.

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
:meth:`~.storage.StoredKnowledge.ids` checks the ids of tables, goals and keys.
"""

from collections.abc import Collection, Mapping

from torch import Tensor

from wordcraft_kg.base.tensors import check_tensors, largest
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.neighbours.links import OF_COMBINES, OF_COMPONENTS
from wordcraft_kg.models.scorers.neighbours.pair_encoder import ENCODER
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES, OF_ENCODER
from wordcraft_kg.models.scorers.ranker import RANKER

LINK_RANKERS = tuple(f"{relation}_{name}" for relation in RELATIONS for name in RANKER)
"""Names of the link rankers' weights."""
LINK_TABLES = tuple(f"{relation}_table" for relation in RELATIONS)
"""Names of the tables of link scores."""
BUFFERS = (
    "num_own",
    "vectors",
    "near_words",
    "recipes",
    "seen",
    *RANKER,
    *LINK_RANKERS,
    *LINK_TABLES,
)
"""Names of the stored tensors."""
RESULT_RANKER = tuple(f"results_{name}" for name in RANKER)
"""Names of the weights of the ranker of results, see :mod:`.results`."""
WITH_ENCODER = (*BUFFERS, *ENCODER, *RESULT_RANKER)
"""Names of the stored tensors of a model with a pair encoder."""
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


# Axis names and types, for `check_tensors`. Entities come first, as they set the sizes.
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


def stored_names(constants: Collection[str]) -> tuple[str, ...]:
    """Return the names that a model's tensors must have: more if any is that of an encoder."""
    return BUFFERS if set(constants).isdisjoint((*ENCODER, *RESULT_RANKER)) else WITH_ENCODER


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
    has_encoder = stored_names(constants) == WITH_ENCODER
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
    layouts = _LAYOUTS
    if has_encoder:
        layouts = _LAYOUTS | _OF_ENCODER
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
