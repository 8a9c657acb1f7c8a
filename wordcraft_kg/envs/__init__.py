"""Environments: the readable crafting environment, the batched engine, the open-ended game, and wrappers.

Read ``wordcraft`` first: the rules, one environment at a time. ``batch`` steps many environments at once and agrees
with ``wordcraft`` step for step. Observations are ids and masks; wrappers or the policy add features and scores. A
``World`` holds the recipe graph, the split into train, valid and test recipes, the settings and the tasks: build one
``World``, and derive other settings with ``world.variant(part="test")``.
"""


def register() -> None:
    """Register the environments with Gymnasium, if not done yet; the default graph is the book ``everyday``."""
    from gymnasium.envs.registration import register, registry

    if "WordCraft-v0" not in registry:
        path, book = "wordcraft_kg.envs", {"graph": "everyday"}
        vector = f"{path}.vector:WordCraftVectorEnv"
        register(
            "WordCraft-v0", f"{path}.wordcraft:WordCraftEnv", vector_entry_point=vector, kwargs=book
        )
        register("WordCraft-OpenEnded-v0", f"{path}.open_ended:OpenEndedEnv", kwargs=book)
