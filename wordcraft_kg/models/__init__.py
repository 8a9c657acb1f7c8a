"""What scores links of a recipe graph: ComplEx and other link predictors, scorers, and their evaluation.

Importing this package imports neither torch nor PyKEEN. It makes our ComplEx known to PyKEEN all the same: from then on
``pykeen.pipeline.pipeline(model="ComplExN3", training_loop="IndexedSymmetricLCWA", ...)`` works by name, because the
registration runs when PyKEEN's own modules are imported, before or after this one.
"""

from importlib import import_module
from typing import Any

from wrapt import register_post_import_hook

_HOME = {
    "ComplExConfig": "link_config",
    "ComplExN3": "complex",
    "FrequencyScorer": "scorers",
    "LinkModelConfig": "link_config",
    "NeighbourScorer": "scorers",
    "SymbolicScorer": "scorers",
    "TableScorer": "scorers",
    "load_scorer": "scorers",
    "rank_triples": "link_prediction",
    "ranking_metrics": "link_prediction",
    "train_links": "link_training",
}
__all__ = sorted(_HOME)

# Two hooks, because PyKEEN imports its models while its training package is still half imported.
register_post_import_hook(lambda _: import_module("wordcraft_kg.models.complex"), "pykeen.models")
register_post_import_hook(lambda _: import_module("wordcraft_kg.models.symmetric_lcwa"), "pykeen.training")


def __getattr__(name: str) -> Any:
    """Import the public names late, so that a scorer loads without PyKEEN."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
