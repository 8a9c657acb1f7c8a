"""Tasks on a Ray cluster: inputs go to the nodes and results come back through its object store.

No folder has to be shared. A node works in a folder of its own below its folder for temporary files. A task whose node
or process dies is begun again, elsewhere if need be; one that fails is reported, and not repeated.
"""

import contextlib
import logging
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from errno import EDQUOT, ENOSPC
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from wordcraft_kg.base.artefacts import staged_folder
from wordcraft_kg.base.errors import ArtefactError, ConfigError, MissingExtraError, WordCraftKGError, reason
from wordcraft_kg.base.settings import whole
from wordcraft_kg.runs.side_by_side import CORES_VARIABLE, THREADS_VARIABLES, cores
from wordcraft_kg.studies.figures import FIGURES_FILE
from wordcraft_kg.studies.tasks import Outcome, Task

Perform = Callable[[Task, Path], Outcome]
Files = dict[str, bytes]
"""Content of a folder: bytes by path inside it, with slashes, in their order."""

RETRIES = 3
"""How often a task is begun again whose node or process dies."""
PATIENCE = 60.0
"""Seconds that trainings get to write their checkpoints, and send them, after Ctrl-C."""
ANSWER = 20.0
"""Seconds that a cluster has to answer; Ray itself would try for minutes, and cannot be interrupted."""
NODE_ANSWER = 120.0
"""Seconds that each node has to say which version it has: it starts a process for that."""


class RayWorkers:
    """Performs tasks on the nodes of a Ray cluster."""

    def __init__(self, root: Path, address: str | None, perform: Perform, retries: int = RETRIES):
        """Connect to a cluster.

        Args:
            root: results folder, of this machine alone.
            address: host:port of the cluster; ``auto`` is the one that this machine is a node of; None starts one on
                this machine, which ends with the study.
            perform: performs a task, see :func:`~wordcraft_kg.studies.perform.perform`; every node imports it.
            retries: how often a task is begun again whose node or process dies.

        Raises:
            MissingExtraError: if Ray is not installed.
            ConfigError: if no cluster answers at the address, or a node has another version of this package.
        """
        self.root, self._perform, self._retries = root, perform, whole("retries", retries, 0, 1_000)
        self._session = uuid.uuid4().hex
        self._inputs: dict[str, Any] = {}
        self._running: dict[Any, Task] = {}
        self._refused: list[Outcome] = []
        self._last: Task | None = None
        self._checked: set[str] = set()
        self._cleanup = contextlib.ExitStack()
        self._ray = _connected(address, self._cleanup)
        try:
            self._check_nodes()
        except BaseException:
            self._cleanup.close()
            raise

    @property
    def places(self) -> int:
        """Tasks that run, and how many more like the last one the cluster has cores, and GPUs, for.

        Raises:
            ConfigError: if a node that has joined has another version of this package.
        """
        self._check_nodes()
        there, running = self._ray.cluster_resources(), self._running.values()
        threads = self._last.threads if self._last else 1
        more = int(there.get("CPU", 0) - sum(task.threads for task in running)) // threads
        if self._last and _gpus(self._last):
            more = min(more, int(there.get("GPU", 0)) - sum(map(_gpus, running)))
        return max(len(running) + len(self._refused) + max(more, 0), 1)

    def start(self, task: Task) -> None:
        """Hand a task to the cluster, with its inputs, and what there is of it from an interruption."""
        if error := self._why_not(task):
            self._refused.append(Outcome(task.address, "failed", error))
            return
        for address in task.needs:
            if address not in self._inputs:
                self._inputs[address] = self._ray.put(pack(self.root / address))
        inputs = {address: self._inputs[address] for address in task.needs}
        if task.folder(self.root).exists():
            inputs[task.address] = self._ray.put(pack(task.folder(self.root)))
        there = self._ray.remote(_perform_there).options(
            name=task.address,
            num_cpus=task.threads,
            num_gpus=_gpus(task),
            max_retries=self._retries,
            scheduling_strategy="SPREAD",
            runtime_env=_environment(task.threads),
        )
        arguments = (task, inputs, self._perform, self._session, sys.argv)
        self._running[there.remote(*arguments)] = task
        self._last = task

    def wait(self, seconds: float) -> list[Outcome]:
        """Return the outcome of a task that has ended, with its folder in its place; wait no longer than this."""
        refused, self._refused = self._refused, []
        if refused or not self._running:
            return refused
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        return [self._received(reference) for reference in ready]

    def stop(self) -> None:
        """Ask what runs to write a checkpoint, fetch it, and leave the cluster."""
        from ray.exceptions import RayError

        try:
            for reference in self._running:
                self._ray.cancel(reference)
            deadline = time.monotonic() + PATIENCE
            while self._running and time.monotonic() < deadline:
                self.wait(0.5)
            with contextlib.suppress(RayError):
                self._on_each(self._nodes(), _forget, self._session)
        finally:
            self._running.clear()
            self._cleanup.close()

    def _why_not(self, task: Task) -> str:
        """Return why a task would wait for ever, or an empty string."""
        if task.device not in ("cpu", "cuda", "cuda:0"):
            return f"device {task.device} cannot be chosen on a cluster, which hands out GPUs itself; take device cuda."
        for node in self._nodes():
            has = node["Resources"]
            if has.get("CPU", 0) >= task.threads and has.get("GPU", 0) >= _gpus(task):
                return ""
        needs = f"{task.threads} cores" + (" and a GPU" if _gpus(task) else "")
        return f"it needs {needs}, and no node of the cluster has that much. Add one, or change `threads` or `device`."

    def _received(self, reference: Any) -> Outcome:
        """Put the folder of a task that has ended into its place."""
        from ray.exceptions import RayError, RayTaskError

        task = self._running.pop(reference)
        try:
            outcome, files = self._ray.get(reference)
        except RayTaskError as error:
            return Outcome(task.address, "failed", reason(error.cause or error), str(error))
        except RayError as error:
            times = f"begun {self._retries + 1} times" if self._retries else "begun"
            return Outcome(
                task.address,
                "failed",
                f"it was {times}, and its node or process was lost; perhaps there is too little memory for as many "
                f"tasks as the nodes have cores ({reason(error)})",
            )
        folder = task.folder(self.root)
        if files and not (folder / FIGURES_FILE).exists():
            try:
                unpack(files, folder)
            except (OSError, WordCraftKGError) as error:
                is_full = isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT)
                return Outcome(task.address, "failed", reason(error), disk_full=is_full)
        return outcome

    def _nodes(self) -> list[dict[str, Any]]:
        return [node for node in self._ray.nodes() if node["Alive"]]

    def _check_nodes(self) -> None:
        """Check nodes that are new for the version of this package.

        Raises:
            ConfigError: naming a node that has another one, or none.
        """
        new = [node for node in self._nodes() if node["NodeID"] not in self._checked]
        ours = version("wordcraft-kg")

        # A function of a module would be looked up in this package, which a node may not have.
        def version_there() -> str | None:
            from importlib.metadata import PackageNotFoundError, version

            try:
                return version("wordcraft-kg")
            except PackageNotFoundError:
                return None

        for node, theirs in self._on_each(new, version_there):
            if theirs != ours:
                raise ConfigError(
                    f"node {node['NodeManagerAddress']} of the Ray cluster has "
                    f"{f'wordcraft-kg {theirs}' if theirs else 'no wordcraft-kg'}, and this machine has {ours}; all "
                    "need the same. Install it there, in the Python that runs `ray start`. What is done is safe."
                )
        self._checked |= {node["NodeID"] for node in new}

    def _on_each(self, nodes: list[dict[str, Any]], function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Call a function on all nodes at once; return pairs of node and result, without nodes that are lost."""
        from ray.exceptions import RayError
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        calls = [
            self._ray.remote(function)
            .options(
                num_cpus=0,
                max_retries=0,
                scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False),
                runtime_env=_environment(1),  # the first task goes on in the same process
            )
            .remote(*arguments)
            for node in nodes
        ]
        found = []
        for node, call in zip(nodes, calls, strict=True):
            with contextlib.suppress(RayError):
                found.append((node, self._ray.get(call, timeout=NODE_ANSWER)))
        return found


def pack(folder: Path) -> Files:
    """Return the content of a folder, the same for equal folders; modes and times are left out."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def unpack(files: Files, folder: Path) -> None:
    """Write a folder that was packed; it is there as a whole or not at all, and replaces an unfinished one.

    Raises:
        ArtefactError: if a path leads out of the folder; nothing is written then.
    """
    for name in files:
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or not path.parts or "\\" in name:
            raise ArtefactError(f"a file of '{folder}' came with the path '{name}', which leads elsewhere.")
    with staged_folder(folder, force=True) as staging:
        for name, content in files.items():
            file = staging / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)


def _perform_there(
    task: Task, inputs: dict[str, Any], perform: Perform, session: str, command: list[str]
) -> tuple[Outcome, Files]:
    """Perform a task on the node that this process is of, and take its folder along.

    Args:
        task: the task.
        inputs: references to packed folders by address.
        perform: performs it.
        session: names the node's own folder.
        command: the command line of the study, for the records; that of a Ray process has the addresses of machines.
    """
    import ray
    from filelock import FileLock

    sys.argv = command
    root = _folder_there(session)
    root.mkdir(mode=0o700, exist_ok=True)
    with FileLock(root / "lock"):
        for address, packed in inputs.items():
            if not (root / address).exists():
                unpack(ray.get(packed), root / address)
    outcome = perform(task, root)
    folder = task.folder(root)
    if outcome.disk_full:
        where = f"the disk of node {ray.util.get_node_ip_address()} is full"
        outcome = replace(outcome, error=f"{where}: {outcome.error}", disk_full=False)
    files = pack(folder) if outcome.ending != "failed" and folder.exists() else {}
    shutil.rmtree(folder, ignore_errors=True)
    return outcome, files


def _forget(session: str) -> None:
    """Remove the folder of a session from the node that this process is of."""
    shutil.rmtree(_folder_there(session), ignore_errors=True)


def _folder_there(session: str) -> Path:
    """Return the folder of a session on the node that this process is of; a machine may have several nodes."""
    import ray

    return Path(tempfile.gettempdir()) / f"wordcraft-kg-{session}-{ray.get_runtime_context().get_node_id()[:16]}"


def _gpus(task: Task) -> int:
    return int(task.device.startswith("cuda"))


def _environment(threads: int) -> dict[str, Any]:
    """Return the environment of a process that computes with a number of threads: libraries read it once."""
    return {"env_vars": dict.fromkeys((*THREADS_VARIABLES, CORES_VARIABLE), str(threads))}


def _connected(address: str | None, cleanup: contextlib.ExitStack) -> Any:
    """Return the module ``ray``, connected; ``cleanup`` gets what ends the connection.

    Raises:
        MissingExtraError: if Ray is not installed.
        ConfigError: if no cluster answers.
    """
    # Whatever Ray would report about this machine to its makers stays here.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address is None and "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
        # Ray would leave a token in the home folder, and with it a later `ray start --head` refuses other machines.
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex}
    try:
        import ray
    except ImportError:
        raise MissingExtraError(
            "a study on a Ray cluster needs ray, which is not installed. Install it: pip install 'wordcraft-kg[ray]'"
        ) from None
    if ray.is_initialized():
        raise ConfigError("this process is connected to a Ray cluster already; call ray.shutdown() first.")
    if address is not None:
        _check_address(address)
    own: dict[str, Any] = {"num_cpus": cores(), "include_dashboard": False} if address is None else {}
    cleanup.enter_context(_quiet())
    cleanup.callback(ray.shutdown)
    try:
        ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)
    except Exception as error:
        cleanup.close()
        if address is None:
            raise ConfigError(f"Ray cannot be started on this machine ({reason(error)}).") from None
        raise ConfigError(_unreachable(address, reason(error))) from None
    return ray


def _check_address(address: str) -> None:
    """Check that a cluster answers, in a process of its own that can be ended.

    Raises:
        ConfigError: if none does.
    """
    if address != "auto":
        host, _, port = address.rpartition(":")
        if not host or "/" in address or not port.isdecimal():
            raise ConfigError(f"`address` is '{address}'; expected auto or host:port, such as 10.0.0.1:6379.")
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER / 4).close()
        except (OSError, OverflowError) as error:
            raise ConfigError(_unreachable(address, str(error))) from None
    program = f"import logging, ray; ray.init({address!r}, log_to_driver=False, logging_level=logging.ERROR)"
    try:
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=ANSWER, check=False
        )
    except subprocess.TimeoutExpired as error:
        said = (error.stderr or b"").decode(errors="replace").strip().rpartition("] ")[2]
        why = f"no answer within {ANSWER:.0f} seconds" + (f" ({said})" if said else "")
        raise ConfigError(_unreachable(address, why)) from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise ConfigError(_unreachable(address, lines[-1]))


def _unreachable(address: str, why: str) -> str:
    return (
        f"no Ray cluster at '{address}': {why.rstrip('.')}. Start one: `ray start --head --port=6379` on one machine, "
        "`ray start --address=HOST:6379` on the others; this machine has to be one of them. Nothing was lost: the "
        "same command goes on then."
    )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Ray says about lost nodes and processes out of stdout, where the result goes; it is logged instead."""
    from ray._private import worker

    before = getattr(worker, "print_to_stdstream", None)

    def note(data: dict[str, Any], **_: Any) -> None:
        logging.getLogger(__name__).debug("%s", "\n".join(map(str, data.get("lines", ()))))

    worker.print_to_stdstream = note
    try:
        yield
    finally:
        worker.print_to_stdstream = before
