"""Names of the environments in gymnasium's registry; importing this imports neither torch nor the environments."""

GRAPH = "everyday"
"""The book that is played if no graph is named."""


def register() -> None:
    """Register the environments, once."""
    from gymnasium.envs.registration import register, registry

    if "WordCraft-v0" not in registry:
        register(
            "WordCraft-v0",
            entry_point="wordcraft_kg.envs.wordcraft:WordCraftEnv",
            vector_entry_point="wordcraft_kg.envs.vector:WordCraftVectorEnv",
            kwargs={"graph": GRAPH},
        )
        register(
            "WordCraft-OpenEnded-v0",
            entry_point="wordcraft_kg.envs.open_ended:OpenEndedEnv",
            kwargs={"graph": GRAPH},
        )
