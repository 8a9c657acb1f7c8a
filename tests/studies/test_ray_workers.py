"""Studies on a real Ray cluster: two nodes on this machine, with processes of their own and one results folder."""

import json
import os
import re
import signal
import sys
import tempfile
import time
from pathlib import Path

import pytest
from small_study import TRAINED, Inline, small_plan

from wordcraft_kg.base.errors import ConfigError, MissingExtraError
from wordcraft_kg.runs.parallel import cores
from wordcraft_kg.studies import ray_workers
from wordcraft_kg.studies.engine import run_plan
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.ray_workers import RayWorkers
from wordcraft_kg.studies.tasks import Outcome, Task


def play(task, root):
    """Pretend to be a training: note that it has begun, take its time, and end."""
    import ray

    settings, folder = task.settings, task.folder(root)
    note = {"number": settings["number"], "node": ray.get_runtime_context().get_node_id()}
    note |= {"gpus": os.environ.get("CUDA_VISIBLE_DEVICES"), "threads": os.environ["OMP_NUM_THREADS"], "cores": cores()}
    with (root / "notes").open("a") as notes:
        notes.write(json.dumps(note) + "\n")
    folder.mkdir(parents=True, exist_ok=True)
    if settings["how"] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if settings["how"] == "fails":
        return Outcome(task.address, "failed", "the oven is broken")
    if settings["how"] == "raises":
        raise ValueError("the recipe is wrong")
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append(1))
    for step in range(int(10 * settings["seconds"])):
        time.sleep(0.1)
        if asked:
            (folder / "checkpoint").write_text(str(step))
            return Outcome(task.address, "interrupted")
    (folder / "figures.json").write_text(json.dumps((folder / "checkpoint").exists()))
    return Outcome(task.address, "done")


@pytest.fixture(scope="module", autouse=True)
def environment():
    """What processes of Ray start with; Ray reads some of it when it is imported."""
    paths = (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))  # nodes import `play`
        patch.setenv("RAY_TMPDIR", tempfile.gettempdir())  # sockets, whose paths are short
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        yield


@pytest.fixture(scope="module")
def cluster(environment):
    pytest.importorskip("ray", reason="needs the extra ray")
    from ray.cluster_utils import Cluster

    soon = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_failure_threshold": 4}
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": soon}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()


@pytest.fixture
def second(cluster):
    """A second node, which a test may kill."""
    node = cluster.add_node(num_cpus=1, num_gpus=1)
    yield node
    if node in cluster.worker_nodes:
        cluster.remove_node(node)


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A results folder, given as most users do."""
    monkeypatch.chdir(tmp_path)
    Path("results").mkdir()
    return Path("results")


def a_task(number, how="works", seconds=0, **more):
    return Task("runs", {"number": number, "how": how, "seconds": seconds}, f"run {number}", **more)


def notes(root):
    path = root / "notes"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def until(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def perform_all(root, address, tasks, meanwhile=lambda: None):
    """Perform tasks on a cluster and leave it; return the outcomes by address."""
    workers = RayWorkers(root, address, play)
    found = []
    try:
        for task in tasks:
            workers.start(task)
        meanwhile()
        deadline = time.monotonic() + 60
        while len(found) < len(tasks):
            assert time.monotonic() < deadline, found
            found += workers.wait(0.5)
    finally:
        workers.stop()
    return {outcome.address: outcome for outcome in found}


@pytest.mark.slow
def test_nothing_is_lost_or_double_when_a_node_is_killed_in_the_middle(cluster, second, root, capfd):
    tasks = [a_task(number, seconds=1.5) for number in range(6)]

    def kill():
        until(lambda: len({note["node"] for note in notes(root)}) == 2)
        second.kill_all_processes(check_alive=False, allow_graceful=False, wait=True)
        cluster.worker_nodes.discard(second)

    outcomes = perform_all(root, cluster.address, tasks, kill)
    assert {outcome.termination for outcome in outcomes.values()} == {"done"}
    assert {f"runs/{path.name}" for path in root.glob("runs/*")} == {task.address for task in tasks} == outcomes.keys()
    begun = notes(root)
    (killed,) = {note["number"] for note in begun if note["node"] == second.node_id}
    assert sorted(note["number"] for note in begun) == sorted([*range(6), killed]), "only that one was begun again"
    assert capfd.readouterr().out == "", "stdout is for the result"


@pytest.mark.slow
def test_failures_have_a_clear_line_and_only_crashes_are_begun_again(cluster, second, root, monkeypatch):
    monkeypatch.setattr(ray_workers, "RETRIES", 1)
    tasks = {how: a_task(number, how) for number, how in enumerate(("works", "fails", "raises", "dies"))}
    tasks["on a GPU"] = a_task(10, device="cuda")
    tasks["two threads"] = a_task(11, threads=2)
    found = perform_all(root, cluster.address, tasks.values())
    outcomes = {how: found[task.address] for how, task in tasks.items()}
    good = {"works", "on a GPU"}
    assert {how for how, outcome in outcomes.items() if outcome.termination == "done"} == good, outcomes
    assert {outcome.termination for how, outcome in outcomes.items() if how not in good} == {"failed"}
    assert outcomes["fails"].error == "the oven is broken"
    assert outcomes["raises"].error == "ValueError: the recipe is wrong"
    assert "in play" in outcomes["raises"].detail
    assert outcomes["dies"].error.startswith("the task was begun 2 times, and its node or process was lost")
    assert "needs 2 cores, more than any cluster node has" in outcomes["two threads"].error
    assert sorted(note["number"] for note in notes(root)) == [0, 1, 2, 3, 3, 10]
    assert next(note for note in notes(root) if note["number"] == 10)["gpus"] == "0"
    assert {(note["threads"], note["cores"]) for note in notes(root)} == {("1", 1)}


@pytest.mark.slow
def test_what_is_stopped_writes_a_checkpoint_and_goes_on_from_it(cluster, root):
    task = a_task(0, seconds=60)
    workers = RayWorkers(root, cluster.address, play)
    try:
        workers.start(task)
        workers.start(a_task(1))
        until(lambda: notes(root))
    finally:
        workers.stop()
    assert (task.folder(root) / "checkpoint").exists()
    assert not (task.folder(root) / "figures.json").exists()
    task.settings["seconds"] = 0
    assert perform_all(root, cluster.address, [task])[task.address].termination == "done"
    assert json.loads((task.folder(root) / "figures.json").read_text()) is True


@pytest.mark.slow
def test_a_study_on_a_cluster_gives_the_bytes_of_one_on_this_machine(cluster, second, tmp_path, monkeypatch):
    def done(name, make_workers):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        state = run_plan(plan, Path("results"), make_workers)
        assert (state.failed, state.done) == ({}, len(plan.tasks))
        return {str(path.relative_to("results")): path.read_bytes() for path in Path("results").rglob("*.*")}

    plan = small_plan(text=TRAINED)
    ours = done("local", lambda: Inline(Path("results")))
    theirs = done("ray", lambda: RayWorkers(Path("results"), cluster.address, perform))
    assert ours.keys() == theirs.keys()
    timed = ("run.json", "figures.json", "metrics.jsonl", "metrics.json", "trace.jsonl", "evaluation.json", "README.md")
    assert [name for name in ours if ours[name] != theirs[name] and not name.endswith(timed)] == []
    for name in (name for name in ours if name.startswith("runs/") and name.endswith("figures.json")):
        one, other = (json.loads(files[name])["figures"] for files in (ours, theirs))
        for figure in ("success", "by_plan", "won", "curve", "steps", "graph"):
            assert one[figure] == other[figure]
    for name in (name for name in ours if name.endswith("run.json") and not name.startswith("graphs/")):
        assert json.loads(ours[name])["argv"] == json.loads(theirs[name])["argv"], "not that of a process of Ray's"
    address = cluster.address.partition(":")[0].encode()
    assert [name for name, content in theirs.items() if address in content] == [], "records name no machine"


@pytest.mark.slow
def test_without_an_address_a_cluster_of_this_machine_comes_and_goes(root):
    pytest.importorskip("ray", reason="needs the extra ray")
    for number in range(2):
        (outcome,) = perform_all(root, None, [a_task(number)]).values()
        assert outcome.termination == "done"


@pytest.mark.slow
def test_a_node_with_another_version_or_without_the_folder_is_refused(cluster, root, monkeypatch):
    monkeypatch.setattr(ray_workers, "version", lambda name: "99.0")
    (outcome,) = perform_all(root, cluster.address, [a_task(0)]).values()
    assert re.search(r"cannot work in .*: folder shared: True, wordcraft-kg .*; expected True and 99.0", outcome.error)
    assert list(root.iterdir()) == []
    with pytest.raises(ConfigError, match="folder shared: False"):
        ray_workers._perform_on_node(a_task(0), root, play, sys.argv, root / "missing", "99.0")


@pytest.mark.parametrize("address", ["10.0.0.1", "ray://10.0.0.1:10001", "127.0.0.1:99999", "nowhere.invalid:6379"])
def test_an_address_without_a_cluster_is_refused_at_once(root, address):
    pytest.importorskip("ray", reason="needs the extra ray")
    began = time.monotonic()
    with pytest.raises(ConfigError, match=f"no Ray cluster at '{address}' .*expected auto or host:port.*ray start"):
        RayWorkers(root, address, play)
    assert time.monotonic() - began < 10


def test_without_ray_the_extra_is_named(root, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'ray>="):
        RayWorkers(root, "auto", play)
