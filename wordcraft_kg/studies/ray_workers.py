"""Nodes of a Ray cluster that perform the tasks of a study, in a results folder that they share.

Ray places the tasks, begins a task again whose node or process was lost, and hands Ctrl-C on.
"""

import logging
import os
import socket
import sys
import uuid
from collections.abc import Callable, Generator
from contextlib import ExitStack, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wordcraft_kg.base.errors import ConfigError, reason
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.settings import CORES_VARIABLE, cores
from wordcraft_kg.runs.interruption import sigterm_as_interrupt
from wordcraft_kg.runs.parallel import THREADS_VARIABLES
from wordcraft_kg.studies.local_workers import PATIENCE, TICK
from wordcraft_kg.studies.node_check import Expected
from wordcraft_kg.studies.tasks import Outcome, Task

if TYPE_CHECKING:
    from wordcraft_kg.studies.plan import Plan

RETRIES = 3
"""How often a task is begun again after the loss of its node or process."""
_ANSWER = 300.0
"""Seconds for a node to start a process and to look at the results folder."""
_HTTP2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
"""First bytes of a client of gRPC, with empty settings; a server answers with its own settings."""
_SETTINGS = 4
"""Type of a frame with settings, the fourth byte."""
_Perform = Callable[[Task, Path], Outcome]


@dataclass(frozen=True)
class RayWorkers:
    """Workers that perform each task as a remote call with the task's cores and GPU.

    Attributes:
        plan: the study.
        root: results folder; all nodes see it under the same absolute path.
        perform: see :class:`~wordcraft_kg.studies.local_workers.LocalWorkers`.
        address: host:port of the head node, or auto for the cluster of this machine; None starts a
            cluster on this machine that ends with the study.
        jobs: most tasks at once. Default: the cores of the cluster.
    """

    plan: "Plan"
    root: Path
    perform: _Perform
    address: str | None = None
    jobs: int | None = None

    def outcomes(self, take: Callable[[], Task | None]) -> Generator[Outcome | None, None, None]:
        """Perform tasks until there are no more, see :class:`~.studies.tasks.TaskWorkers`.

        Raises:
            MissingExtraError: without Ray.
            ConfigError: if there is no cluster, or a node does not fit the study, now or later;
                finished tasks stay.
        """
        running: dict[Any, Task] = {}
        with ExitStack() as cleanup:
            ray = _connected(self.address, cleanup)
            marker = self.root.resolve() / f".shared-{uuid.uuid4().hex}"
            marker.touch()
            cleanup.callback(marker.unlink, missing_ok=True)
            expected = Expected.of(self.plan, marker)
            _check_nodes(ray, self.plan, expected)
            cleanup.callback(_stop, ray, running)
            # Once: Ray sends the function to all nodes.
            perform_on_node = ray.remote(_perform_on_node)
            while True:
                # Asked each time, because nodes come and go.
                cores_of_cluster = int(ray.cluster_resources().get("CPU", 0))
                places = self.jobs or max(cores_of_cluster, 1)
                while len(running) < places:
                    task = take()
                    if task is None:
                        break
                    call = _call(perform_on_node, task.threads, _gpus(task))
                    # The first input of a task is its graph.
                    fit = expected.only(task.needs[:1])
                    reference = call.remote(task, self.perform, fit, sys.argv)
                    running[reference] = task
                if not running:
                    return
                ray.wait([*running], timeout=TICK)
                # All that are ready now, not one by one: many may end at once.
                ended, _ = ray.wait([*running], num_returns=len(running), timeout=0)
                for ready in ended:
                    yield _outcome(ray, ready, running.pop(ready))
                yield None


def _perform_on_node(task: Task, perform: _Perform, fit: Expected, command: list[str]) -> Outcome:
    # The record of the run has the command of the study, not that of Ray.
    sys.argv = command
    logging.getLogger("wordcraft_kg").setLevel(logging.ERROR)
    # Again: the node may have joined later.
    fit.check()
    return perform(task, fit.root)


def _gpus(task: Task) -> int:
    return int(task.device.startswith("cuda"))


def _call(remote: Any, threads: int, gpus: int, **options: Any) -> Any:
    # Libraries read the number of threads once, when a process loads them.
    names = (*THREADS_VARIABLES, CORES_VARIABLE)
    variables = dict.fromkeys(names, str(max(threads, 1)))
    options = {"scheduling_strategy": "SPREAD", "max_retries": RETRIES, **options}
    environment = {"env_vars": variables}
    return remote.options(num_cpus=threads, num_gpus=gpus, runtime_env=environment, **options)


def _check_nodes(ray: Any, plan: "Plan", expected: Expected) -> None:
    """Compare all nodes with a study's requirements; ConfigError names the difference."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy as Affinity

    nodes = [node for node in ray.nodes() if node["Alive"]]
    offers = []
    for node in nodes:
        resources = node["Resources"]
        offers.append((int(resources.get("CPU", 0)), int(resources.get("GPU", 0))))
    for task in plan.tasks.values():
        needed = _gpus(task)
        # A task runs on one node: cores of several nodes do not add up.
        if not any(cpus >= task.threads and gpus >= needed for cpus, gpus in offers):
            raise ConfigError(
                f"'{task.title}' needs {task.threads} cores and {needed} GPUs of one node, "
                f"but the nodes have (cores, GPUs) {offers}; change `threads` or `device`."
            )
    check = ray.remote(Expected.check)
    # All nodes are asked before the first answer, which takes long.
    answers = []
    for node in nodes:
        there = Affinity(node["NodeID"], soft=False)
        call = _call(check, 0, 0, scheduling_strategy=there)
        answers.append(call.remote(expected))
    for node, answer in zip(nodes, answers, strict=True):
        try:
            _answer(ray, answer, timeout=_ANSWER)
        except ray.exceptions.RayError as error:
            raise ConfigError(
                f"node '{node['NodeManagerHostname']}' cannot perform tasks ({reason(error)}); "
                f"expected wordcraft-kg {expected.version} in the Python of its `ray start`."
            ) from None


def _answer(ray: Any, reference: Any, timeout: float | None = None) -> Any:
    """Return the result of a call; raise the ConfigError of a node that does not fit."""
    try:
        return ray.get(reference, timeout=timeout)
    except ray.exceptions.RayTaskError as error:
        raise error.cause if isinstance(error.cause, ConfigError) else error from None


def _outcome(ray: Any, reference: Any, task: Task) -> Outcome:
    try:
        outcome: Outcome = _answer(ray, reference)
        return outcome
    except ray.exceptions.RayError as error:
        # Without Ray's message, which names machines: failures are recorded.
        why = f"begun {RETRIES + 1} times, its node or process was lost ({type(error).__name__})"
        hint = "perhaps memory is too small for this many trainings: use fewer `jobs`"
        return Outcome(task.address, "failed", f"{why}; {hint}.")


def _stop(ray: Any, running: dict[Any, Task]) -> None:
    """Let running tasks write a checkpoint."""
    for reference in running:
        ray.cancel(reference)
    if running:
        ray.wait([*running], num_returns=len(running), timeout=PATIENCE)


def _check_address(address: str) -> None:
    """Raise OSError or ValueError unless a server of gRPC answers; Ray itself tries 13 minutes."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=5) as connection:
        if os.environ.get("RAY_USE_TLS") == "1":  # the server waits for a handshake
            return
        connection.sendall(_HTTP2)
        # The head of a frame has nine bytes.
        head = connection.recv(9)
        if head[3:4] != bytes([_SETTINGS]):
            raise ConnectionError("the program there is not Ray")


def _connected(address: str | None, cleanup: ExitStack) -> Any:
    """Import Ray and connect to a cluster; ``cleanup`` leaves it."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is not None:  # Ray tries 20 times, 40 seconds each
        os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "1")
    if address is None and "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
        # Its own cluster opens ports for nobody else. Ray reads these when it is imported.
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex}
    try:
        import ray
    except ImportError:
        raise missing_extra("ray", ["Ray"]) from None
    try:
        # Ray itself tries for minutes.
        if address not in (None, "auto"):
            _check_address(str(address))
        # Stdout is for the result, not for Ray's messages about lost nodes.
        cleanup.enter_context(redirect_stdout(sys.stderr))
        cleanup.callback(ray.shutdown)
        own: dict[str, Any] = {} if address else {"num_cpus": cores(), "include_dashboard": False}
        ray.init(address=address or "local", log_to_driver=False, logging_level="ERROR", **own)
        # Ray has set a handler of its own.
        cleanup.enter_context(sigterm_as_interrupt())
    except Exception as error:
        raise ConfigError(
            f"no Ray cluster at '{address or 'this machine'}' ({reason(error)}); expected auto or "
            "host:port. Run `ray start --head --port=6379` on one machine and `ray start "
            "--address=HOST:6379` on the others, this one included; then repeat the command."
        ) from None
    return ray
