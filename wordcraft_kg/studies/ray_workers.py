"""Tasks on Ray cluster nodes with a shared results folder."""

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
"""Restarts for a task after losing its node or process; trainings resume from a checkpoint."""
_PATIENCE = 60.0
"""Seconds for writing checkpoints after Ctrl-C."""


class RayWorkers:
    """Workers that perform tasks on a Ray cluster; all nodes share the results folder under the same path.

    Before a task starts, its node checks the folder and the package version.
    """

    def __init__(self, root: Path, address: str | None, perform: Callable[[Task, Path], Outcome]):
        """Connect to a cluster, or start a temporary one without an address.

        The address is host:port, or ``auto`` for a cluster on this machine; for ``perform`` see
        :func:`~wordcraft_kg.studies.perform.perform`. Without Ray it is a MissingExtraError, without an answer a
        ConfigError.
        """
        self._running: dict[Any, Task] = {}
        self._refused: list[Outcome] = []
        root = root.resolve()
        root.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack:
            self._ray = _connected(address, stack)
            marker = root / f".shared-{uuid.uuid4().hex}"
            marker.touch()
            stack.callback(marker.unlink)
            self._common = (root, perform, sys.argv, marker, version("wordcraft-kg"))
            self._cleanup = stack.pop_all()

    @property
    def places(self) -> int:
        """Number of CPU cores in the cluster; Ray delays tasks that need several cores."""
        return max(int(self._ray.cluster_resources().get("CPU", 0)), 1)

    def start(self, task: Task) -> None:
        """Submit a task to the cluster."""
        gpus = int(task.device.startswith("cuda"))
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        if not any(node.get("CPU", 0) >= task.threads and node.get("GPU", 0) >= gpus for node in nodes):
            needs = f"{task.threads} cores" + (" and a GPU" if gpus else "")
            why = f"the task needs {needs}, more than any cluster node has. Change `threads` or `device`."
            self._refused.append(Outcome(task.address, "failed", why))
            return
        remote = self._ray.remote(_perform_on_node).options(
            num_cpus=task.threads,
            num_gpus=gpus,
            max_retries=RETRIES,
            scheduling_strategy="SPREAD",
            # Libraries read the number of threads once.
            runtime_env={"env_vars": dict.fromkeys((*THREADS_VARIABLES, CORES_VARIABLE), str(task.threads))},
        )
        self._running[remote.remote(task, *self._common)] = task

    def wait(self, seconds: float) -> list[Outcome]:
        """Return the outcome of a finished task, if any, after at most ``seconds``."""
        refused, self._refused = self._refused, []
        if refused or not self._running:
            return refused
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        return [self._outcome(reference) for reference in ready]

    def stop(self) -> None:
        """Let running tasks write a checkpoint, then disconnect from the cluster."""
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
            lost = f"the task was begun {RETRIES + 1} times, and its node or process was lost"
            return Outcome(address, "failed", f"{lost}; perhaps memory is too small ({reason(error)})")


def _perform_on_node(
    task: Task, root: Path, perform: Callable[[Task, Path], Outcome], command: list[str], marker: Path, expected: str
) -> Outcome:
    sys.argv = command
    if not marker.exists() or version("wordcraft-kg") != expected:
        raise ConfigError(
            f"node {socket.gethostname()} cannot work in '{root}': folder shared: {marker.exists()}, wordcraft-kg "
            f"{version('wordcraft-kg')}; expected True and {expected}. Choose an `out` that all nodes share under this "
            "path, and install the same version on all nodes."
        )
    return perform(task, root)


def _connected(address: str | None, cleanup: contextlib.ExitStack) -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address is None and "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
        # A Ray token in the home folder would let a later `ray start --head` refuse all other machines.
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
            f"no Ray cluster at '{address or 'this machine'}' ({reason(error)}); expected auto or host:port. Run `ray "
            "start --head --port=6379` on a machine and `ray start --address=HOST:6379` on all further machines, "
            "including this machine; then repeat the command."
        ) from None
    return ray
