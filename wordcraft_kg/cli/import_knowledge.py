"""``wordcraft-kg import-knowledge``."""

from pathlib import Path

from wordcraft_kg.base import ConfigError, check_output, counted, sha256_of
from wordcraft_kg.cli.console import Output, command_line
from wordcraft_kg.cli.options import Force, Graph
from wordcraft_kg.graphs import open_graph

EXAMPLES = (
    "wordcraft-kg import-knowledge graphs/everyday --wordnet /usr/share/wordnet --out knowledge/wn",
    "wordcraft-kg import-knowledge graphs/everyday --conceptnet conceptnet-assertions-5.7.0.csv.gz "
    "--out knowledge/cn",
    "wordcraft-kg import-knowledge everyday --triples triples.tsv --overrides nodes.tsv",
    "wordcraft-kg import-knowledge everyday --scores scores.csv --out models/opinions",
)


def import_knowledge(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph,
    *,
    wordnet: Path | None = None,
    conceptnet: Path | None = None,
    triples: Path | None = None,
    overrides: Path | None = None,
    scores: Path | None = None,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Import WordNet, ConceptNet or any triples as knowledge for train-recipes and train-complex.

    Scores of sets, such as a language model's opinions, become a model folder instead, for
    train-agent --use table.

    The command aligns the labels with the general graph's nodes, and makes tables and triples.
    Among several senses of a word, the first one counts; recipes are not read.

    Args:
        wordnet: folder with WordNet's database files, such as data.noun and index.noun.
        conceptnet: ConceptNet's assertions, plain or .gz; only English words are used.
        triples: file of head, relation and tail with tabs between them; or, below a header with
            these names and perhaps weight, with tabs or commas; plain or gzipped.
        overrides: file with a label, a tab and a node on each line, as in the output's
            alignment.tsv; without a node, the label is left out.
        scores: CSV with the columns set (such as "flour + water"), result and score; only
            differences count, and a set without a score has the mean.
        out: knowledge folder to write. Default: knowledge/<graph name>-<wordnet, conceptnet or
            triples>, or models/<graph name>-scores.
    """
    from wordcraft_kg.models.knowledge.importing import Kind, import_knowledge

    if scores is not None:
        if wordnet or conceptnet or triples or overrides:
            raise ConfigError("`scores` make a folder of their own; leave out other knowledge.")
        _import_scores(graph, scores, out, force, output)
        return
    sources: dict[Kind, Path | None] = {
        "wordnet": wordnet,
        "conceptnet": conceptnet,
        "triples": triples,
    }
    # One graph for each folder; `--with` of the training commands takes several folders.
    files = [(kind, path) for kind, path in sources.items() if path is not None]
    if len(files) != 1:
        raise ConfigError(
            f"expected one of --wordnet, --conceptnet, --triples and --scores; found {len(files)}."
        )
    ((kind, path),) = files
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


def _import_scores(graph: str, scores: Path, out: Path | None, force: bool, output: Output) -> None:
    from wordcraft_kg.models.knowledge.score_files import read_scores
    from wordcraft_kg.models.model_folder import save_scorer

    opened = open_graph(graph)
    out = out or Path("models") / f"{opened.graph.name}-scores"
    check_output(out, force=force)
    scorer = read_scores(scores, opened.graph)
    origin = f"scores of sets from {scores.name}, SHA-256 {sha256_of(scores)}"
    save_scorer(out, scorer, opened, kg="none", origin=origin, force=force)
    train = command_line("train-agent", graph, "--scorer", out, "--use", "table")
    output.result(
        {"out": str(out), "scores": len(scorer.values)},
        [counted(len(scorer.values), "score"), f"wrote {out}/   next: {train}"],
    )
