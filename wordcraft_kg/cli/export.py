"""``wordcraft-kg export``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.options import Force, Graph
from wordcraft_kg.graphs.export import ExportPart, Format

EXAMPLES = (
    "wordcraft-kg export everyday --format nt --out everyday.nt",
    "wordcraft-kg export graphs/everyday --format graphml --out everyday.graphml",
    "wordcraft-kg export graphs/everyday --format tsv --part partial --out train.tsv",
    "wordcraft-kg export everyday --format sentences --part partial --out sentences.txt",
)


def export(
    graph: Graph,
    *,
    format: Format,
    out: Annotated[Path, Parameter(name=["--out"])],
    part: ExportPart = "full",
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Export a graph to other tools' formats.

    Args:
        format: tsv or parquet (triples), graphml (with recipe nodes), nt (RDF, with recipe nodes),
            csv or json (recipe book), hif (JSON of a directed hypergraph), sentences (text for
            language models, one line for each recipe).
        out: file to write.
        part: full (all recipes), partial (train recipes), or unseen (held-out recipes, and triples
            that no train recipe gives). Entities and base are always complete.
    """
    from wordcraft_kg.graphs.export import EXPORTERS, export_graph
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    export_graph(opened, format, out, part=part, force=force)
    values = {
        "graph": opened.graph.name,
        "hash": opened.graph.hash,
        "format": format,
        "part": part,
        "out": str(out),
    }
    output.result(values, [f"wrote {out}: {EXPORTERS[format].about}; part: {part}"])
