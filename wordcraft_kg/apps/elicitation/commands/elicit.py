"""``wordcraft-kg elicit``."""

from pathlib import Path

from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Output, aligned, command_line
from wordcraft_kg.cli.options import Force, Graph

GROUP = "Knowledge from outside the book"
EXAMPLES = (
    "wordcraft-kg elicit graphs/mine --model HuggingFaceTB/SmolLM2-135M-Instruct --out "
    "knowledge/lm",
    "wordcraft-kg elicit graphs/mine --model models/small.gguf --random-weights 0 --out "
    "knowledge/control",
)


def elicit(
    graph: Graph,
    *,
    model: str,
    prompts: Path | None = None,
    random_weights: int | None = None,
    out: Path = Path("knowledge/lm"),
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Elicit which entities need, make or go with which from a language model's probabilities.

    The model reads one short text for each entity and prompt, and generates nothing. The same
    command continues an interrupted run.

    Args:
        model: model folder, .gguf file, or a name on the Hugging Face hub.
        prompts: JSON file with prompts. Default: 13 prompts; the output folder has them as
            prompts.json.
        random_weights: seed for random weights in the same architecture, as a control. Default: the
            model's weights.
        out: folder to write.
    """
    from wordcraft_kg.apps.elicitation.prompts import DEFAULT, read_prompts
    from wordcraft_kg.graphs.folder import open_graph

    if random_weights is not None:
        whole("random_weights", random_weights, 0)
    prompt_texts = read_prompts(prompts or DEFAULT)
    recipes = open_graph(graph).graph
    check_output(out, force=force)
    check_extra("text")
    from wordcraft_kg.apps.elicitation.language_model import (
        elicit_knowledge,
        open_language_model,
        strongest,
    )
    from wordcraft_kg.apps.elicitation.weights import locate_model

    language_model = open_language_model(locate_model("model", model), random_weights)
    progress = output.progress("reading texts", unit="text")
    knowledge = elicit_knowledge(
        out, recipes, language_model, prompt_texts, report=progress, force=force
    )
    shown = strongest(knowledge)
    text = aligned((name, "; ".join(phrases)) for name, phrases in shown.items())
    values = {
        "out": str(out),
        "entities": recipes.num_entities,
        "tables": shown,
        "weights": language_model.hashes,
    }
    following = command_line("train-recipes", graph, "--with", out)
    output.result(values, [*text, f"wrote {out}/   next: {following}"])
