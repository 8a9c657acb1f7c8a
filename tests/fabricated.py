"""Results of studies that nobody has played."""

from wordcraft_kg.graphs.graph_folder import PlayedGraph
from wordcraft_kg.studies.results import Origin, RunResult, StudyResults
from wordcraft_kg.studies.study import Study

NO_GRAPH = ["00000", "50000", "05000", "00500", "55000"]
GUIDED = ["55500", "55550", "55055", "05555", "55555"]
"""Successes of each seed on five tasks, with five distractor seeds each."""


def fabricate(
    won,
    *,
    distractor_seeds=5,
    mrr=None,
    curves=None,
    settings=None,
    drawing="curves",
    reference="",
    title="Made up",
):
    """Return results of a study: ``won`` has a string of digits for each seed of each variant."""
    points = won if isinstance(won, list) else [({}, won)]
    variants = {name: (settings or {}).get(name, {}) for _, cells in points for name in cells}
    runs = []
    # Each task is a group of its own; runs with as many tasks share theirs.
    groups = {}
    for number, (values, cells) in enumerate(points):
        for variant, members in cells.items():
            for seed, digits in enumerate(members):
                success = sum(map(int, digits)) / (distractor_seeds * len(digits))
                quality = (mrr or {}).get(f"{variant}@{number}", (mrr or {}).get(variant))
                curve = (curves or {}).get(variant)
                run = RunResult(
                    variant=variant,
                    values=values,
                    seed=seed,
                    run=f"{number}-{variant}-{seed}",
                    graph=0,
                    origin=0,
                    groups=groups.setdefault(tuple(range(len(digits))), len(groups)),
                    success={"train": 0.5, "test": success},
                    by_plan={"train": 0.5, "test": success / 2},
                    terminations={},
                    won=digits,
                    distractor_seeds=distractor_seeds,
                    curve=tuple(curve[seed]) if curve else ((1000, success / 2), (2000, success)),
                    mrr=None if quality is None else quality + seed / 100,
                    steps=2000,
                    seconds=10.0,
                    steps_per_second=200,
                )
                runs.append(run)
    graph = PlayedGraph("kitchen", "a" * 64, "by-recipe", 0, "b" * 64)
    study = Study(title, variants, drawing=drawing, reference=reference)
    command = "wordcraft-kg reproduce made-up"
    return StudyResults(
        "wordcraft-kg results 1",
        "made-up",
        command,
        study,
        (graph,),
        {"torch": "2"},
        tuple(runs),
        (),
        0.5,
        (Origin("here", {"torch": "2"}, len(runs)),),
        tuple(groups),
    )
