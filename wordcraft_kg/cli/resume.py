"""``wordcraft-kg resume``."""

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.options import Run

EXAMPLES = (
    "wordcraft-kg resume models/everyday",
    "wordcraft-kg resume models/everyday --epochs 100",
    "wordcraft-kg resume runs/no-kg",
)


def resume(run: Run, *, graph: str | None = None, epochs: int | None = None, output: Output = Output()) -> int:
    """Resume an interrupted training from its last checkpoint; on a CPU the result is bit-identical.

    Args:
        run: folder of the interrupted training of an agent or a link predictor.
        graph: where the graph is now, if it has moved.
        epochs: total number of epochs of a link predictor, in place of the number in its settings.
    """
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.cli.training import finished_without_report, report, report_agent
    from wordcraft_kg.models.recipes.config import RecipeScorerConfig
    from wordcraft_kg.runs.record import read_run

    if read_run(run).kind in AgentConfig.commands:
        from wordcraft_kg.agents.training import resume_agent

        if epochs is not None:
            raise ConfigError("--epochs is for link predictors; an agent trains for the steps in its settings.")
        if finished := finished_without_report(run):  # it was stopped while its report was written
            return report_agent(finished, graph, output)
        progress = output.progress("agent", unit="step")
        return report_agent(resume_agent(run, graph=graph, progress=progress), graph, output)
    if read_run(run).kind == RecipeScorerConfig.command:
        from wordcraft_kg.cli.training import report_recipes
        from wordcraft_kg.models.recipes.training import resume_recipes

        if epochs is not None:
            raise ConfigError("--epochs is for link predictors; a recipe scorer has none.")
        return report_recipes(resume_recipes(run, graph=graph, progress=output.progress("resumed", unit="fit")), output)
    from wordcraft_kg.models.links.training import resume_links

    return report(resume_links(run, graph=graph, epochs=epochs, progress=output.progress("resumed")), output)
