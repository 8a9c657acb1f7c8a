"""Studies on a real Ray cluster: two nodes on this machine, with processes, object stores and folders of their own."""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from wordcraft_kg.base.errors import ArtefactError, ConfigError, MissingExtraError
from wordcraft_kg.runs.side_by_side import cores
from wordcraft_kg.studies.engine import run_plan
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.ray_workers import RayWorkers, pack, unpack
from wordcraft_kg.studies.study import parse_study
from wordcraft_kg.studies.tasks import Outcome, Task

NEEDED = "scorers/of-all"
STUDY = """
title = "A comparison"
seeds = 1
[settings]
book = "kitchen"
steps = 512
distractors = 1
[scorers.partial]
command = "train-complex"
epochs = 2
dim = 4
folds = 3
[variants.none]
[variants.guided]
scorer = "partial"
"""


def play(task: Task, root: Path) -> Outcome:
    """Pretend to be a training: notes that it has begun in a file that all nodes see, takes its time, and ends."""
    import ray

    settings, folder = task.settings, task.folder(root)
    node = ray.get_runtime_context().get_node_id()
    with Path(settings["notes"]).open("a") as notes:
        made = os.stat(root / NEEDED / "model").st_ino if task.needs else 0
        facts = {"number": settings["number"], "node": node, "pid": os.getpid(), "input": made, "root": str(root)}
        facts |= {
            "gpus": os.environ.get("CUDA_VISIBLE_DEVICES"),
            "threads": os.environ["OMP_NUM_THREADS"],
            "cores": cores(),
        }
        notes.write(json.dumps(facts) + "\n")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text("{}")
    if settings["how"] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if settings["how"] == "fails":
        return Outcome(task.address, "failed", "the oven is broken")
    if settings["how"] == "fills the disk":
        return Outcome(task.address, "failed", "no space", disk_full=True)
    if settings["how"] == "raises":
        raise ValueError("the recipe is wrong")
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append(1))
    for step in range(int(10 * settings["seconds"])):
        time.sleep(0.1)
        if asked:
            (folder / "checkpoint").write_text(str(step))
            return Outcome(task.address, "interrupted")
    went_on = (folder / "checkpoint").exists()
    (folder / "deep").mkdir(exist_ok=True)
    content = (root / NEEDED / "model").read_bytes() if task.needs else b""
    (folder / "deep" / "policy").write_bytes(content + str(settings["number"]).encode())
    (folder / "figures.json").write_text(json.dumps({"went_on": went_on}))
    return Outcome(task.address, "done")


class Here:
    """Performs tasks in this process."""

    places = 1

    def __init__(self, root: Path):
        self.root, self._ended = root, []

    def start(self, task: Task) -> None:
        self._ended.append(perform(task, self.root))

    def wait(self, seconds: float) -> list[Outcome]:
        ended, self._ended = self._ended, []
        return ended

    def stop(self) -> None:
        pass


@pytest.fixture(scope="module", autouse=True)
def environment(tmp_path_factory):
    """What processes of Ray start with; Ray reads some of it when it is imported."""
    paths = (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))  # nodes import `play`
        patch.setenv("RAY_TMPDIR", tempfile.gettempdir())  # sockets, whose paths are short
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("nodes")))
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
def trusted(monkeypatch) -> None:
    """The address is known to be right; trying it in a process of its own takes seconds."""
    monkeypatch.setattr("wordcraft_kg.studies.ray_workers._check_address", lambda address: None)


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    """A results folder, given as most users do, with a scorer."""
    monkeypatch.chdir(tmp_path)
    root = Path("results")
    (root / NEEDED).mkdir(parents=True)
    (root / NEEDED / "model").write_bytes(bytes(range(256)) * 2_000)
    return root


def a_task(number: int, how: str = "works", seconds: float = 0, needs=(NEEDED,), **more) -> Task:
    notes = str(Path("notes").absolute())
    settings = {"number": number, "how": how, "seconds": seconds, "notes": notes}
    return Task("runs", settings, f"run {number}", needs, **more)


def notes() -> list[dict]:
    path = Path("notes")
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def until(condition, seconds: float = 30) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def ended(workers: RayWorkers, number: int) -> list[Outcome]:
    found: list[Outcome] = []
    deadline = time.monotonic() + 60
    while len(found) < number:
        assert time.monotonic() < deadline, found
        found += workers.wait(0.5)
    return found


def test_nothing_is_lost_or_double_when_a_node_is_killed_in_the_middle(cluster, second, root, capfd):
    tasks = [a_task(number, seconds=1.5) for number in range(6)]
    workers = RayWorkers(root, cluster.address, play)
    try:
        assert workers.places == 2
        for task in tasks[:2]:
            workers.start(task)
        assert workers.places == 2
        for task in tasks[2:]:
            workers.start(task)
        until(lambda: len({note["node"] for note in notes()}) == 2)
        head = {note["node"] for note in notes()} - {second.node_id}
        second.kill_all_processes(check_alive=False, allow_graceful=False, wait=True)
        cluster.worker_nodes.discard(second)
        outcomes = ended(workers, len(tasks))
        assert workers.places == 1
    finally:
        workers.stop()
    assert sorted(outcome.address for outcome in outcomes) == sorted(task.address for task in tasks)
    assert {outcome.ending for outcome in outcomes} == {"done"}
    assert sorted(f"{path.parent.name}/{path.name}" for path in root.glob("*/*")) == sorted(
        [NEEDED, *(task.address for task in tasks)]
    ), "every run is there, and nothing else"
    for task in tasks:
        expected = (root / NEEDED / "model").read_bytes() + str(task.settings["number"]).encode()
        assert (task.folder(root) / "deep/policy").read_bytes() == expected
    begun = notes()
    (killed,) = {note["number"] for note in begun if note["node"] == second.node_id}
    assert sorted(note["number"] for note in begun) == sorted([*range(6), killed]), "only that one was begun again"
    assert len({note["input"] for note in begun if note["node"] in head}) == 1, "a node unpacks its inputs once"
    folders = {note["node"]: Path(note["root"]) for note in begun}
    assert not folders[head.pop()].exists(), "nothing stays on a node that lives"
    assert capfd.readouterr().out == "", "stdout is for the result"


def test_failures_have_a_clear_line_and_only_crashes_are_begun_again(trusted, cluster, second, root):
    tasks = {
        how: a_task(number, how) for number, how in enumerate(("works", "fails", "raises", "dies", "fills the disk"))
    }
    tasks["on a GPU"] = a_task(10, device="cuda")
    tasks["two threads"] = a_task(11, threads=2)
    tasks["another GPU"] = a_task(12, device="cuda:1")
    tasks["is there meanwhile"] = a_task(13, seconds=1)
    workers = RayWorkers(root, cluster.address, play, retries=1)
    try:
        for task in tasks.values():
            workers.start(task)
        folder = tasks["is there meanwhile"].folder(root)
        folder.mkdir(parents=True)
        (folder / "figures.json").write_text("of somebody else")
        found = {outcome.address: outcome for outcome in ended(workers, len(tasks))}
    finally:
        workers.stop()
    outcomes = {how: found[task.address] for how, task in tasks.items()}
    good = {"works", "on a GPU", "is there meanwhile"}
    assert {how for how, outcome in outcomes.items() if outcome.ending == "done"} == good, outcomes
    assert {outcome.ending for how, outcome in outcomes.items() if how not in good} == {"failed"}
    assert [path.name for path in folder.iterdir()] == ["figures.json"], "what is done is kept"
    assert outcomes["fails"].error == "the oven is broken"
    assert outcomes["raises"].error == "ValueError: the recipe is wrong"
    assert "in play" in outcomes["raises"].detail
    assert outcomes["dies"].error.startswith("it was begun 2 times, and its node or process was lost")
    assert not outcomes["fills the disk"].disk_full, "the disk of the results folder is not"
    assert outcomes["fills the disk"].error.startswith("the disk of node ")
    assert "needs 2 cores, and no node of the cluster has that much" in outcomes["two threads"].error
    assert "take device cuda" in outcomes["another GPU"].error
    begun = [note["number"] for note in notes()]
    assert sorted(begun) == [0, 1, 2, 3, 3, 4, 10, 13]
    on_gpu = next(note for note in notes() if note["number"] == 10)
    assert on_gpu["gpus"] == "0"
    assert {(note["threads"], note["cores"]) for note in notes()} == {("1", 1)}
    there = {path.name for path in root.glob("runs/*")}
    assert there == {tasks[how].address.removeprefix("runs/") for how in good}


def test_what_is_stopped_sends_its_checkpoint_and_goes_on_from_it(trusted, cluster, root):
    task = a_task(0, seconds=60)
    workers = RayWorkers(root, cluster.address, play)
    try:
        workers.start(task)
        workers.start(a_task(1))
        until(notes)
    finally:
        workers.stop()
    assert (task.folder(root) / "checkpoint").exists()
    assert not (task.folder(root) / "figures.json").exists()
    assert [path.name for path in root.glob("runs/*")] == [task.address.removeprefix("runs/")]
    task.settings["seconds"] = 0
    workers = RayWorkers(root, cluster.address, play)
    try:
        workers.start(task)
        (outcome,) = ended(workers, 1)
    finally:
        workers.stop()
    assert outcome.ending == "done"
    assert json.loads((task.folder(root) / "figures.json").read_text()) == {"went_on": True}


def test_a_study_on_a_cluster_gives_the_bytes_of_one_on_this_machine(trusted, cluster, second, tmp_path, monkeypatch):
    def done(name: str, make_workers) -> Path:
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        state = run_plan(plan, Path("results"), make_workers)
        assert state.failed == {}
        assert state.done == len(plan.tasks) == 4
        return tmp_path / name / "results"

    plan = make_plan(parse_study(STUDY, "a test"), "small")
    local = done("local", lambda: Here(Path("results")))
    ray = done("ray", lambda: RayWorkers(Path("results"), cluster.address, perform))
    ours, theirs = pack(local), pack(ray)
    assert list(ours) == list(theirs)
    timed = ("run.json", "figures.json", "metrics.jsonl", "metrics.json", "trace.jsonl", "evaluation.json", "README.md")
    different = [name for name in ours if ours[name] != theirs[name] and not name.endswith(timed)]
    assert different == []
    for name in (name for name in ours if name.startswith("runs/") and name.endswith("figures.json")):
        assert ours[name.replace("figures.json", "policy.safetensors")]
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
        workers = RayWorkers(root, None, play)
        try:
            assert workers.places == cores()
            workers.start(a_task(number))
            (outcome,) = ended(workers, 1)
        finally:
            workers.stop()
        assert outcome.ending == "done"


def test_a_node_with_another_version_is_refused_before_anything_begins(trusted, cluster, root, monkeypatch):
    monkeypatch.setattr("wordcraft_kg.studies.ray_workers.version", lambda name: "99.0")
    with pytest.raises(
        ConfigError, match=r"node .* has wordcraft-kg .*, and this machine has 99\.0; all need the same"
    ):
        RayWorkers(root, cluster.address, play)
    import ray

    assert not ray.is_initialized()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("10.0.0.1", "expected auto or host:port"),
        ("ray://10.0.0.1:10001", "expected auto or host:port"),
        ("127.0.0.1:99999", "no Ray cluster at '127.0.0.1:99999'"),
        ("nowhere.invalid:6379", "no Ray cluster at 'nowhere.invalid:6379'.*ray start --head.*Nothing was lost"),
    ],
)
def test_an_address_without_a_cluster_is_refused_at_once(root, address, said):
    pytest.importorskip("ray", reason="needs the extra ray")
    began = time.monotonic()
    with pytest.raises(ConfigError, match=said):
        RayWorkers(root, address, play)
    assert time.monotonic() - began < 10


def test_something_else_that_listens_is_no_cluster(root, monkeypatch):
    pytest.importorskip("ray", reason="needs the extra ray")
    monkeypatch.setattr("wordcraft_kg.studies.ray_workers.ANSWER", 2.0)
    said = r"no answer within 2 seconds\. .*ray start --address=HOST:6379"
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(ConfigError, match=said):
        RayWorkers(root, f"127.0.0.1:{server.getsockname()[1]}", play)


def test_without_ray_the_extra_is_named(root, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'wordcraft-kg\[ray\]'"):
        RayWorkers(root, "auto", play)


def test_ray_is_imported_by_those_who_use_it_alone():
    code = "import sys, wordcraft_kg.studies.ray_workers\nprint({'ray'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_folder_that_is_packed_comes_out_the_same(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for folder, names in ((first, ("a", "b/c", "b/d")), (second, ("b/d", "b/c", "a"))):
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(name)
    assert list(pack(first).items()) == list(pack(second).items()), "in whatever order it was written"
    (first / "run.json").touch()
    (first / "old").touch()
    unpack(pack(second), first)
    assert pack(first) == pack(second), "the old folder is replaced as a whole"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first", "second"]


@pytest.mark.parametrize("name", ["/etc/passwd", "../neighbour", "deep/../../neighbour", "..\\neighbour", ""])
def test_no_file_leads_out_of_the_folder_that_was_packed(tmp_path, name):
    with pytest.raises(ArtefactError, match="leads elsewhere"):
        unpack({"fine": b"", name: b""}, tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []
