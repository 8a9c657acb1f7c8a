"""Tasks on the nodes of a Ray cluster with a shared results folder."""

import contextlib
import logging
import os
import socket
import sys
import time
import uuid
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import ConfigError, reason
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.runs.parallel import CORES_VARIABLE, THREADS_VARIABLES, cores
from wordcraft_kg.studies.tasks import Outcome, Task

RETRIES = 3
"""Restarts of a task after the loss of its node or process; trainings resume from a checkpoint."""
_PATIENCE = 60.0
"""Seconds for writing checkpoints after Ctrl-C."""
_ANSWER = 120.0
"""Seconds for the first process of a node."""


class RayWorkers:
    """Performs tasks on a Ray cluster; all nodes share the results folder under the same path."""

    def __init__(self, root: Path, address: str | None, perform: Callable[[Task, Path], Outcome]):
        """Connect to a cluster and check its nodes.

        Args:
            root: results folder.
            address: host:port of the cluster, ``auto`` for the cluster of this machine, or None for a temporary
                cluster on this machine.
            perform: performs a task, see :func:`~wordcraft_kg.studies.perform.perform`.

        Raises:
            MissingExtraError: without Ray.
            ConfigError: if no cluster answers, or a node has no access to the folder or another package version.
        """
        self.root, self._perform = root.resolve(), perform
        self._running: dict[Any, Task] = {}
        self._refused: list[Outcome] = []
        with contextlib.ExitStack() as stack:
            self._ray = _connected(address, stack)
            self._check_nodes()
            self._cleanup = stack.pop_all()

    @property
    def places(self) -> int:
        """Cores of the cluster; Ray queues tasks of several threads."""
        return max(int(self._ray.cluster_resources().get("CPU", 0)), 1)

    def start(self, task: Task) -> None:
        """Hand a task to the cluster."""
        gpus = int(task.device.startswith("cuda"))
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        if not any(node.get("CPU", 0) >= task.threads and node.get("GPU", 0) >= gpus for node in nodes):
            needs = f"{task.threads} cores" + (" and a GPU" if gpus else "")
            why = f"it needs {needs}, and no node of the cluster has that much. Change `threads` or `device`."
            self._refused.append(Outcome(task.address, "failed", why))
            return
        remote = self._ray.remote(_perform_there).options(
            num_cpus=task.threads,
            num_gpus=gpus,
            max_retries=RETRIES,
            scheduling_strategy="SPREAD",
            # Libraries read the number of threads once.
            runtime_env={"env_vars": dict.fromkeys((*THREADS_VARIABLES, CORES_VARIABLE), str(task.threads))},
        )
        self._running[remote.remote(task, self.root, self._perform, sys.argv)] = task

    def wait(self, seconds: float) -> list[Outcome]:
        """Return the outcome of a finished task; wait at most ``seconds``."""
        refused, self._refused = self._refused, []
        if refused or not self._running:
            return refused
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        return [self._outcome(reference) for reference in ready]

    def stop(self) -> None:
        """Request checkpoints of running tasks, and leave the cluster."""
        with self._cleanup:
            for reference in self._running:
                self._ray.cancel(reference)
            deadline = time.monotonic() + _PATIENCE
            while self._running and time.monotonic() < deadline:
                self.wait(0.5)

    def _outcome(self, reference: Any) -> Outcome:
        from ray.exceptions import RayError, RayTaskError

        address = self._running.pop(reference).address
        try:
            outcome: Outcome = self._ray.get(reference)
            return outcome
        except RayTaskError as error:
            return Outcome(address, "failed", reason(error.cause or error), str(error))
        except RayError as error:
            lost = f"it was begun {RETRIES + 1} times, and its node or process was lost"
            return Outcome(address, "failed", f"{lost}; perhaps there is too little memory ({reason(error)})")

    def _check_nodes(self) -> None:
        from ray.exceptions import RayError
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        self.root.mkdir(parents=True, exist_ok=True)
        marker, expected = self.root / f".shared-{uuid.uuid4().hex}", (True, version("wordcraft-kg"))
        marker.touch()
        try:
            for node in (node for node in self._ray.nodes() if node["Alive"]):
                on_node = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                remote = self._ray.remote(_seen_there).options(num_cpus=0, scheduling_strategy=on_node)
                try:
                    found = self._ray.get(remote.remote(marker), timeout=_ANSWER)
                except RayError as error:
                    found = reason(error)
                if found != expected:
                    raise ConfigError(
                        f"node {node['NodeManagerAddress']} of the Ray cluster cannot work in '{self.root}': found "
                        f"(folder is shared, version of wordcraft-kg) = {found}, expected {expected}. Choose an `out` "
                        "that all nodes share under this path, and install the same version on them."
                    )
        finally:
            marker.unlink()


def _seen_there(marker: Path) -> tuple[bool, str]:
    return marker.exists(), version("wordcraft-kg")


def _perform_there(task: Task, root: Path, perform: Callable[[Task, Path], Outcome], command: list[str]) -> Outcome:
    """Perform a task on this node, with the command line of the study for the records."""
    sys.argv = command
    if not root.is_dir():
        raise ConfigError(f"node {socket.gethostname()}, which has joined the cluster, does not see '{root}'.")
    return perform(task, root)


def _connected(address: str | None, cleanup: contextlib.ExitStack) -> Any:
    """Connect and return the module ``ray``; ``cleanup`` ends the connection."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address is None and "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
        # A token of Ray in the home folder would let a later `ray start --head` refuse other machines.
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex}
    try:
        import ray
    except ImportError:
        raise missing_extra("ray", ["Ray"]) from None
    try:
        if address not in (None, "auto"):  # Ray itself tries for minutes without a way to interrupt
            host, _, port = str(address).rpartition(":")
            socket.create_connection((host.strip("[]"), int(port)), timeout=5).close()
        # Stdout is for the result, not for Ray's messages about lost nodes.
        cleanup.enter_context(contextlib.redirect_stdout(sys.stderr))
        cleanup.callback(ray.shutdown)
        own: dict[str, Any] = {} if address else {"num_cpus": cores(), "include_dashboard": False}
        ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)
    except Exception as error:
        raise ConfigError(
            f"no Ray cluster at '{address or 'this machine'}' ({reason(error)}); expected auto or host:port. Start "
            "one: `ray start --head --port=6379` on one machine, `ray start --address=HOST:6379` on the others; this "
            "machine has to be one of them. The same command goes on then."
        ) from None
    return ray
