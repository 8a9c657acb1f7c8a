"""``wordcraft-kg encode`` and ``wordcraft-kg elicit``."""

from itertools import chain
from pathlib import Path

from wordcraft_kg.base import check_output, whole
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.cli.console import Output, aligned, command_line, split_labels
from wordcraft_kg.cli.options import Book, Force, Graph, Words

GROUP = "Knowledge from outside the book"
EXAMPLES = {
    "encode": (
        "wordcraft-kg encode graphs/mine --encoder sentence-transformers/all-MiniLM-L6-v2 --out "
        "vectors/mine",
        "wordcraft-kg train-recipes graphs/mine --features vectors/mine --out models/mine",
    ),
    "elicit": (
        "wordcraft-kg elicit graphs/mine --model HuggingFaceTB/SmolLM2-135M-Instruct --out "
        "knowledge/lm",
        "wordcraft-kg elicit graphs/mine --model models/small.gguf --random-weights 0 --out "
        "knowledge/control",
    ),
}


def encode(
    graph: Graph,
    *others: Book,
    encoder: str,
    labels: Words = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Encode entity labels with a sentence encoder: vectors for --features.

    Args:
        others: further graphs or books, such as those that train-recipes --with names.
        encoder: model folder, or a name on the Hugging Face hub.
        labels: comma-separated further labels, such as new entities for the command score.
        out: folder to write. Default: vectors/<graph name>.
    """
    from wordcraft_kg.graphs.graph_folder import open_graph
    from wordcraft_kg.graphs.recipes import check_label

    graphs = [open_graph(source).graph for source in (graph, *others)]
    folder = out or Path("vectors") / graphs[0].name
    check_output(folder, force=force)
    check_extra("text")
    further = [check_label(label, "`labels`") for label in split_labels(labels or [])]
    # Each label once, in order: books share entities, and a vector belongs to a label.
    names = list(dict.fromkeys(chain(*(source.entities for source in graphs), further)))
    from wordcraft_kg.apps.elicitation.encoder import encode_labels, write_vectors
    from wordcraft_kg.apps.elicitation.foreign_code import locate_model

    vectors, hashes = encode_labels(
        names, locate_model("encoder", encoder), output.progress("encoding", unit="label")
    )
    other_graphs = {f"graph {source.name}": source.hash for source in graphs[1:]}
    inputs = {"graph": graphs[0].hash, **other_graphs, **hashes}
    vectors_folder = write_vectors(folder, names, vectors, inputs=inputs, force=force)
    size, dimensions = vectors.shape
    following = command_line("train-recipes", graph, "--features", vectors_folder)
    output.result(
        {"out": str(vectors_folder), "labels": size, "dimensions": dimensions, "weights": hashes},
        [
            f"encoded {size:,} labels in {dimensions} dimensions",
            f"wrote {vectors_folder}/   next: {following}",
        ],
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
    if random_weights is not None:
        whole("random_weights", random_weights, 0)
    check_output(out, force=force)
    check_extra("text")
    from wordcraft_kg.apps.elicitation.foreign_code import locate_model
    from wordcraft_kg.apps.elicitation.language_model import (
        DEFAULT,
        elicit_knowledge,
        open_language_model,
        read_prompts,
        strongest,
    )
    from wordcraft_kg.graphs.graph_folder import open_graph

    prompt_texts = read_prompts(prompts or DEFAULT)
    recipes = open_graph(graph).graph

    language_model = open_language_model(locate_model("model", model), random_weights)
    knowledge = elicit_knowledge(
        out,
        recipes,
        language_model,
        prompt_texts,
        report=output.progress("reading texts", unit="text"),
        force=force,
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
