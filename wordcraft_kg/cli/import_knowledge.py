"""``wordcraft-kg import-knowledge``."""

from pathlib import Path

from wordcraft_kg.base import ConfigError, check_output, counted
from wordcraft_kg.cli.console import Output, aligned, command_line
from wordcraft_kg.cli.options import Force, Graph

EXAMPLES = (
    "wordcraft-kg import-knowledge graphs/everyday --wordnet /usr/share/wordnet --out knowledge/wn",
    "wordcraft-kg import-knowledge graphs/everyday --conceptnet conceptnet-assertions-5.7.0.csv.gz "
    "--out knowledge/cn",
    "wordcraft-kg import-knowledge everyday --triples triples.tsv --overrides nodes.tsv",
)


def import_knowledge(
    graph: Graph,
    *,
    wordnet: Path | None = None,
    conceptnet: Path | None = None,
    triples: Path | None = None,
    overrides: Path | None = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Import WordNet, ConceptNet or any triples as knowledge for train-recipes and train-complex.

    The command aligns the labels with the general graph's nodes, and makes tables, triples and
    facts. Among several senses of a word, the first one counts; recipes are not read.

    Args:
        wordnet: folder with WordNet's database files, such as data.noun and index.noun.
        conceptnet: ConceptNet's assertions, plain or .gz; only English words are used.
        triples: file of head, relation and tail with tabs between them; or, below a header with
            these names and perhaps weight, with tabs or commas; plain or gzipped.
        overrides: file with a label, a tab and a node on each line, as in the output's
            alignment.tsv; without a node, the label is left out.
        out: knowledge folder to write. Default: knowledge/<graph name>-<wordnet, conceptnet or
            triples>.
    """
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.models.knowledge.importing import (
        Kind,
        describe,
        import_knowledge,
    )

    sources: dict[Kind, Path | None] = {
        "wordnet": wordnet,
        "conceptnet": conceptnet,
        "triples": triples,
    }
    # One graph for each folder; `--with` of the training commands takes several folders.
    files = [(kind, path) for kind, path in sources.items() if path is not None]
    if len(files) != 1:
        raise ConfigError(
            f"expected one of --wordnet, --conceptnet and --triples; found {len(files)}."
        )
    ((kind, path),) = files
    opened = open_graph(graph)
    out = out or Path("knowledge") / f"{opened.graph.name}-{kind}"
    # Refused before a large file is read.
    check_output(out, force=force)
    view = import_knowledge(opened, kind, path, out, overrides=overrides, force=force)
    text = aligned(describe(view), numbers=True)
    triples_and_facts = f"{counted(view.triples, 'triple')}, {counted(view.facts, 'fact')}"
    text.append(f"{triples_and_facts}, tables: {', '.join(view.tables)}")
    # Recipe scorers take pairs.
    train = "train-recipes" if (opened.graph.sizes == 2).all() else "train-complex"
    text.append(f"wrote {out}/   next: {command_line(train, graph, '--with', out)}")
    output.result(view, text)
