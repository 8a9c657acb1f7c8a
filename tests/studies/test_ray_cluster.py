"""Studies on a Ray cluster of this machine, by Ray's backend of joblib."""

import os
import sys
import tempfile
import types
from contextlib import suppress

import pytest
from small_study import KITCHEN, TEXT, small_plan

from wordcraft_kg.base.errors import ConfigError, MissingExtraError
from wordcraft_kg.base.settings import CORES_VARIABLE
from wordcraft_kg.studies.engine import Pool, ray_cluster, run_plan
from wordcraft_kg.studies.perform import make_graph, perform
from wordcraft_kg.studies.report import tables_of
from wordcraft_kg.studies.results import collect_study
from wordcraft_kg.studies.view import view_study


def table(root):
    """The table of a study, which has no durations."""
    return tables_of(view_study(collect_study(root, "small")))


@pytest.mark.slow
def test_a_cluster_gives_the_table_of_one_process(tmp_path, monkeypatch, capfd):
    pytest.importorskip("ray", reason="needs the extra ray")
    monkeypatch.setenv("RAY_TMPDIR", tempfile.gettempdir())  # sockets, whose paths are short
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setenv(CORES_VARIABLE, "2")
    plan = small_plan(text=TEXT.replace("seeds = 2", "seeds = 1"))
    run_plan(plan, tmp_path / "one", Pool(1))
    state = run_plan(plan, tmp_path / "cluster", Pool(2, "ray"))
    assert (state.failed, state.done) == ({}, len(plan.tasks))
    assert table(tmp_path / "cluster") == table(tmp_path / "one")
    assert capfd.readouterr().out == "", "stdout is for the result"


def test_an_address_without_a_cluster_is_refused(tmp_path):
    pytest.importorskip("ray", reason="needs the extra ray")
    with pytest.raises(ConfigError, match=r"no Ray cluster at '10\.0\.0\.1'"):
        run_plan(small_plan(), tmp_path, Pool(engine="ray", address="10.0.0.1"))


def test_without_ray_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match="Ray is not installed"):
        run_plan(small_plan(), tmp_path, Pool(engine="ray", address="auto"))


@pytest.fixture
def stub(monkeypatch):
    """A stub of Ray, which notes its calls."""
    calls = []
    ray = types.ModuleType("ray")
    ray.init = lambda **settings: calls.append(settings["address"])
    ray.cluster_resources = lambda: {"CPU": 6.0}
    ray.shutdown = lambda: calls.append("shutdown")
    joblib = types.ModuleType("ray.util.joblib")
    joblib.register_ray = lambda: calls.append("registered")
    for name, module in {"ray": ray, "ray.util": ray, "ray.util.joblib": joblib}.items():
        monkeypatch.setitem(sys.modules, name, module)
    return calls


def test_a_cluster_is_left_whatever_happens(stub):
    with suppress(ValueError), ray_cluster("head:6379") as cores:
        assert cores == 6
        raise ValueError("a fault")
    assert stub == ["head:6379", "registered", "shutdown"]


def test_vectors_that_changed_since_the_plan_fail_with_the_reason(put, tmp_path):
    vectors = put("".join(f"{label} 1 2\n" for label in KITCHEN.graph.entities), "words.txt")
    features = f'[variants.own]\nfeatures = "{vectors}"'
    plan = small_plan(features)
    vectors.write_text(vectors.read_text().replace("1 2", "2 1"))
    (task, *_) = (task for task in plan.tasks.values() if task.title.startswith("own"))
    graph = plan.tasks[task.needs[0]]
    make_graph(graph, tmp_path)
    outcome = perform(task, tmp_path)
    assert outcome.termination == "failed"
    assert f"the vectors of '{vectors}' have changed since the study was planned" in outcome.error
