"""``wordcraft-kg import-knowledge``."""

from pathlib import Path

from wordcraft_kg.base import ConfigError, check_output, counted
from wordcraft_kg.cli.console import Output, command_line
from wordcraft_kg.cli.options import Force, Graph
from wordcraft_kg.graphs import open_graph

EXAMPLES = (
    "wordcraft-kg import-knowledge graphs/everyday --wordnet /usr/share/wordnet --out knowledge/wn",
    "wordcraft-kg import-knowledge everyday --triples triples.tsv --overrides nodes.tsv",
)


def import_knowledge(
    graph: Graph,
    *,
    wordnet: Path | None = None,
    triples: Path | None = None,
    overrides: Path | None = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Import WordNet or any triples as knowledge for train-recipes and train-complex.

    The command aligns the labels with the general graph's nodes, and makes tables and triples.
    Among several senses of a word, the first one counts; recipes are not read.

    Args:
        wordnet: folder with WordNet's database files, such as data.noun and index.noun.
        triples: file of head, relation and tail with tabs between them, perhaps below a header
            with these names and perhaps weight; plain or gzipped.
        overrides: file with a label, a tab and a node on each line, as in the output's
            alignment.tsv; without a node, the label is left out.
        out: knowledge folder to write. Default: knowledge/<graph name>-<wordnet or triples>.
    """
    from wordcraft_kg.models.knowledge.importing import Kind, import_knowledge

    # One graph for each folder; `--with` of the training commands takes several folders.
    path = wordnet or triples
    if path is None or (wordnet and triples):
        raise ConfigError("expected one of --wordnet and --triples.")
    kind: Kind = "wordnet" if wordnet else "triples"
    opened = open_graph(graph)
    out = out or Path("knowledge") / f"{opened.graph.name}-{kind}"
    # Refused before a large file is read.
    check_output(out, force=force)
    view = import_knowledge(opened, kind, path, out, overrides=overrides, force=force)
    text = [
        f"{view.aligned:,} of {counted(view.entities, 'label')} aligned, see alignment.tsv",
        f"{counted(view.triples, 'triple')}, tables: {', '.join(view.tables)}",
    ]
    # Recipe scorers take pairs.
    train = "train-recipes" if (opened.graph.sizes == 2).all() else "train-complex"
    text.append(f"wrote {out}/   next: {command_line(train, graph, '--with', out)}")
    output.result(view, text)
