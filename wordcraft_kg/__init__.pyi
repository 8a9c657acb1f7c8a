# The public names, each where it lives: read by type checkers and, when the package is imported, by
# lazy_loader. To add a name, add a line, and an example of it to its docstring.

from .agents.agent_config import (
    AgentConfig as AgentConfig,
    ImpalaConfig as ImpalaConfig,
    TaskConfig as TaskConfig,
)
from .agents.agent_folder import open_agent as open_agent
from .agents.agent_training import train_agent as train_agent
from .agents.evaluation import evaluate as evaluate
from .base.registry import load_plugin as load_plugin
from .envs.world import World as World
from .envs.world_config import WordCraftConfig as WordCraftConfig
from .graphs.graph_folder import open_graph as open_graph, write_graph_folder as write_graph_folder
from .graphs.library import open_book as open_book
from .graphs.recipe_graph import RecipeGraph as RecipeGraph
from .graphs.splits import SplitConfig as SplitConfig, make_split as make_split
from .models.links.link_config import (
    ComplExConfig as ComplExConfig,
    LinkModelConfig as LinkModelConfig,
    LinksConfig as LinksConfig,
)
from .models.links.link_training import train_links as train_links
from .models.links.pykeen_bridge import from_pykeen as from_pykeen
from .models.model_folder import open_model as open_model, save_scorer as save_scorer
from .models.policies.policy_config import PolicyConfig as PolicyConfig
from .models.policies.policy_folder import load_policy as load_policy, save_policy as save_policy
from .models.policies.sources.registry import make_sources as make_sources
from .models.recipes.recipe_config import (
    RecipesConfig as RecipesConfig,
    RecipeScorerConfig as RecipeScorerConfig,
)
from .models.recipes.recipe_training import train_recipes as train_recipes
from .models.scorers.cross_fitting import cross_fit as cross_fit
from .models.scorers.scorer_folder import load_scorer as load_scorer
from .runs.trackers import Tracker as Tracker
from .studies.engine import run_study as run_study
from .studies.study import Study as Study, read_study as read_study

__version__: str
