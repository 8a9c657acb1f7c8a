"""Knowledge graphs of crafting worlds, and agents that use them.

What most users need can be imported from here, and each of these names has an example. ``open_...``
opens something on disk with everything that belongs to it, ``load_...`` loads one thing that
computes, ``train_...`` takes a configuration and a folder::

    opened = open_graph("everyday")
    train_links(LinksConfig("everyday"), "models/everyday")
    train_agent(AgentConfig("everyday", "models/everyday"), "runs/guided")
    evaluate(load_policy("runs/guided"), "everyday", num_distractors=8).metrics()

Importing this package imports neither torch nor PyKEEN; a name imports what it needs when it is
first used.
"""

from importlib.metadata import version as _version

from lazy_loader import attach_stub as _attach_stub
from wrapt import register_post_import_hook as _after_import

__version__ = _version("wordcraft-kg")

# The stub beside this file, __init__.pyi, is the one list of public names.
_import_public, _, __all__ = _attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    try:
        return _import_public(name)
    except ModuleNotFoundError as error:
        from wordcraft_kg.base.extras import missing_package

        raise missing_package(name, error) from error


def __dir__() -> list[str]:
    """List the public names, for completion."""
    return [*__all__, "__version__"]


def _register_environments(_: object) -> None:
    from wordcraft_kg.envs import register

    register()


# gymnasium knows the environments by name as soon as both are imported, in either order; we need
# not import it here.
_after_import(_register_environments, "gymnasium.envs.registration")
