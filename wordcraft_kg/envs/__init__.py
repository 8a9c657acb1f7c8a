"""Environments: the batched engine, the crafting environment for Gymnasium, the open-ended game.

Read ``wordcraft`` first: its first class documents the rules, for one environment, and its second
class shows many to Gymnasium. ``batch`` computes them for one environment or many, on NumPy or
torch by ``arrays``; ``draws`` draws what its episodes begin with, and fixes the tables on which all
players are compared. A ``World`` (``world``) holds the recipe graph, the split into train, valid
and test recipes, the settings (``world_config``) and the tasks: build one ``World``, and derive
other settings with ``world.variant(part="test")``. Rewards and results of the part ``train`` come
from train recipes alone.

``open_ended`` is the game without a goal, ``words`` the games as text. Observations are ids and
masks; ``wrappers`` add scores.

Free to change: how ``batch`` computes, as long as the reference in the tests agrees and its speed
stays. Not free: what an episode with a given seed, environment and number looks like (``draws``),
because published results play on those tables; and ``words.PROMPTS``, whose hash is in results.
"""


def register() -> None:
    """Register the environments with Gymnasium, unless done; the default graph is ``everyday``.

    Apps add environments by entry points in the group ``wordcraft_kg.environments``: the name for
    ``gymnasium.make``, and ``module:class``, which is imported when one is made.
    """
    from importlib.metadata import entry_points

    from gymnasium.envs.registration import register, registry

    if "WordCraft-v0" in registry:
        return
    default = {"graph": "everyday"}
    register(
        "WordCraft-v0",
        "wordcraft_kg.envs.wordcraft:WordCraftEnv",
        vector_entry_point="wordcraft_kg.envs.wordcraft:WordCraftVectorEnv",
        kwargs=default,
    )
    register(
        "WordCraft-OpenEnded-v0",
        "wordcraft_kg.envs.open_ended:OpenEndedEnv",
        kwargs=default,
    )
    for point in entry_points(group="wordcraft_kg.environments"):
        register(point.name, point.value, kwargs=default)
