"""``wordcraft-kg link-models``."""

from wordcraft_kg.cli.console import Output, aligned

EXAMPLES = ("wordcraft-kg link-models", "wordcraft-kg link-models --json")


def link_models(*, output: Output = Output()) -> None:
    """List the models that can be trained to predict links: the paper's ComplEx, and those of PyKEEN.

    Left out are PyKEEN's models that need more than triples, such as literals. The installed PyKEEN is asked.
    """
    from wordcraft_kg.evaluation.link_models import view_link_models

    view = view_link_models()
    output.result(view, aligned((model.name, f"wordcraft-kg {model.command}") for model in view.models))
