"""``wordcraft-kg resume``."""

from pathlib import Path

from wordcraft_kg.cli.console import Output

EXAMPLES = (
    "wordcraft-kg resume models/everyday.unfinished",
    "wordcraft-kg resume models/everyday.unfinished --epochs 100",
)


def resume(run: Path, *, graph: str | None = None, epochs: int | None = None, output: Output = Output()) -> int:
    """Go on with an interrupted training from its last checkpoint; on CPU the result is bit-identical.

    Args:
        run: the unfinished folder, as the interrupted command named it.
        graph: where the graph is now, if it has moved.
        epochs: train up to this many epochs instead of the number first asked for.
    """
    from wordcraft_kg.cli.training import report
    from wordcraft_kg.models.link_training import resume_links

    return report(resume_links(run, graph=graph, epochs=epochs, progress=output.progress("resumed")), output)
