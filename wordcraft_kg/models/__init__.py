"""Scorers and policies.

:mod:`~wordcraft_kg.models.scorers` score triples, :mod:`~wordcraft_kg.models.links` and
:mod:`~wordcraft_kg.models.recipes` train scorers, and :mod:`~wordcraft_kg.models.policies` choose an agent's actions
with the help of these scores. All packages import scorers, but never one another. ``folder`` opens any trained model.

Importing this package imports neither torch nor PyKEEN, but registers our ComplEx with PyKEEN:
``pykeen.pipeline.pipeline(model="ComplExN3", training_loop="IndexedSymmetricLCWA", ...)`` then works by name.
"""

from importlib import import_module

from wrapt import register_post_import_hook

# Two hooks, because PyKEEN imports its models while its training package is still half imported.
register_post_import_hook(
    lambda _: import_module("wordcraft_kg.models.links.complex"), "pykeen.models"
)
register_post_import_hook(
    lambda _: import_module("wordcraft_kg.models.links.symmetric_lcwa"), "pykeen.training"
)
