"""A study of the kitchen that takes seconds."""

from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.graphs.graph_folder import PlayedGraph, open_graph
from wordcraft_kg.runs.record import end_run, start_run
from wordcraft_kg.studies.engine import Pool, run_plan
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.plan import Outcome, make_plan
from wordcraft_kg.studies.results import RunMetrics, ScorerMetrics, write_metrics
from wordcraft_kg.studies.study import parse_study

TEXT = """
title = "A comparison"
seeds = 2
[settings]
book = "kitchen"
steps = 512
[grid]
distractors = [2, 1]
[scorers.partial]
command = "train-complex"
epochs = 2
dim = 4
folds = 3
seed = 0
[variants.none]
[variants.guided]
scorer = "partial"
"""


def small_plan(more="", name="small", text=TEXT):
    return make_plan(parse_study(text + more, "a test"), name)


KITCHEN = open_graph("kitchen")
HALF = {
    "success": {"test": 0.5},
    "by_plan": {"test": 0.5},
    "terminations": {"goal": 0.5, "no_recipe": 0.5},
    "won": "4" * len(World(KITCHEN, WordCraftConfig(part="test")).tasks),
    "distractor_seeds": 8,
}
RUN_METRICS = RunMetrics(
    **HALF,
    seconds=1.0,
    versions={"torch": "2"},
    platform="here",
    graph=PlayedGraph.of(KITCHEN),
    curve=((0, 0.0), (10, 0.5)),
    steps=10,
    steps_per_second=10,
)
SCORER_METRICS = ScorerMetrics(
    seconds=1.0, versions={"torch": "2"}, platform="here", mrr=0.5, kg="partial"
)


def pretend(task, root):
    """Make a folder that looks done, and counts how often it was made."""
    folder = task.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "made").open("a") as file:
        file.write("once\n")
    end_run(folder, start_run(folder, "pretend"), "done")
    write_metrics(folder, RUN_METRICS if task.kind == "runs" else SCORER_METRICS)
    return Outcome(task.address, "done")


def run_small(root, plan=None, work=perform):
    """Run a study in this process; return the titles of the tasks that were begun."""
    began = []

    def noted(task, folder):
        began.append(task.title)
        return work(task, folder)

    run_plan(plan or small_plan(), root, Pool(1), work=noted)
    return began
