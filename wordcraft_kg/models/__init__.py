"""Models that score links, and models that decide.

Four packages: :mod:`~wordcraft_kg.models.scorers` say how plausible a triple is, :mod:`~wordcraft_kg.models.links` and
:mod:`~wordcraft_kg.models.recipes` train scorers, of links and of recipes, and :mod:`~wordcraft_kg.models.policies`
decide, with scores mixed in. The last three use scorers, but not each other. ``folder`` opens any trained model.

Importing this package imports neither torch nor PyKEEN, yet it makes our ComplEx known to PyKEEN: from then on
``pykeen.pipeline.pipeline(model="ComplExN3", training_loop="IndexedSymmetricLCWA", ...)`` works by name, because the
registration runs when PyKEEN's own modules are imported, before or after this one.
"""

from importlib import import_module

from wrapt import register_post_import_hook

# Two hooks, because PyKEEN imports its models while its training package is still half imported.
register_post_import_hook(lambda _: import_module("wordcraft_kg.models.links.complex"), "pykeen.models")
register_post_import_hook(lambda _: import_module("wordcraft_kg.models.links.symmetric_lcwa"), "pykeen.training")
