"""Nodes as actors of Ray."""

import logging
import os
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Final

from behavexplor.errors import InputError
from behavexplor.execution.cluster.node import ENDING_SECONDS, Node
from behavexplor.execution.executor import available_cores

STORE_BYTES: Final = 128 * 2**20  # of a local cluster's object store: answers of more than 100 kB pass through it


class RayCluster:
    """A cluster of Ray's; see `behavexplor.execution.cluster.supervisor.Cluster`.

    Args:
        address: what `ray.init` takes; empty for a cluster of its own on this machine.
        n_nodes: that it must have room for if it is one of its own; 0 for one a core.

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
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would tell its makers
            room = {"num_cpus": n_nodes or available_cores(), "object_store_memory": STORE_BYTES}
            self._ray.init(address="local", include_dashboard=False, **room, **quiet)
        self.cores = int(self._ray.cluster_resources().get("CPU", 0))
        self._kind = self._ray.remote(num_cpus=1)(Node)
        self._first: dict[Any, Future[bytes]] = {}  # answer of each node
        self._ends: list[Any] = []

    def start(self, *arguments: str) -> Any:
        """Have a `Node` started as an actor."""
        return self._kind.remote(*arguments)

    def ask(self, node: Any, function: str, data: bytes) -> "Future[bytes]":
        """Call `Node.ask`."""
        answer: Future[bytes] = node.ask.remote(function, data).future()
        self._first.setdefault(node, answer)
        return answer

    def end(self, node: Any) -> None:
        """Have the node end its process; one that still waits for room is not begun any more."""
        first = self._first.pop(node, None)
        if first is not None and first.done():
            self._ends.append(node.end.remote())
        else:
            self._ray.kill(node)

    def close(self) -> None:
        """Wait a little for the nodes that end, and leave."""
        with suppress(Exception):  # Ray may be gone
            self._ray.wait(self._ends, num_returns=len(self._ends), timeout=ENDING_SECONDS)
        self._ray.shutdown()

    def _join(self, address: str, quiet: dict[str, Any]) -> None:
        try:
            self._ray.init(address=address, **quiet)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(f"No cluster of Ray's can be joined at {address}: {reason}") from error
