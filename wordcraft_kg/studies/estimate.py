"""How long a study will take, before it starts: by what is done already, or else by what was measured once."""

from collections import defaultdict
from pathlib import Path
from statistics import median

from wordcraft_kg.agents.config import ImpalaConfig
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.studies.figures import Figures, read_figures
from wordcraft_kg.studies.perform import FIGURES
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.tasks import Task

STEPS_PER_SECOND = {"none": 55_000, "u,v": 42_000, "w": 26_000, "random": 20_000, "one-hot": 13_000}
"""Of one core of an ordinary machine, with 8 distractors: without a scorer, with one, and with w among the sources; and
without a scorer, but with vectors of more dimensions than GloVe's 50.
"""
SECONDS_OF_SCORER = {"train-complex": 70.0, "train-links": 120.0, "train-recipes": 50.0}
"""Of a book of 700 entities, with its folds."""
START = 3.0
"""Seconds in which a training opens its graph and plays its tasks at the end."""


def estimated_hours(plan: Plan, root: Path) -> float:
    """Return the hours of one core that a study still needs; rough, since books and machines differ.

    Args:
        plan: the study.
        root: results folder; what is done there costs nothing, and says how fast this machine is.
    """
    done: dict[str, Figures] = {}
    for address, task in plan.tasks.items():
        try:
            done[address] = read_figures(task.folder(root), FIGURES[task.kind])
        except ArtefactError:
            continue
    measured = defaultdict(list)
    for address, figures in done.items():
        task = plan.tasks[address]
        if (expected := _usual(task)) and figures.seconds:
            measured[_sort(task)].append(figures.seconds / expected)
    left = [task for address, task in plan.tasks.items() if address not in done]
    factors = {sort: median(ratios) for sort, ratios in measured.items()}
    return sum(_usual(task) * factors.get(_sort(task), 1.0) for task in left) / 3600


def _sort(task: Task) -> str:
    if task.kind == "scorers":
        return str(task.settings["command"])
    if task.kind == "graphs":
        return task.kind
    settings = task.settings["settings"]
    if len(task.needs) > 1:
        return "w" if "w" in settings.get("use", PolicyConfig.use) else "u,v"
    features = settings.get("features", PolicyConfig.features)
    return features if features in STEPS_PER_SECOND else "none"


def _usual(task: Task) -> float:
    """Return the seconds that such a task takes on an ordinary machine."""
    if task.kind == "runs":
        return START + task.settings["settings"].get("steps", ImpalaConfig.steps) / STEPS_PER_SECOND[_sort(task)]
    return SECONDS_OF_SCORER.get(_sort(task), 1.0)
