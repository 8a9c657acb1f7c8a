"""Scorers and policies.

Read ``model`` first (what a trained model is), then ``model_folder``, which opens any model folder
and writes one for a scorer of your own. :mod:`~wordcraft_kg.models.scorers` score triples,
:mod:`~wordcraft_kg.models.links` and :mod:`~wordcraft_kg.models.recipes` train scorers,
:mod:`~wordcraft_kg.models.knowledge` holds knowledge from outside the recipe book, and
:mod:`~wordcraft_kg.models.policies` choose an agent's actions with the help of scores. Links,
recipes and policies import scorers and knowledge, but never one another.

A new kind of model is a line of ``MODELS`` in ``model_folder``, or an entry point
``wordcraft_kg.models`` of another distribution; nothing else needs to change.

Importing this package imports neither torch nor PyKEEN, but registers our ComplEx with PyKEEN:
``pykeen.pipeline.pipeline(model="ComplExN3", training_loop="IndexedSymmetricLCWA", ...)`` then
works by name.
"""

from importlib import import_module

from wrapt import register_post_import_hook

# Two modules, because PyKEEN imports its models while its training package is still half imported;
# so the module of ComplEx must not import that package.
register_post_import_hook(
    lambda _: import_module("wordcraft_kg.models.links.complex"), "pykeen.models"
)
register_post_import_hook(
    lambda _: import_module("wordcraft_kg.models.links.symmetric_lcwa"), "pykeen.training"
)
