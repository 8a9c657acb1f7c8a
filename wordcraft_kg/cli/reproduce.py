"""``wordcraft-kg reproduce``."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.studies import EngineOptions, run_studies

if TYPE_CHECKING:
    from wordcraft_kg.studies.study import Study

EXAMPLES = (
    "wordcraft-kg reproduce list",
    "wordcraft-kg reproduce embeddings --out results",
    "wordcraft-kg reproduce all --book everyday --steps 300000 --seeds 3 --jobs 2",
)
ALL, LIST = "all", "list"


def reproduce(
    study: str,
    *,
    books: Annotated[list[str] | None, Parameter(name="--book", negative=(), consume_multiple=False)] = None,
    seeds: int | None = None,
    steps: int | None = None,
    engine: EngineOptions = EngineOptions(),
    output: Output = Output(),
) -> int:
    """Make a figure of the paper or one of ours, with seeds: build, train, evaluate, draw; go on where it stopped.

    Args:
        study: name of a built-in study; all of them with all, and what there is with list.
        books: recipe books, comma-separated. Default: the study's, which is little-alchemy-2.
        seeds: number of trainings of each cell. Default: the study's.
        steps: environment steps of each training. Default: the study's, which is the paper's 3,000,000.
        engine: where and how it runs.
    """
    from wordcraft_kg.base.errors import ConfigError
    from wordcraft_kg.base.settings import nearest
    from wordcraft_kg.cli.console import split_labels
    from wordcraft_kg.studies.study import adapted, built_in, read_study

    if study == LIST:
        if books:
            raise ConfigError("`book`: the list is of the studies with their own books; leave it out.")
        return _list(steps, seeds, engine, output)
    if study not in (ALL, *built_in()):
        raise ConfigError(
            f"'{study}' is no built-in study; there are {', '.join(built_in())}.{nearest(study, built_in())} A file of "
            "your own: wordcraft-kg sweep"
        )
    chosen = built_in() if study == ALL else [study]
    found: dict[str, Study] = {}
    for name in chosen:
        declared = read_study(name)
        for book in split_labels(books or ()) or [str(declared.settings.get("book", "everyday"))]:
            full = f"{name}-{_stem(book)}"
            if full in found:
                raise ConfigError(f"`book`: two books are called '{_stem(book)}', and so would be their studies.")
            found[full] = adapted(declared, book=book, steps=steps, seeds=seeds)
    return run_studies(found, engine, output)


def _stem(book: str) -> str:
    from pathlib import Path

    return Path(book).stem


def _list(steps: int | None, seeds: int | None, engine: EngineOptions, output: Output) -> int:
    """Print the built-in studies, with the hours that each still takes on this machine."""
    from dataclasses import replace

    from wordcraft_kg.base.errors import RecipeFileError
    from wordcraft_kg.studies.engine import estimated_hours
    from wordcraft_kg.studies.plan import make_plan
    from wordcraft_kg.studies.study import adapted, built_in, cells_of, read_study
    from wordcraft_kg.studies.tasks import Task

    found: dict[str, dict[str, object]] = {}
    text: list[str] = []
    tasks: dict[str, Task] = {}
    width = max(map(len, built_in()))
    for name in built_in():
        study = adapted(read_study(name), steps=steps, seeds=seeds)
        try:
            plan = make_plan(study, name)
        except RecipeFileError:  # the real book is not there; the built-in one is about as large
            plan = make_plan(adapted(study, book="everyday"), name)
        tasks |= plan.tasks
        hours = estimated_hours(plan, engine.out) / plan.jobs(engine.jobs)
        trainings = len(cells_of(study))
        found[name] = {"title": study.title, "source": study.source, "trainings": trainings, "hours": round(hours, 2)}
        text += [
            f"{name:<{width}}  {study.title}: {trainings} trainings, about {hours:.1f} hours left on this machine",
            f"{'':<{width}}  {study.source}",
        ]
    everything = replace(plan, tasks=tasks)
    hours = estimated_hours(everything, engine.out) / everything.jobs(engine.jobs)
    text.append(f"{ALL:<{width}}  about {hours:.1f} hours left: what several studies need is made once")
    text.append("run one: wordcraft-kg reproduce NAME; for a quick look: --steps 300000 --seeds 3")
    output.result({"studies": found, "hours": round(hours, 2)}, text)
    return 0
