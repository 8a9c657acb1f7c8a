"""``wordcraft-kg export``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.graphs.export import Format

EXAMPLES = (
    "wordcraft-kg export everyday --format graphml --out everyday.graphml",
    "wordcraft-kg export graphs/everyday --format libkge --out everyday-libkge",
)


def export(
    graph: str,
    *,
    format: Format,
    out: Annotated[Path, Parameter(name=["--out"])],
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Write a graph for other tools.

    Args:
        graph: graph folder, recipe book or known book's name.
        format: tsv (triples), libkge (dataset folder), graphml or gexf (with recipe nodes), nt or ttl (RDF), parquet
            (triples), csv or json (recipe book).
        out: file to write, or folder for libkge.
        force: replace it if it exists.
    """
    from wordcraft_kg.graphs.export import EXPORTERS, export_graph
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    export_graph(opened, format, out, force=force)
    output.result(
        {"graph": opened.graph.name, "hash": opened.graph.hash, "format": format, "out": str(out)},
        [f"wrote {out}: {EXPORTERS[format].about}"],
    )
