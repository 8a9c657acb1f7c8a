"""The trainer in one file learns as the trainer does."""

import csv
import json
import runpy
from pathlib import Path

import pytest

from wordcraft_kg import AgentConfig, ImpalaConfig, TaskConfig, train_agent

FILE = Path(__file__).parents[2] / "examples" / "impala_single_file.py"


def test_its_learning_curve_is_that_of_the_trainer(tmp_path):
    runpy.run_path(str(FILE))["train"]("kitchen", 7_680, 3, 1, tmp_path / "curve.csv")
    trainer = ImpalaConfig(steps=7_680, seed=1, log_every=2_560, eval_every=2_560)
    train_agent(AgentConfig("kitchen", tasks=TaskConfig(distractors=3), trainer=trainer), tmp_path / "run")
    _, *expected = map(json.loads, (tmp_path / "run" / "metrics.jsonl").read_text().splitlines())
    found = list(csv.DictReader((tmp_path / "curve.csv").open(encoding="utf-8")))
    assert [int(row["step"]) for row in found] == [row["step"] for row in expected] == [2_560, 5_120, 7_680]
    for row, other in zip(found, expected, strict=True):
        # Counts of the same episodes; losses differ by rounding, because the trainer folds keys into the query.
        assert float(row["success"]) == other["success"]
        assert float(row["test_success"]) == pytest.approx(other["test_success"], abs=1e-12)
        assert float(row["loss"]) == pytest.approx(other["loss"], abs=1e-3)
