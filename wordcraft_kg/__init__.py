"""Knowledge graphs of crafting worlds, and agents that use them.

The recipe graph is the central object: read a recipe book with :func:`wordcraft_kg.graphs.read_book`, turn it into a
:class:`wordcraft_kg.graphs.RecipeGraph`, and derive triples, splits, scorers and tasks from it. Importing this package
or :mod:`wordcraft_kg.graphs` imports neither torch nor PyKEEN.
"""

from importlib.metadata import version as _version

from wrapt import register_post_import_hook as _after_import

__version__ = _version("wordcraft-kg")


def _register_environments(_: object) -> None:
    from wordcraft_kg.envs.registration import register

    register()


# gymnasium knows the environments by name as soon as both are imported, in either order; we need not import it here.
_after_import(_register_environments, "gymnasium.envs.registration")
