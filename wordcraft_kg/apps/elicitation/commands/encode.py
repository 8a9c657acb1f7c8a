"""``wordcraft-kg encode``."""

from pathlib import Path

from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.cli.console import Output, command_line, split_labels
from wordcraft_kg.cli.options import Book, Force, Graph, Words

GROUP = "Knowledge from outside the book"
EXAMPLES = (
    "wordcraft-kg encode graphs/mine --encoder sentence-transformers/all-MiniLM-L6-v2 --out "
    "vectors/mine",
    "wordcraft-kg train-recipes graphs/mine --features vectors/mine --out models/mine",
)


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
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.graphs.recipes import check_label

    graphs = [open_graph(source).graph for source in (graph, *others)]
    folder = out or Path("vectors") / graphs[0].name
    check_output(folder, force=force)
    check_extra("text")
    # Each label once, in order: books share entities, and a vector belongs to a label.
    every: dict[str, None] = {}
    for source in graphs:
        every |= dict.fromkeys(source.entities)
    for label in split_labels(labels or []):
        every[check_label(label, "`labels`")] = None
    names = list(every)
    from wordcraft_kg.apps.elicitation.encoder import encode_labels, write_vectors
    from wordcraft_kg.apps.elicitation.weights import locate_model

    progress = output.progress("encoding", unit="label")
    vectors, hashes = encode_labels(names, locate_model("encoder", encoder), progress)
    inputs = {f"graph {source.name}": source.hash for source in graphs[1:]}
    inputs = {"graph": graphs[0].hash, **inputs, **hashes}
    vectors_folder = write_vectors(folder, names, vectors, inputs=inputs, force=force)
    dimensions = vectors.shape[1]
    size = len(names)
    following = command_line("train-recipes", graph, "--features", vectors_folder)
    output.result(
        {"out": str(vectors_folder), "labels": size, "dimensions": dimensions, "weights": hashes},
        [
            f"encoded {size:,} labels in {dimensions} dimensions",
            f"wrote {vectors_folder}/   next: {following}",
        ],
    )
