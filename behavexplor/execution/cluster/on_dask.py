"""Cluster nodes as Dask actors."""

import asyncio
from concurrent.futures import Future
from contextlib import suppress
from threading import Thread
from typing import Any, Final

from behavexplor.errors import InputError
from behavexplor.execution.cluster.node import ENDING_SECONDS, Node, NodeLostError
from behavexplor.execution.executor import available_cores

CONNECT_SECONDS: Final = 20.0  # time limit for a scheduler to answer [s]
WATCH_SECONDS: Final = 1.0  # interval between checks that a node is alive [s]


class DaskCluster:
    """A Dask cluster; see `behavexplor.execution.cluster.supervisor.Cluster`.

    Args:
        address: address of the scheduler; empty to start a cluster on this machine.
        n_nodes: number of nodes that a started cluster has room for; 0 for one node for each core.

    Raises:
        InputError: if there is no scheduler at the address.
        ModuleNotFoundError: if Dask is not installed.
    """

    def __init__(self, address: str, n_nodes: int) -> None:
        import distributed  # noqa: PLC0415 - need not be installed

        self._dask: Any = distributed
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._ends: list[Future[None]] = []
        try:
            self.cores = self._run(self._open(address, n_nodes or available_cores())).result()
        except OSError as error:
            self._stop()
            raise InputError(f"No Dask scheduler answers at {address}: start one there") from error

    def start(self, *arguments: str) -> Any:
        """Start a `Node` as an actor, and return its future."""
        return self._run(self._start(arguments))

    def ask(self, node: Any, function: str, data: bytes) -> "Future[bytes]":
        """Call `Node.ask`."""
        return self._run(self._ask(node, function, data))

    def end(self, node: Any) -> None:
        """Make a node end its process."""
        self._ends.append(self._run(self._end(node)))

    def close(self) -> None:
        """Wait briefly for the nodes to end, and leave the cluster."""
        with suppress(Exception):  # the scheduler may be gone
            self._run(self._close()).result(2 * ENDING_SECONDS)
        self._stop()

    def _run(self, coroutine: Any) -> "Future[Any]":
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop)

    def _stop(self) -> None:
        with suppress(Exception):
            self._run(_cancel_all()).result(ENDING_SECONDS)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _open(self, address: str, room: int) -> int:
        """Join the cluster, or start one with threads of this process. Return its number of cores."""
        self._local: Any = None
        if not address:
            threads = {"n_workers": 1, "threads_per_worker": room, "processes": False}
            self._local = await self._dask.LocalCluster(asynchronous=True, dashboard_address="127.0.0.1:0", **threads)
        where = self._local or address
        self._client: Any = await self._dask.Client(where, asynchronous=True, timeout=CONNECT_SECONDS)
        return sum((await self._client.nthreads()).values())

    async def _start(self, arguments: tuple[str, ...]) -> tuple[Any, Any]:
        """Return the future of an actor, which keeps the actor alive, and the actor."""
        while not await self._client.nthreads():  # Dask cannot create an actor before it has a worker
            await asyncio.sleep(WATCH_SECONDS)
        future = self._client.submit(Node, *arguments, actor=True, pure=False)
        return future, await future

    async def _ask(self, node: "Future[Any]", function: str, data: bytes) -> bytes:
        future, actor = await asyncio.wrap_future(node)
        call = asyncio.ensure_future(actor.ask(function, data))
        while not (await asyncio.wait({call}, timeout=WATCH_SECONDS))[0]:
            if future.status != "finished":  # Dask would leave some calls unanswered
                call.cancel()
                raise NodeLostError(f"Dask has {future.status} it")
        answer: bytes = call.result()
        return answer

    async def _end(self, node: "Future[Any]") -> None:
        if not node.done():
            node.cancel()
        elif node.exception() is None:
            await asyncio.wait_for(node.result()[1].end(), ENDING_SECONDS)

    async def _close(self) -> None:
        await asyncio.gather(*map(asyncio.wrap_future, self._ends), return_exceptions=True)
        await self._client.close()
        if self._local is not None:
            await self._local.close()


async def _cancel_all() -> None:
    """Cancel all tasks of this loop, such as the calls of an interrupted campaign."""
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
