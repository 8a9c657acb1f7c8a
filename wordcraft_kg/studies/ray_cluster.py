"""A Ray cluster that performs the tasks of a study, by Ray's backend of joblib."""

import os
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from wordcraft_kg.base.errors import ConfigError, reason
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.settings import cores
from wordcraft_kg.runs.interruption import sigterm_as_interrupt


@contextmanager
def ray_cluster(address: str | None) -> Iterator[int]:
    """Connect to a Ray cluster, so that joblib has a backend ``ray``; leave it at the end.

    Args:
        address: host:port of the head node, or auto for the cluster of this machine; None starts a
            cluster on this machine.

    Yields:
        The number of cores of the cluster.

    Raises:
        MissingExtraError: without Ray.
        ConfigError: if there is no such cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray itself tries for minutes to reach an address.
    os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "1")
    settings: dict[str, Any] = {}
    if address is None:
        settings = {"num_cpus": cores(), "include_dashboard": False}
        if "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
            # Its own cluster opens ports for nobody else. Ray reads these when it is imported.
            os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex}
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError:
        raise missing_extra("ray", ["Ray"]) from None
    # Stdout is for the result, not for Ray's messages about lost nodes.
    with redirect_stdout(sys.stderr):
        try:
            ray.init(
                address=address or "local", log_to_driver=False, logging_level="ERROR", **settings
            )
        except Exception as error:
            raise ConfigError(
                f"no Ray cluster at '{address or 'this machine'}' ({reason(error)}); expected auto "
                "or host:port. Run `ray start --head --port=6379` on one machine and `ray start "
                "--address=HOST:6379` on the others, this one included; then repeat the command."
            ) from None
        register_ray()
        try:
            # Ray has set a handler of its own.
            with sigterm_as_interrupt():
                yield int(ray.cluster_resources().get("CPU", 1))
        finally:
            ray.shutdown()
