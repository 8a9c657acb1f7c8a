"""Running a study from Python, on this machine."""

from functools import partial
from pathlib import Path

from wordcraft_kg.studies.collect import collect_study
from wordcraft_kg.studies.engine import Watch, run_plan
from wordcraft_kg.studies.local_workers import LocalWorkers
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.results import StudyResults
from wordcraft_kg.studies.study import Study, check_study


def run_study(
    study: Study,
    out: str | Path,
    *,
    name: str = "study",
    jobs: int | None = None,
    keep_all: bool = True,
    watch: Watch | None = None,
) -> StudyResults:
    """Run what of a study is not there yet, and return its figures; trainings that fail are among the missing.

    Args:
        study: from :func:`~wordcraft_kg.studies.study.read_study`, or made in Python.
        out: results folder; other studies may use it too, and share what is equal.
        name: name of the study there.
        jobs: trainings at once, each in a process of its own. Default: as many as the cores allow.
        keep_all: keep weights and episodes of runs too, tens of megabytes each, not figures alone.
        watch: called regularly with the plan and how far it is.

    Raises:
        ConfigError: naming what is wrong with the study, or a number of ``jobs`` that is not allowed.
        ArtefactError: if another study is being run in the folder.
        KeyboardInterrupt: after Ctrl-C; the same call goes on.

    Example:
        >>> study = Study("A look", {"none": {}}, seeds=1, settings={"book": "kitchen", "steps": 256})
        >>> results = run_study(study, "results", jobs=1)
        >>> [(run.variant, run.seed, run.steps) for run in results.runs]
        [('none', 0, 256)]
    """
    check_study(study)
    root, plan = Path(out), make_plan(study, name)
    number, work = plan.jobs(jobs), partial(perform, keep_all=keep_all)
    run_plan(plan, root, lambda: LocalWorkers(root, number, work, plan.threads), watch=watch)
    return collect_study(root, name)
