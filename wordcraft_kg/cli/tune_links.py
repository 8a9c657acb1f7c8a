"""``wordcraft-kg tune-links``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from wordcraft_kg.models.links.tuning import Tuned

EXAMPLES = (
    "wordcraft-kg tune-links everyday --trials 5 --out tuned/everyday",
    "wordcraft-kg train-complex everyday --config tuned/everyday/best.toml --out models/everyday-tuned",
)


def tune_links(
    graph: Book,
    *,
    model: str = "complex",
    trials: int = 20,
    valid_ratio: float = 0.1,
    seed: int = 0,
    timeout: int | None = None,
    device: str = "cpu",
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Search settings with Optuna on validation triples; repeat the command to resume an interrupted search.

    The folder holds a line for each trial (trials.jsonl) and the best settings so far (best.toml), for `train-complex
    --config` (or `train-links --config`). Test triples are never used: validation uses the graph's validation part or,
    if missing, a part sampled from the train recipes.

    Args:
        graph: graph folder, recipe book or known book name.
        model: complex, or the PyKEEN name of another model.
        trials: number of settings to try, including earlier trials of a resumed search.
        valid_ratio: share of the train pairs, or goals, for validation if the graph has no validation part.
        seed: seed for the search and each training.
        timeout: seconds after which no new trial is started.
        device: torch device.
        out: search folder. Default: tuned/<graph name>-<model>.
        force: replace an existing search.
    """
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.models.links.tuning import tune

    opened = open_graph(graph)
    tuned = tune(
        opened,
        model,
        out or Path("tuned") / f"{opened.graph.name}-{model.lower()}",
        trials=trials,
        valid_ratio=valid_ratio,
        seed=seed,
        timeout=timeout,
        device=device,
        force=force,
        progress=output.progress(f"tuning {model}", unit="trial"),
    )
    output.result(tuned, _text(tuned, graph))


def _text(tuned: "Tuned", graph: str) -> Iterator[str]:
    names = list(tuned.table[0].settings)
    cells = [["trial", "valid MRR", *names]]
    for trial in tuned.table:
        mrr = "-" if trial.valid_mrr is None else f"{trial.valid_mrr:.4f}"
        cells.append([str(trial.number), mrr, *(f"{trial.settings[name]:.4g}" for name in names)])
    widths = [max(len(row[column]) for row in cells) for column in range(len(names) + 2)]
    for row in cells:
        yield "  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))
    settings = ", ".join(f"{name} {value}" for name, value in tuned.settings.items())
    yield f"best of {tuned.trials} trials: validation MRR {tuned.valid_mrr:.3f} with {settings}"
    yield f"wrote {tuned.out}/   next: wordcraft-kg {tuned.command} {graph} --config {tuned.config}"
