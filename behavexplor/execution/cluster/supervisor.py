"""The executor for clusters. If a node is lost, its calls are made again on another node."""

import json
import queue
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from threading import Lock, Thread
from typing import Any, Final, Protocol

from behavexplor.errors import InputError
from behavexplor.execution.executor import Executor
from behavexplor.execution.fingerprint import FINGERPRINT, difference, machine_fingerprint
from behavexplor.execution.messages import RESULT, settle
from behavexplor.execution.pool import BEGIN_SECONDS

LOSSES: Final = 3  # number of lost nodes after which a call fails, or after which no node is thought able to begin


class ClusterError(RuntimeError):
    """The cluster has repeatedly lost nodes, or has none. This is not a failure of the ADS."""


class Cluster(Protocol):
    """Interface to Ray and Dask. A node is their handle of a `behavexplor.execution.cluster.node.Node`.

    Attributes:
        cores: number of cores of the cluster.
    """

    cores: int

    def start(self, *arguments: str) -> Any:
        """Start a `Node` with these arguments as soon as the cluster has room for it, and return its handle."""

    def ask(self, node: Any, function: str, data: bytes) -> "Future[bytes]":
        """Call `Node.ask`. Any exception of the future means that the node is lost."""

    def end(self, node: Any) -> None:
        """End a node, which may already be lost."""

    def close(self) -> None:
        """Leave the cluster after `end` was called for all nodes."""


@dataclass(eq=False)
class _Call:
    """A call that has not been answered.

    Attributes:
        future: future result.
        function: name of the function.
        data: argument of the function.
        losses: number of nodes that were lost while they processed this call.
    """

    future: "Future[Any]"
    function: str
    data: bytes
    losses: int = 0


@dataclass(eq=False)
class _Node:
    """A node and its unanswered calls.

    Attributes:
        handle: the cluster's handle of the node.
        is_ready: whether the node has loaded the ADS and has the fingerprint of this machine.
        calls: unanswered calls.
    """

    handle: Any
    is_ready: bool = False
    calls: list[_Call] = field(default_factory=list)


class ClusterExecutor(Executor):
    """Calls functions of a service on the nodes of a cluster. Each node has a supervised worker of its own.

    One thread makes all decisions. Other threads send it events.

    Args:
        cluster: the cluster.
        n_nodes: number of nodes. If the cluster has room for fewer, the remaining nodes begin when there is room.
        ads: names of the driving systems, which must be equal on all machines.
        arguments: arguments of `behavexplor.execution.cluster.node.Node`.
        patience: greatest time without any ready node [s].

    Attributes:
        n_nodes: number of nodes.

    Raises:
        InputError: if the first node to answer cannot load the ADS or the environment, or if its fingerprint differs
            from this machine's.
        ClusterError: if no node can begin.
    """

    def __init__(
        self,
        cluster: Cluster,
        n_nodes: int,
        ads: tuple[str, ...],
        arguments: tuple[str, ...],
        patience: float = BEGIN_SECONDS,
    ) -> None:
        self.n_nodes = n_nodes
        self._cluster = cluster
        self._ads, self._arguments = json.dumps(ads).encode(), arguments
        self._fingerprint = machine_fingerprint(ads)
        self._patience = patience
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lock = Lock()  # guards `_closed`
        self._closed = False
        self._nodes: list[_Node] = []  # the supervising thread owns the following fields
        self._waiting: deque[_Call] = deque()
        self._ending = self._aborted = False
        self._false_starts = 0  # in a row
        self._error: Exception | None = None
        self._ready: Future[None] = Future()
        for _ in range(n_nodes):
            self._events.put(self._start)
        self._thread = Thread(target=self._supervise, daemon=True)
        self._thread.start()
        try:
            self._ready.result()
        except BaseException:
            self.shutdown(wait=False)
            raise

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function on the least busy node; see `Executor.submit`."""
        future: Future[bytes] = Future()
        with self._lock:
            if self._closed:
                raise RuntimeError("the cluster has been left")
            self._events.put(partial(self._take, [_Call(future, function, data)]))
        return future

    def stop(self) -> None:
        """Cancel the calls that have not started. Running calls go on until `shutdown`."""
        self._events.put(self._cancel_waiting)

    def shutdown(self, *, wait: bool = True) -> None:
        """Leave the cluster: after all calls if `wait`, else at once."""
        with self._lock:
            first, self._closed = not self._closed, True
            self._events.put(partial(self._leave, aborted=not wait))
        self._thread.join()
        if first:
            self._cluster.close()

    def _supervise(self) -> None:
        """Run the event loop."""
        deadline = time.monotonic() + self._patience
        while not self._aborted and not (self._ending and not self._waiting and not self._working()):
            if self._error or any(node.is_ready for node in self._nodes):
                deadline = time.monotonic() + self._patience
            try:
                self._events.get(timeout=max(deadline - time.monotonic(), 0.0))()
                self._hand_out()
            except queue.Empty:
                if not self._error and not any(node.is_ready for node in self._nodes):
                    self._give_up(ClusterError(f"no node of the cluster has been ready for {self._patience:g} s"))
            except Exception as error:
                self._give_up(error)
        self._give_up(ClusterError("the cluster has been left"))
        for node in self._nodes:
            self._end(node)

    def _working(self) -> bool:
        return any(node.calls for node in self._nodes)

    def _leave(self, *, aborted: bool) -> None:
        self._ending, self._aborted = True, aborted
        if aborted:
            self._cancel_waiting()

    def _cancel_waiting(self) -> None:
        self._waiting = deque(call for call in self._waiting if not call.future.cancel())

    def _take(self, calls: list[_Call]) -> None:
        """Queue calls for a node, or fail them if the cluster was given up."""
        if self._error is None:
            self._waiting.extend(calls)
        else:
            _fail(calls, self._error)

    def _hand_out(self) -> None:
        """Give waiting calls to the least busy nodes."""
        ready = [node for node in self._nodes if node.is_ready]
        while ready and self._waiting:
            call = self._waiting.popleft()
            if not call.future.running() and not call.future.set_running_or_notify_cancel():
                continue
            node = min(ready, key=lambda node: len(node.calls))
            node.calls.append(call)
            self._ask(node, call.function, call.data, partial(self._answered, node, call))

    def _ask(self, node: _Node, function: str, data: bytes, event: Callable[["Future[bytes]"], None]) -> None:
        """Call a function of a node, and send its answer as an event."""
        try:
            answer = self._cluster.ask(node.handle, function, data)
        except Exception as error:
            answer = Future()
            answer.set_exception(error)
        answer.add_done_callback(lambda answer: self._events.put(partial(event, answer)))

    def _start(self) -> None:
        node = _Node(self._cluster.start(*self._arguments))
        self._nodes.append(node)
        self._ask(node, FINGERPRINT, self._ads, partial(self._introduced, node))

    def _introduced(self, node: _Node, answer: "Future[bytes]") -> None:
        """Accept a node that has loaded the ADS, if its fingerprint equals this machine's."""
        if node not in self._nodes:
            return
        try:
            tag, content = answer.result()[:1], answer.result()[1:]
        except (Exception, CancelledError) as error:
            self._false_starts += 1
            if self._false_starts >= LOSSES:
                self._give_up(ClusterError(f"no node of the cluster can begin: {_words(error)}"))
            self._lost(node, error)
            return
        problem = difference(content, self._fingerprint) if tag == RESULT else content.decode()
        if problem is not None:
            self._give_up(InputError(problem))
            return
        self._false_starts, node.is_ready = 0, True
        if not self._ready.done():
            self._ready.set_result(None)

    def _answered(self, node: _Node, call: _Call, answer: "Future[bytes]") -> None:
        if call not in node.calls:  # the node was lost, and the call is made elsewhere
            return
        try:
            content = answer.result()
        except (Exception, CancelledError) as error:
            self._lost(node, error)
            return
        node.calls.remove(call)
        settle(call.future, content)

    def _lost(self, node: _Node, error: BaseException) -> None:
        """Replace a lost node, and put its calls at the front of the queue."""
        self._nodes.remove(node)
        self._end(node)
        for call in node.calls:
            call.losses += 1
        often = [call for call in node.calls if call.losses >= LOSSES]
        _fail(often, ClusterError(f"{LOSSES} nodes were lost one after the other: {_words(error)}"))
        self._waiting.extendleft(call for call in reversed(node.calls) if call not in often)
        node.calls.clear()
        if self._error is None:
            self._start()

    def _end(self, node: _Node) -> None:
        with suppress(Exception):  # the node is lost
            self._cluster.end(node.handle)

    def _give_up(self, error: Exception) -> None:
        """Fail all calls that were or will be submitted."""
        self._error = self._error or error
        if not self._ready.done():
            self._ready.set_exception(self._error)
        calls = [*self._waiting, *(call for node in self._nodes for call in node.calls)]
        self._waiting.clear()
        for node in self._nodes:
            node.calls.clear()
        _fail(calls, self._error)


def _fail(calls: list[_Call], error: Exception) -> None:
    for call in calls:
        if call.future.running() or call.future.set_running_or_notify_cancel():
            call.future.set_exception(error)


def _words(error: BaseException) -> str:
    """Return an error of Ray or Dask as one line: its type, and its last line, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[-1] if lines else ''}"
