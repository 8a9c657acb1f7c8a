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
    from wordcraft_kg.agents.agent_folder import open_agent as open_agent
    from wordcraft_kg.agents.config import AgentConfig as AgentConfig
    from wordcraft_kg.agents.config import ImpalaConfig as ImpalaConfig
    from wordcraft_kg.agents.config import TaskConfig as TaskConfig
    from wordcraft_kg.agents.evaluation import evaluate as evaluate
    from wordcraft_kg.agents.training import train_agent as train_agent
    from wordcraft_kg.envs.config import WordCraftConfig as WordCraftConfig
    from wordcraft_kg.envs.world import World as World
    from wordcraft_kg.graphs.folder import open_graph as open_graph
    from wordcraft_kg.graphs.library import open_book as open_book
    from wordcraft_kg.graphs.recipe_graph import RecipeGraph as RecipeGraph
    from wordcraft_kg.graphs.splits import SplitConfig as SplitConfig
    from wordcraft_kg.graphs.splits import make_split as make_split
    from wordcraft_kg.models.folder import open_model as open_model
    from wordcraft_kg.models.links.config import ComplExConfig as ComplExConfig
    from wordcraft_kg.models.links.config import LinkModelConfig as LinkModelConfig
    from wordcraft_kg.models.links.config import LinksConfig as LinksConfig
    from wordcraft_kg.models.links.pykeen_import import from_pykeen as from_pykeen
    from wordcraft_kg.models.links.training import train_links as train_links
    from wordcraft_kg.models.policies.config import PolicyConfig as PolicyConfig
    from wordcraft_kg.models.policies.folder import load_policy as load_policy
    from wordcraft_kg.models.policies.folder import save_policy as save_policy
    from wordcraft_kg.models.policies.sources.registry import make_sources as make_sources
    from wordcraft_kg.models.recipes.config import RecipesConfig as RecipesConfig
    from wordcraft_kg.models.recipes.config import RecipeScorerConfig as RecipeScorerConfig
    from wordcraft_kg.models.recipes.training import train_recipes as train_recipes
    from wordcraft_kg.models.saving import save_scorer as save_scorer
    from wordcraft_kg.models.scorers.cross_fitting import cross_fit as cross_fit
    from wordcraft_kg.models.scorers.folder import load_scorer as load_scorer
    from wordcraft_kg.runs.trackers import Tracker as Tracker
    from wordcraft_kg.studies.engine import run_study as run_study
    from wordcraft_kg.studies.study import Study as Study
    from wordcraft_kg.studies.study import read_study as read_study

__version__ = _version("wordcraft-kg")

_NAMES = {
    "agents.agent_folder": "open_agent",
    "agents.config": "AgentConfig ImpalaConfig TaskConfig",
    "agents.evaluation": "evaluate",
    "agents.training": "train_agent",
    "envs.config": "WordCraftConfig",
    "envs.world": "World",
    "graphs.folder": "open_graph",
    "graphs.library": "open_book",
    "graphs.recipe_graph": "RecipeGraph",
    "graphs.splits": "SplitConfig make_split",
    "models.folder": "open_model",
    "models.links.config": "ComplExConfig LinkModelConfig LinksConfig",
    "models.links.pykeen_import": "from_pykeen",
    "models.links.training": "train_links",
    "models.policies.config": "PolicyConfig",
    "models.policies.folder": "load_policy save_policy",
    "models.policies.sources.registry": "make_sources",
    "models.recipes.config": "RecipesConfig RecipeScorerConfig",
    "models.recipes.training": "train_recipes",
    "models.saving": "save_scorer",
    "models.scorers.cross_fitting": "cross_fit",
    "models.scorers.folder": "load_scorer",
    "runs.trackers": "Tracker",
    "studies.engine": "run_study",
    "studies.study": "Study read_study",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [*_MODULES]


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
    return [*_MODULES, "__version__"]


def _register_environments(_: object) -> None:
    from wordcraft_kg.envs import register

    register()


# gymnasium knows the environments by name as soon as both are imported, in either order; we need not import it here.
_after_import(_register_environments, "gymnasium.envs.registration")
