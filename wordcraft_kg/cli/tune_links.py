"""``wordcraft-kg tune-links``."""

from pathlib import Path

from wordcraft_kg.cli.completion import Book
from wordcraft_kg.cli.console import Flag, Output

EXAMPLES = (
    "wordcraft-kg tune-links everyday --valid-ratio 0.1 --trials 5 --out tuned/everyday.toml",
    "wordcraft-kg train-complex everyday --config tuned/everyday.toml --out models/everyday-tuned",
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
    out: Path = Path("tuned.toml"),
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Search settings with PyKEEN's hyper-parameter optimisation, on validation triples only.

    The best settings are written as a TOML file for `train-complex --config` (or `train-links --config`). Test triples
    are never used: validation uses the graph's validation part or, if it has none, one drawn from the train recipes.

    Args:
        graph: graph folder, recipe book or known book's name.
        model: complex, or PyKEEN's name of another model.
        trials: number of settings to try.
        valid_ratio: share of the train pairs to validate on if the graph has no validation part.
        seed: seed of the search and of each training.
        timeout: seconds after which no new trial is started.
        device: torch device.
        out: TOML file to write.
        force: replace it if it exists.
    """
    from wordcraft_kg.errors import OutputExistsError
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    if out.exists() and not force:
        raise OutputExistsError(f"'{out}' exists. Choose another --out, or replace it with --force.")
    from wordcraft_kg.models.links.tuning import tune

    found = tune(
        opened,
        model,
        out,
        trials=trials,
        valid_ratio=valid_ratio,
        seed=seed,
        timeout=timeout,
        device=device,
        quiet=output.quiet,
    )
    settings = ", ".join(f"{name} {value}" for name, value in found.settings.items())
    output.result(
        found,
        [
            f"best of {found.trials} trials: validation MRR {found.valid_mrr:.3f} with {settings}",
            f"wrote {out}   next: wordcraft-kg {found.command} {graph} --config {out}",
        ],
    )
