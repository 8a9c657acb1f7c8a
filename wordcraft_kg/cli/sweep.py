"""``wordcraft-kg sweep``."""

from pathlib import Path

from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.studies import EngineOptions, run_studies

EXAMPLES = (
    "wordcraft-kg sweep study.toml --dry-run",
    "wordcraft-kg sweep study.toml --out results --jobs 2",
    "wordcraft-kg sweep study.toml --out results --engine ray --address auto",
)


def sweep(
    study: Path,
    *,
    seeds: int | None = None,
    steps: int | None = None,
    engine: EngineOptions = EngineOptions(),
    output: Output = Output(),
) -> int:
    """Run a study of your own, a TOML file: books, splits, scorers, agents and settings, crossed with each other.

    Args:
        study: the TOML file; docs/studies.md explains it.
        seeds: number of trainings of each cell. Default: the study's.
        steps: environment steps of each training. Default: the study's.
        engine: where and how it runs.
    """
    from wordcraft_kg.studies.study import adapted, read_study

    found = adapted(read_study(study), steps=steps, seeds=seeds)
    return run_studies({study.stem: found}, engine, output)
