"""``wordcraft-kg import-pykeen``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output, aligned

EXAMPLES = (
    "wordcraft-kg import-pykeen results/transe --graph graphs/everyday --out models/transe --trust-pickle",
    "wordcraft-kg evaluate-links models/transe",
)


def import_pykeen(
    result: Path,
    *,
    graph: str,
    out: Annotated[Path, Parameter(name=["--out"])],
    trust_pickle: Flag = False,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Turn a model that PyKEEN's pipeline has trained and saved into a model folder for all other commands.

    Args:
        result: folder written by PyKEEN's save_to_directory.
        graph: graph folder, recipe book or known book's name; the model has the same entities and relations.
        out: model folder to write.
        trust_pickle: read the model, which PyKEEN stores as a pickle. Reading a pickle runs whatever code is in it, so
            do this with files of your own, or of people whose programs you would run.
        force: replace the folder if it exists.
    """
    from wordcraft_kg.models.links.pykeen_import import import_pykeen

    found = import_pykeen(result, graph, out, trust_pickle=trust_pickle, force=force)
    seen = (
        f"{found.held_out:,} of them held out by the split: it counts as a model of the full graph"
        if found.held_out
        else "none of them held out by the split: a model of the partial graph"
    )
    rows = [("model", found.model), ("trained on", f"{found.triples:,} triples, {seen}")]
    output.result(found, [*aligned(rows), f"wrote {out}/   next: wordcraft-kg evaluate-links {out}"])
