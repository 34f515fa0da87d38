"""Cluster nodes as Ray actors."""

import logging
import os
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Final

from behavexplor.errors import InputError
from behavexplor.execution.cluster.node import ENDING_SECONDS, Node
from behavexplor.execution.executor import available_cores

STORE_BYTES: Final = 128 * 2**20  # size of a local cluster's object store, used for answers of more than 100 kB


class RayCluster:
    """A Ray cluster; see `behavexplor.execution.cluster.supervisor.Cluster`.

    Args:
        address: address of the cluster as `ray.init` takes it; empty to start a cluster on this machine.
        n_nodes: number of nodes that a started cluster has room for; 0 for one node for each core.

    Raises:
        InputError: if there is no cluster at the address.
        ModuleNotFoundError: if Ray is not installed.
    """

    def __init__(self, address: str, n_nodes: int) -> None:
        import ray  # noqa: PLC0415 - need not be installed

        self._ray: Any = ray
        quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
        if address:
            self._join(address, quiet)
        else:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # do not send usage statistics
            room = {"num_cpus": n_nodes or available_cores(), "object_store_memory": STORE_BYTES}
            self._ray.init(address="local", include_dashboard=False, **room, **quiet)
        self.cores = int(self._ray.cluster_resources().get("CPU", 0))
        self._kind = self._ray.remote(num_cpus=1)(Node)
        self._first: dict[Any, Future[bytes]] = {}  # first answer of each node
        self._ends: list[Any] = []

    def start(self, *arguments: str) -> Any:
        """Start a `Node` as an actor, and return its handle."""
        return self._kind.remote(*arguments)

    def ask(self, node: Any, function: str, data: bytes) -> "Future[bytes]":
        """Call `Node.ask`."""
        answer: Future[bytes] = node.ask.remote(function, data).future()
        self._first.setdefault(node, answer)
        return answer

    def end(self, node: Any) -> None:
        """Make a node end its process, or cancel a node that still waits for room."""
        first = self._first.pop(node, None)
        if first is not None and first.done():
            self._ends.append(node.end.remote())
        else:
            self._ray.kill(node)

    def close(self) -> None:
        """Wait briefly for the nodes to end, and leave the cluster."""
        with suppress(Exception):  # Ray may be gone
            self._ray.wait(self._ends, num_returns=len(self._ends), timeout=ENDING_SECONDS)
        self._ray.shutdown()

    def _join(self, address: str, quiet: dict[str, Any]) -> None:
        try:
            self._ray.init(address=address, **quiet)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(f"The Ray cluster at {address} cannot be joined: {reason}") from error
