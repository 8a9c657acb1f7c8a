"""Knowledge graphs of crafting worlds, and agents that use them.

The recipe graph is the central object: read a recipe book with :func:`wordcraft_kg.graphs.read_book`, turn it into a
:class:`wordcraft_kg.graphs.RecipeGraph`, and derive triples, splits, scorers and tasks from it. Importing this package
or :mod:`wordcraft_kg.graphs` imports neither torch nor PyKEEN.
"""

from importlib.metadata import version as _version

__version__ = _version("wordcraft-kg")
