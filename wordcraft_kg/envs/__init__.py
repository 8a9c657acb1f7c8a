"""The crafting worlds as environments: readable, batched, open-ended, and wrappers around them.

Read ``wordcraft`` first: the rules, one environment at a time. ``batch`` steps many at once and must agree with it step
for step. Observations are ids and masks; features and scores of knowledge are added by wrappers or looked up by the
policy. A ``World`` holds the graph, the split, the settings, the tasks and all that follows from them: build one, and
use ``world.variant(part="test")`` for another setting.
"""


def register() -> None:
    """Register the environments, once; without a graph they play the book ``everyday``."""
    from gymnasium.envs.registration import register, registry

    if "WordCraft-v0" not in registry:
        path, book = "wordcraft_kg.envs", {"graph": "everyday"}
        vector = f"{path}.vector:WordCraftVectorEnv"
        register("WordCraft-v0", f"{path}.wordcraft:WordCraftEnv", vector_entry_point=vector, kwargs=book)
        register("WordCraft-OpenEnded-v0", f"{path}.open_ended:OpenEndedEnv", kwargs=book)
