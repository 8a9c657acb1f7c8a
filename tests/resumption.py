"""Resume a run as a program does: train into the folder again with the recorded settings."""

from dataclasses import replace


def resume(folder, *, graph=None, **options):
    """Train into a run folder again; ``graph`` is the present path of a moved graph."""
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.agents.training import train_agent
    from wordcraft_kg.models.links.config import LinksConfig
    from wordcraft_kg.models.links.training import train_links
    from wordcraft_kg.models.recipes.config import RecipesConfig
    from wordcraft_kg.models.recipes.training import train_recipes
    from wordcraft_kg.runs.record import read_run

    trainers = {AgentConfig: train_agent, LinksConfig: train_links, RecipesConfig: train_recipes}
    kind = read_run(folder).kind
    config_type, train = next(
        (config, train) for config, train in trainers.items() if kind in config.commands
    )
    config = config_type.read(folder)
    return train(replace(config, graph=graph or config.graph), folder, **options)


def recorded(monkeypatch, module, name):
    """Return a list that receives what a function is asked to fit: its third argument.

    A run that begins anew ends with the same bytes as one that goes on: what it fits tells them
    apart.
    """
    wanted = []
    function = getattr(module, name)

    def call(folds, words, missing, **others):
        wanted.extend(missing)
        return function(folds, words, missing, **others)

    monkeypatch.setattr(module, name, call)
    return wanted
