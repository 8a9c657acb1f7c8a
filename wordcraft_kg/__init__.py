"""Knowledge graphs of crafting worlds, and agents that use them.

What most users need can be imported from here, and each of these names has an example. ``open_...`` opens something on
disk with everything that belongs to it, ``load_...`` loads one thing that computes, ``train_...`` takes a configuration
and a folder::

    opened = open_graph("everyday")
    train_links(LinksConfig("everyday"), "models/everyday")
    train_agent(AgentConfig("everyday", "models/everyday"), "runs/guided")
    evaluate(load_policy("runs/guided"), "everyday", num_distractors=8).figures()

Importing this package imports neither torch nor PyKEEN; a name imports what it needs when it is first used.
"""

from importlib import import_module as _import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING

from wrapt import register_post_import_hook as _after_import

if TYPE_CHECKING:
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
    from wordcraft_kg.agents.evaluation import evaluate
    from wordcraft_kg.agents.training import train_agent
    from wordcraft_kg.envs.config import WordCraftConfig
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.graphs.library import open_book
    from wordcraft_kg.graphs.recipe_graph import RecipeGraph
    from wordcraft_kg.graphs.splits import SplitConfig, make_split
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig, LinksConfig
    from wordcraft_kg.models.links.pykeen_import import from_pykeen
    from wordcraft_kg.models.links.training import train_links
    from wordcraft_kg.models.policies.config import PolicyConfig
    from wordcraft_kg.models.policies.folder import load_policy, save_policy
    from wordcraft_kg.models.policies.sources.registry import make_sources
    from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
    from wordcraft_kg.models.recipes.training import train_recipes
    from wordcraft_kg.models.saving import save_scorer
    from wordcraft_kg.models.scorers.cross_fitting import cross_fit
    from wordcraft_kg.models.scorers.folder import load_scorer
    from wordcraft_kg.runs.trackers import Tracker
    from wordcraft_kg.studies.engine import run_study
    from wordcraft_kg.studies.study import Study, read_study

__version__ = _version("wordcraft-kg")

_MODULES = {
    "AgentConfig": "agents.config",
    "ComplExConfig": "models.links.config",
    "ImpalaConfig": "agents.config",
    "LinkModelConfig": "models.links.config",
    "LinksConfig": "models.links.config",
    "PolicyConfig": "models.policies.config",
    "RecipeGraph": "graphs.recipe_graph",
    "RecipesConfig": "models.recipes.config",
    "RecipeScorerConfig": "models.recipes.config",
    "SplitConfig": "graphs.splits",
    "Study": "studies.study",
    "TaskConfig": "agents.config",
    "Tracker": "runs.trackers",
    "WordCraftConfig": "envs.config",
    "World": "envs.world",
    "cross_fit": "models.scorers.cross_fitting",
    "evaluate": "agents.evaluation",
    "from_pykeen": "models.links.pykeen_import",
    "load_policy": "models.policies.folder",
    "load_scorer": "models.scorers.folder",
    "make_sources": "models.policies.sources.registry",
    "make_split": "graphs.splits",
    "open_agent": "agents.agent_folder",
    "open_book": "graphs.library",
    "open_graph": "graphs.folder",
    "open_model": "models.folder",
    "read_study": "studies.study",
    "run_study": "studies.engine",
    "save_policy": "models.policies.folder",
    "save_scorer": "models.saving",
    "train_agent": "agents.training",
    "train_links": "models.links.training",
    "train_recipes": "models.recipes.training",
}

__all__ = [
    "AgentConfig",
    "ComplExConfig",
    "ImpalaConfig",
    "LinkModelConfig",
    "LinksConfig",
    "PolicyConfig",
    "RecipeGraph",
    "RecipeScorerConfig",
    "RecipesConfig",
    "SplitConfig",
    "Study",
    "TaskConfig",
    "Tracker",
    "WordCraftConfig",
    "World",
    "cross_fit",
    "evaluate",
    "from_pykeen",
    "load_policy",
    "load_scorer",
    "make_sources",
    "make_split",
    "open_agent",
    "open_book",
    "open_graph",
    "open_model",
    "read_study",
    "run_study",
    "save_policy",
    "save_scorer",
    "train_agent",
    "train_links",
    "train_recipes",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)
    except ModuleNotFoundError as error:
        from wordcraft_kg.base.extras import missing_package

        raise missing_package(name, error) from error


def __dir__() -> list[str]:
    """List the public names, for completion."""
    return [*__all__, "__version__"]


def _register_environments(_: object) -> None:
    from wordcraft_kg.envs import register

    register()


# gymnasium knows the environments by name as soon as both are imported, in either order; we need not import it here.
_after_import(_register_environments, "gymnasium.envs.registration")
