"""Scorers and policies.

Read ``model`` first (what a trained model is), then ``model_folder``, which opens any model folder
and writes one for a scorer of your own. :mod:`~wordcraft_kg.models.scorers` score triples,
:mod:`~wordcraft_kg.models.links` and :mod:`~wordcraft_kg.models.recipes` train scorers,
:mod:`~wordcraft_kg.models.knowledge` holds knowledge from outside the recipe book, and
:mod:`~wordcraft_kg.models.policies` choose an agent's actions with the help of scores. Links,
recipes and policies import scorers and knowledge, but never one another.

A new kind of model is a line of ``MODELS`` in ``model_folder``, or an entry point
``wordcraft_kg.models`` of another distribution; nothing else needs to change.

Importing this package imports neither torch nor PyKEEN.
"""
