"""Studies on a real Ray cluster: three nodes on this machine, with processes of their own."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest
from ray_tasks import play
from small_study import KITCHEN, TEXT, TRAINED, small_plan

import wordcraft_kg
from wordcraft_kg.base.errors import ConfigError, MissingExtraError
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.studies import ray_workers
from wordcraft_kg.studies.engine import run_plan
from wordcraft_kg.studies.local_workers import LocalWorkers
from wordcraft_kg.studies.node_check import Expected
from wordcraft_kg.studies.perform import make_graph, perform
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.ray_workers import RayWorkers
from wordcraft_kg.studies.store import collect_study
from wordcraft_kg.studies.tables import lines_of
from wordcraft_kg.studies.tasks import Task
from wordcraft_kg.studies.view import view_study

PATIENCE = 300
"""Seconds: nodes of this cluster share the cores of one machine with other tests."""


@pytest.fixture(scope="module")
def environment():
    """What processes of Ray start with."""
    paths = (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))  # nodes import `play`
        patch.setenv("RAY_TMPDIR", tempfile.gettempdir())  # sockets, whose paths are short
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_worker_niceness", "0")  # else they starve beside other tests
        yield


@pytest.fixture(scope="module")
def cluster(environment):
    """A cluster of one node with a core; tests add others."""
    pytest.importorskip("ray", reason="needs the extra ray")
    from ray.cluster_utils import Cluster

    soon = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 1000}
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": soon}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()


@pytest.fixture
def more(cluster):
    """Add nodes to the cluster for one test, which may kill some: `more(number)`."""
    nodes = []

    def add(number, **settings):
        nodes.extend(cluster.add_node(num_cpus=1, **settings) for _ in range(number))
        return nodes

    yield add
    for node in nodes:
        if node in cluster.worker_nodes:
            cluster.remove_node(node)


def a_task(number, how="works", seconds=0.0, **more):
    settings = {"number": number, "how": how, "seconds": seconds}
    return Task("runs", settings, f"run {number}", **more)


def plan_of(*tasks):
    """A plan without cells, as far as the workers look at it."""
    study = small_plan().study
    return Plan("pretended", study, (), (), {task.address: task for task in tasks}, {})


def notes(root):
    path = root / "notes"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def perform_all(root, address, tasks, meanwhile=lambda: None):
    """Perform tasks on a cluster and leave it; return the outcomes by address.

    `meanwhile` is called about twice a second.
    """
    waiting = list(tasks)
    found = {}
    deadline = time.monotonic() + PATIENCE
    workers = RayWorkers(plan_of(*tasks), root, play, address)
    for outcome in workers.outcomes(lambda: waiting.pop(0) if waiting else None):
        assert time.monotonic() < deadline, found
        meanwhile()
        if outcome is not None:
            found[outcome.address] = outcome
    return found


def table(root):
    """The table of a study, without the durations."""
    lines = lines_of(view_study(collect_study(root, "small")), "success")
    return [line for line in lines if "hour" not in line]


@pytest.mark.slow
def test_processes_one_node_and_three_nodes_give_the_same_table_and_cells(cluster, more, tmp_path):
    plan = small_plan(text=TRAINED.replace("seeds = 2", "seeds = 1"))

    def done(name, make_workers):
        root = tmp_path / name
        state = run_plan(plan, root, make_workers(root), store=root / "cells")
        assert (state.failed, state.done) == ({}, len(plan.tasks))
        # Cells have all results without durations.
        cells = {path.name: path.read_bytes() for path in root.glob("cells/*/*.json")}
        return table(root), cells

    def on_ray(root):
        return RayWorkers(plan, root, perform, cluster.address)

    processes = done("processes", lambda root: LocalWorkers(root, 1, perform))
    assert done("one", on_ray) == processes
    more(2)
    assert done("three", on_ray) == processes
    host = cluster.address.partition(":")[0].encode()
    for path in (tmp_path / "three").rglob("*.*"):
        assert not path.is_file() or host not in path.read_bytes(), f"{path} names a machine"


@pytest.mark.slow
def test_a_killed_node_loses_no_finished_task_and_the_rest_is_performed(
    cluster, more, tmp_path, capfd
):
    tasks = [a_task(number, seconds=2) for number in range(8)]
    killed = []
    nodes = more(2)

    def kill():
        busy = {note["node"] for note in notes(tmp_path)}
        if not killed and len(busy) == 3 and list(tmp_path.glob("runs/*/made")):
            killed.append(nodes[0])
            nodes[0].kill_all_processes(check_alive=False, allow_graceful=False, wait=True)
            cluster.worker_nodes.discard(nodes[0])

    outcomes = perform_all(tmp_path, cluster.address, tasks, kill)
    assert killed
    assert {outcome.termination for outcome in outcomes.values()} == {"done"}
    assert outcomes.keys() == {task.address for task in tasks}
    made = [path.read_text() for path in tmp_path.glob("runs/*/made")]
    assert made == ["once\n"] * len(tasks), "none was lost, and no finished one repeated"
    assert len(notes(tmp_path)) <= len(tasks) + 1, "only the task of the killed node began again"
    assert capfd.readouterr().out == "", "stdout is for the result"


@pytest.mark.slow
def test_a_task_that_always_dies_fails_and_stops_no_other(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_workers, "RETRIES", 1)
    tasks = {how: a_task(number, how) for number, how in enumerate(("dies", "works"))}
    found = perform_all(tmp_path, cluster.address, tasks.values())
    assert found[tasks["works"].address].termination == "done"
    dead = found[tasks["dies"].address]
    assert dead.error.startswith("begun 2 times, its node or process was lost (WorkerCrashedError)")
    begun = [note["task"] for note in notes(tmp_path)]
    assert begun.count(tasks["dies"].address) == 2
    assert {note["threads"] for note in notes(tmp_path)} == {"1"}


@pytest.mark.slow
def test_tasks_that_are_stopped_write_a_checkpoint(cluster, tmp_path):
    task = a_task(0, seconds=PATIENCE)
    tasks = iter([task, None])
    outcomes = RayWorkers(plan_of(task), tmp_path, play, cluster.address).outcomes(tasks.__next__)
    while not notes(tmp_path):
        assert next(outcomes) is None
    time.sleep(0.5)  # until it listens
    outcomes.close()
    assert (task.folder(tmp_path) / "checkpoint").exists()
    assert not (task.folder(tmp_path) / "made").exists()
    assert not list(tmp_path.glob(".shared-*"))


@pytest.mark.slow
def test_a_full_disk_on_a_node_stops_new_tasks_and_keeps_finished_ones(cluster, tmp_path):
    tasks = [a_task(0), a_task(1, "full")]
    found = perform_all(tmp_path, cluster.address, tasks)
    assert [found[task.address].disk_full for task in tasks] == [False, True]
    assert (tasks[0].folder(tmp_path) / "made").exists()


@pytest.mark.slow
def test_a_node_with_another_package_is_refused_before_any_training(
    cluster, more, tmp_path, monkeypatch
):
    """A node with other code or another built-in book is refused by the hash of the package."""
    # Ray lets nodes import from the driver's folder first, which may be a checkout.
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "other"
    package = Path(wordcraft_kg.__file__).parent
    shutil.copytree(package, other / "wordcraft_kg", ignore=shutil.ignore_patterns("__pycache__"))
    with (other / "wordcraft_kg/graphs/books/kitchen.csv").open("a") as book:
        book.write("water,fire,steam\n")
    path = os.pathsep.join([str(other), os.environ["PYTHONPATH"]])
    more(1, env_vars={"PYTHONPATH": path})
    (tmp_path / "results").mkdir()
    message = r"node .* has wordcraft-kg .* \(files .*\); expected .* Install the same package"
    with pytest.raises(ConfigError, match=message):
        perform_all(tmp_path / "results", cluster.address, [a_task(0)])
    assert list((tmp_path / "results").iterdir()) == [], "nothing was begun"


@pytest.mark.slow
def test_resources_that_no_node_has_are_refused_before_any_training(cluster, tmp_path):
    for needs in ({"threads": 64}, {"device": "cuda"}):
        tasks = [a_task(0), a_task(1, **needs)]
        with pytest.raises(ConfigError, match=r"'run 1' needs .* but the nodes have"):
            perform_all(tmp_path, cluster.address, tasks)
    assert notes(tmp_path) == []


@pytest.mark.slow
def test_ctrl_c_on_an_own_cluster_leaves_the_rest_to_the_same_command(environment, tmp_path):
    pytest.importorskip("ray", reason="needs the extra ray")
    study = tmp_path / "small.toml"
    text = TEXT.replace("seeds = 2", "seeds = 1").replace("512", "40_000")
    study.write_text(text.partition("[scorers")[0] + "[variants.none]\n")
    command = [sys.executable, "-m", "wordcraft_kg", "reproduce", str(study), "--engine", "ray"]
    command += ["--jobs", "1", "--json", "--out", str(tmp_path / "results")]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A process group of its own, so that Ctrl-C reaches all processes as on a terminal.
    first = subprocess.Popen(command, start_new_session=True, **pipes)
    deadline = time.monotonic() + PATIENCE
    while not list(tmp_path.glob("results/runs/*/figures.json")):
        assert first.poll() is None, first.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.2)
    os.killpg(first.pid, signal.SIGINT)
    out, err = first.communicate(timeout=PATIENCE)
    assert "tasks are done, repeat the command" in out + err, (out, err)
    kept = len(list(tmp_path.glob("results/*/*/figures.json")))
    second = subprocess.run(command, timeout=PATIENCE, check=True, **pipes)
    values = json.loads(second.stdout)["studies"]["small"]
    assert (values["kept"], values["failed"]) == (kept, {})
    assert values["done"] + kept == 3, "a graph and two runs"


@pytest.mark.parametrize("address", ["10.0.0.1", "ray://127.0.0.1:1", "127.0.0.1:99999"])
def test_an_address_without_a_cluster_is_refused_at_once(tmp_path, address):
    pytest.importorskip("ray", reason="needs the extra ray")
    began = time.monotonic()
    message = f"no Ray cluster at '{address}' .*expected auto or host:port.*ray start"
    with pytest.raises(ConfigError, match=message):
        perform_all(tmp_path, address, [a_task(0)])
    assert time.monotonic() - began < 30
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"SSH-2.0-x\r\n"])
def test_an_address_of_another_program_is_refused_within_seconds(tmp_path, answer):
    """Ray itself tries for minutes where a program listens that is silent or speaks otherwise."""
    pytest.importorskip("ray", reason="needs the extra ray")
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"

        def listen():
            connection, _ = server.accept()
            connection.sendall(answer)
            connection.recv(1024)
            time.sleep(0 if answer else 10)

        threading.Thread(target=listen, daemon=True).start()
        began = time.monotonic()
        with pytest.raises(ConfigError, match=f"no Ray cluster at '{address}'"):
            perform_all(tmp_path, address, [a_task(0)])
    assert time.monotonic() - began < 30
    assert list(tmp_path.iterdir()) == []


def test_without_ray_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match="Ray is not installed"):
        perform_all(tmp_path, "auto", [a_task(0)])


@pytest.fixture
def fit(tmp_path):
    """Requirements of a study, which this process meets."""
    plan = small_plan()
    for task in plan.tasks.values():
        if task.kind == "graphs":
            make_graph(task, tmp_path, plan.books[task.address])
    (tmp_path / ".shared").touch()
    return Expected.of(plan, tmp_path / ".shared")


def test_a_node_that_fits_is_accepted(fit):
    fit.check()


def test_a_node_that_does_not_share_the_folder_is_refused(fit):
    fit.marker.unlink()
    with pytest.raises(ConfigError, match="does not see the files of this study"):
        fit.check()


def test_a_node_with_the_graph_of_another_book_is_refused(fit):
    book = open_book("everyday")
    graph = type(KITCHEN.graph).from_book(book)
    (address,) = fit.graphs
    write_graph_folder(fit.root / address, book, make_split(graph, SplitConfig()), force=True)
    with pytest.raises(ConfigError, match=f"has {graph.hash} in .*; expected the recipe graph"):
        fit.check()
    shutil.rmtree(fit.root / address)
    with pytest.raises(ConfigError, match=r"has no recipe graph .*; expected the recipe graph"):
        fit.check()
    fit.only([]).check()


def test_vectors_that_changed_since_the_plan_fail_with_the_reason(tmp_path):
    vectors = tmp_path / "words.txt"
    vectors.write_text("".join(f"{label} 1 2\n" for label in KITCHEN.graph.entities))
    features = f'[variants.own]\nfeatures = "{vectors}"'
    plan = small_plan(features)
    vectors.write_text(vectors.read_text().replace("1 2", "2 1"))
    (task, *_) = (task for task in plan.tasks.values() if task.title.startswith("own"))
    graph = plan.tasks[task.needs[0]]
    make_graph(graph, tmp_path, plan.books[graph.address])
    outcome = perform(task, tmp_path)
    assert outcome.termination == "failed"
    assert f"the vectors of '{vectors}' have changed since the study was planned" in outcome.error
