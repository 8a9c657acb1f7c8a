"""Some small cells are made again, and compared with their committed figures: the guard of VERSIONS
in addresses.

After a change that is meant to change what scorers or agents learn, raise VERSIONS and run this
file, which writes the figures anew.
"""

import sys
from pathlib import Path

import msgspec
import pytest
import torch

from wordcraft_kg.base import as_values, read_record, write_atomically
from wordcraft_kg.graphs import RecipeGraph, open_book
from wordcraft_kg.studies.engine import Pool, run_plan
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.results import RunResult, StudyResults, collect_study, results_text
from wordcraft_kg.studies.study import parse_study

FILE = Path(__file__).parent / "data" / "kitchen.json"
COMMAND = "python tests/studies/test_reproduction.py"
PROCESSOR = "AVX512"
"""With another set of instructions sums are rounded otherwise, so that an agent may learn something
slightly else."""
STUDY = """
title = "Cells that are made again"
seeds = 1
[settings]
book = "kitchen"
steps = 2_560
distractors = 2
[grid]
split = ["by-recipe", "by-goal"]
[scorers]
partial = { command = "train-complex", dim = 8, epochs = 20, folds = 2 }
recipes = { command = "train-recipes", folds = 3, features = "glove" }
[variants]
"no graph" = {}
"partial, u v" = { scorer = "partial" }
"partial, u v w" = { scorer = "recipes", use = "u,v,w" }
"partial, u v w, no penalty" = { scorer = "recipes", use = "u,v,w", scorer_cost = 0.0 }
"""
TIMES = {"seconds": 0.0, "steps_per_second": 0}


def untimed(results):
    """The results by address, without durations."""
    return {run.run: msgspec.structs.replace(run, **TIMES) for run in results.runs}


def remade(study, root):
    plan = make_plan(study, "kitchen")
    state = run_plan(plan, root, Pool(1), command=COMMAND)
    assert not state.failed
    return collect_study(root, plan.name)


def is_alike(was):
    """Return whether this machine computes to the bit what that of the file did."""
    return (
        was.versions["torch"] == torch.__version__
        and torch.backends.cpu.get_cpu_capability() == PROCESSOR
    )


@pytest.fixture(scope="module")
def was():
    return read_record(FILE, StudyResults)


@pytest.fixture(scope="module")
def now(was, tmp_path_factory):
    return remade(was.study, tmp_path_factory.mktemp("results"))


@pytest.mark.slow
def test_a_cell_that_is_made_again_has_the_same_inputs_and_figures(was, now):
    assert untimed(now).keys() == untimed(was).keys()
    assert now.graphs == was.graphs
    if not is_alike(was):
        pytest.skip(
            f"the figures are of torch {was.versions['torch']} on {PROCESSOR}; compared roughly "
            "below"
        )
    assert untimed(now) == untimed(was), (
        "raise VERSIONS in wordcraft_kg/studies/plan.py, then run this file"
    )


@pytest.mark.slow
def test_a_cell_that_is_made_again_has_about_the_same_figures_anywhere(was, now):
    for old, new in zip(was.runs, now.runs, strict=True):
        assert new.success == pytest.approx(old.success, abs=0.1)
        assert len(new.won) == len(old.won)
        assert [step for step, _ in new.curve] == [step for step, _ in old.curve]
        assert new.mrr == pytest.approx(old.mrr, abs=0.05)


def test_the_file_knows_no_entity_of_its_book(was):
    text = FILE.read_text(encoding="utf-8")
    labels = RecipeGraph.from_book(open_book("kitchen")).entities
    assert {label for label in labels if f'"{label}"' in text} <= {"kitchen", "seed"}, (
        "its name and a key"
    )
    assert set(RunResult.__struct_fields__) == as_values(was.runs[0]).keys()


if __name__ == "__main__":
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        made, before = (
            remade(parse_study(STUDY, "the study above"), Path(folder)),
            read_record(FILE, StudyResults),
        )
    if any(
        untimed(before).get(address, run) != run for address, run in untimed(made).items()
    ) and is_alike(before):
        sys.exit(
            "other figures at the same address: raise VERSIONS in wordcraft_kg/studies/plan.py "
            "first"
        )
    write_atomically(FILE, results_text(made))
