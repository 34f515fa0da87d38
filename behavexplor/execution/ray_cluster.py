"""The executor for Ray clusters: an actor on each node holds a supervised worker, as on a single machine.

Ray places the actors, and restarts lost ones when it has room. The calls of a lost actor are made again on another one.
"""

import asyncio
import json
import logging
import os
import re
import socket
import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Timer
from typing import Any, Final, NamedTuple
from weakref import WeakSet

from behavexplor.errors import InputError, missing_library, unknown_name
from behavexplor.execution.executor import BATCHES, LOCK_STEP, Executor, available_cores
from behavexplor.execution.fingerprint import FINGERPRINT, difference, machine_fingerprint
from behavexplor.execution.messages import REFUSED, RESULT, answered_error, error_answer, error_words, settle
from behavexplor.execution.pool import BEGIN_SECONDS, WorkerPool
from behavexplor.execution.service import Recipe

MAX_NODES: Final = 256  # the most that can be asked for, or that are taken of a larger cluster
LOSSES: Final = 3  # number of lost nodes after which a call fails
ANSWER_SECONDS: Final = 10.0  # time limit for a cluster to answer, and for its nodes to end their workers [s]
STORE_BYTES: Final = 128 * 2**20  # size of a local cluster's object store, used for answers of more than 100 kB

_ADDRESS = re.compile(r"(?:ray://)?(?P<host>\[[0-9a-fA-F:.]+\]|[\w.-]+):(?P<port>\d{1,5})")


class ClusterError(RuntimeError):
    """The cluster has repeatedly lost nodes, or has none. This is not a failure of the ADS."""


def parse_cluster(text: str) -> str:
    """Return the address in the name of a cluster, as Ray takes it. An empty one means a new cluster on this machine.

    A name is "ray", alone or followed by ":" and an address: "ray:10.0.0.5:6379", "ray://10.0.0.5:10001". "ray:auto" is
    the cluster that this machine belongs to.

    Raises:
        InputError: if the name is none of these.
    """
    kind, separator, address = text.partition(":")
    if kind != "ray":
        raise unknown_name('cluster ("ray", with or without ":" and an address)', kind, ["ray"])
    if not separator or address == "auto":
        return address
    address = f"ray:{address}" if address.startswith("//") else address
    found = _ADDRESS.fullmatch(address)
    if found is None or not 0 < int(found["port"]) < 65536:
        raise InputError(f"--cluster {text} has an invalid address: write ray:10.0.0.5:6379 or ray://10.0.0.5:10001")
    return address


class Limits(NamedTuple):
    """Limits of a node's worker."""

    time: float  # of one call [s]
    memory: float  # of the process [GiB]


class Node:
    """The actor on a node: it calls its worker, and answers with tagged bytes, see `behavexplor.execution.messages`.

    `ads` is a JSON list of the driving systems that must be equal on all machines. A worker with another `fingerprint`
    than the campaign's machine refuses all calls. The node works in `folder`, the campaign's working folder, if it has
    such a folder.
    """

    def __init__(self, recipe: Recipe, limits: Limits, ads: bytes, fingerprint: bytes, folder: str) -> None:
        if Path(folder).is_dir():
            os.chdir(folder)
        sys.path.append(str(Path.cwd()))  # for the user's own drivers and specs
        self._place = f" (on the node {socket.gethostname()})"
        try:
            self._pool = WorkerPool(1, recipe, limits.time, limits.memory)
            problem = difference(self._pool.submit(FINGERPRINT, ads).result(), fingerprint)
        except Exception as error:
            problem = error_words(error, self._place)
        self._problem = REFUSED + problem.encode(errors="replace") if problem else b""

    async def begin(self) -> bytes:
        """Answer with an empty result if the node is ready, or else with its problem."""
        return self._problem or RESULT

    async def ask(self, function: str, data: bytes) -> bytes:
        """Call a function of the worker's service."""
        if self._problem:
            return self._problem
        try:
            answer = await asyncio.wrap_future(self._pool.submit(function, data))
            return RESULT + answer
        except (Exception, asyncio.CancelledError) as error:  # `stop` cancels calls that have not started
            return error_answer(error, self._place)

    async def stop(self) -> None:
        """Ask the worker, which a node that is ready has, to end a long call early."""
        self._pool.stop()

    async def end(self) -> None:
        """End the process of the worker, which a node that is ready has, by force if need be."""
        await asyncio.to_thread(self._pool.shutdown, wait=False)


class _Call(NamedTuple):
    """A call of a function, and the number of actors that were lost while they processed it."""

    future: "Future[bytes]"
    function: str
    data: bytes
    losses: int


class RayExecutor(Executor):
    """Calls functions of a service on the nodes of a Ray cluster. Each node has a supervised worker of its own.

    `cluster` is a name as in `parse_cluster`, and `nodes` is the number of nodes (0: one for each core). Each worker is
    made by `recipe`, within `limits`. If the cluster has room for fewer nodes, the others begin when there is room. The
    service must have the function "fingerprint". `ads` are names of driving systems that must be equal on all machines.

    One thread makes all decisions. Other threads, such as Ray's, tell it what to do next.

    Raises:
        InputError: if there is no such cluster, if Ray is not installed, or if the first node to answer cannot load the
            ADS or the environment, or would not reproduce this machine's results.
        ClusterError: if the first node to answer cannot begin, or none answers in time.
    """

    def __init__(self, cluster: str, nodes: int, recipe: Recipe, limits: Limits, ads: tuple[str, ...]) -> None:
        self._ray = _ray_in_cluster(parse_cluster(cluster), nodes)
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        self.n_nodes = nodes or max(min(cores, MAX_NODES), 1)
        self._thread = ThreadPoolExecutor(1)
        self._calls_at_once = 1 if recipe.long_calls else sys.maxsize  # of one actor
        self._left = False  # whether `shutdown` has been called
        # only the thread changes this and the following fields
        self._stopped = False  # whether the calls are to end, after which lost calls are not repeated
        self._calls: WeakSet[Future[bytes]] = WeakSet()  # all that someone still waits for
        self._waiting: deque[_Call] = deque()
        self._calls_of_ready: dict[Any, set[Future[bytes]]] = {}  # calls of each actor that has begun and is not lost
        self._timer: Timer | None = None  # gives up while no actor is ready; see `_await_begin`
        self._error: Exception | None = None
        self._first_ready: Future[None] = Future()
        # Ray repeats `begin`; calls are repeated on other nodes
        node = self._ray.remote(num_cpus=1, max_restarts=-1, max_task_retries=LOSSES - 1)(Node)
        settings = (recipe, limits, json.dumps(ads).encode(), machine_fingerprint(ads), str(Path.cwd()))
        self._actors = [node.remote(*settings) for _ in range(self.n_nodes)]
        self._enqueue(self._await_begin, *self._actors)
        try:
            self._first_ready.result()
        except BaseException:
            self.shutdown(wait=False)
            raise

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function on the least busy node; see `Executor.submit`."""
        if self._left:
            raise RuntimeError("the cluster has been left")
        future: Future[bytes] = Future()
        self._enqueue(self._add, _Call(future, function, data, 0))
        return future

    @property
    def room(self) -> int:  # type: ignore[override]
        """Number of further calls for the nodes that are ready, as if each worked in batches of `LOCK_STEP`."""
        calls_of_nodes = list(self._calls_of_ready.values())  # at once: the thread changes it meanwhile
        n_given = sum(len(calls) for calls in calls_of_nodes)
        return BATCHES * LOCK_STEP * len(calls_of_nodes) - n_given - len(self._waiting)

    def stop(self) -> None:
        """Cancel calls that have not started, and ask running calls to end early."""
        self._enqueue(self._stop)

    def shutdown(self, *, wait: bool = True) -> None:
        """Leave the cluster: after all calls if `wait`, else at once."""
        if self._left:
            return
        if wait:
            unanswered = self._thread.submit(self._unanswered).result()
            wait_for(unanswered)
        self._left = True
        self._enqueue(self._stop)
        self._enqueue(self._give_up, ClusterError("the cluster has been left"))
        self._thread.shutdown()
        with suppress(Exception):  # Ray may be gone
            ends = [actor.end.remote() for actor in self._calls_of_ready]
            self._ray.wait(ends, num_returns=len(ends), timeout=ANSWER_SECONDS)
        self._ray.shutdown()  # this ends the actors

    def _enqueue(self, step: Callable[..., None], *arguments: Any) -> None:
        """Let the thread take a step after the present ones."""
        with suppress(RuntimeError):  # the cluster has been left
            self._thread.submit(self._run_step, step, *arguments)

    def _run_step(self, step: Callable[..., None], *arguments: Any) -> None:
        """Take a step in the thread, and give calls to the actors that are free after it."""
        try:
            step(*arguments)
            self._hand_out()
        except Exception as error:
            self._give_up(_cluster_error("the cluster cannot be used", error))

    def _await_begin(self, *actors: Any) -> None:
        """Ask actors, which are new or were lost, to tell when they have begun; give up if none is ready in time."""
        for actor in actors:
            self._calls_of_ready.pop(actor, None)
            actor.begin.remote().future().add_done_callback(partial(self._enqueue, self._count_as_ready, actor))
        if not self._calls_of_ready:
            error = ClusterError(f"no node of the cluster has been ready for {BEGIN_SECONDS:g} s")
            self._timer = Timer(BEGIN_SECONDS, self._enqueue, [self._give_up, error])
            self._timer.daemon = True
            self._timer.start()

    def _count_as_ready(self, actor: Any, answer: "Future[bytes]") -> None:
        """Count an actor as ready; or give up if it cannot begin, or has a problem."""
        error = answer.exception()
        problem = answered_error(answer.result()) if error is None else _cluster_error("a node cannot begin", error)
        if problem is not None:
            self._give_up(problem)
        elif self._error is None:
            if self._timer is not None:
                self._timer.cancel()
            self._calls_of_ready[actor] = set()
            if not self._first_ready.done():
                self._first_ready.set_result(None)

    def _unanswered(self) -> list["Future[bytes]"]:
        return [future for future in self._calls if not future.done()]

    def _add(self, call: _Call) -> None:
        """Let a new call wait, or fail it if the cluster was given up."""
        self._calls.add(call.future)
        self._waiting.append(call)
        if self._error is not None:
            self._give_up(self._error)

    def _hand_out(self) -> None:
        """Give waiting calls to the least busy actors that have room for them."""
        while self._waiting and (free := self._free()):
            call = self._waiting.popleft()
            if call.future.done():  # cancelled while it waited
                continue
            # a future is running already if its first node was lost
            if not call.future.running() and not call.future.set_running_or_notify_cancel():
                continue
            actor = min(free, key=lambda actor: len(self._calls_of_ready[actor]))
            self._calls_of_ready[actor].add(call.future)
            answer = actor.ask.options(max_task_retries=0).remote(call.function, call.data).future()
            answer.add_done_callback(partial(self._enqueue, self._answered, actor, call))

    def _free(self) -> list[Any]:
        """Return the actors that are ready and have room for a call."""
        return [actor for actor, calls in self._calls_of_ready.items() if len(calls) < self._calls_at_once]

    def _answered(self, actor: Any, call: _Call, answer: "Future[bytes]") -> None:
        """Pass an answer on. If its actor is lost, let the call wait again."""
        error = answer.exception()
        if actor in self._calls_of_ready:
            self._calls_of_ready[actor].discard(call.future)
            if error is not None:  # the first of its calls to fail; Ray restarts the actor
                self._await_begin(actor)
        if call.future.done():  # the cluster was given up
            return
        if error is None:
            settle(call.future, answer.result())
            return
        losses = call.losses + 1
        if losses < LOSSES and not self._stopped:
            self._waiting.append(call._replace(losses=losses))
        else:
            call.future.set_exception(_cluster_error(f"a node was lost in attempt {losses} of the call", error))

    def _stop(self) -> None:
        """Cancel calls that have not started, and ask the nodes to end the others early."""
        self._stopped = True
        for future in self._unanswered():
            if future.cancel():
                future.set_running_or_notify_cancel()  # wakes those that wait for it, which `cancel` alone does not
        for actor in self._calls_of_ready:
            actor.stop.remote()

    def _give_up(self, error: Exception) -> None:
        """Fail all calls that were or will be submitted."""
        if self._timer is not None:
            self._timer.cancel()
        self._error = self._error or error
        if not self._first_ready.done():
            self._first_ready.set_exception(self._error)
        for future in self._unanswered():
            if future.running() or future.set_running_or_notify_cancel():
                future.set_exception(self._error)
        self._waiting.clear()


def _ray_in_cluster(address: str, nodes: int) -> Any:
    """Join a cluster, or start one on this machine, and return the module `ray`."""
    try:
        import ray  # noqa: PLC0415 - need not be installed
    except ModuleNotFoundError as error:
        raise missing_library("--cluster ray", error.name, "ray") from None
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that is started here sends no usage statistics
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if not address:
        options |= {"num_cpus": nodes or available_cores(), "object_store_memory": STORE_BYTES}
    try:
        if found := _ADDRESS.fullmatch(address):
            _check_server(found["host"].strip("[]"), int(found["port"]))
        ray.init(address=address or "local", include_dashboard=False, **options)
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise InputError(f"The Ray cluster {address or 'on this machine'} cannot be joined: {reason}") from error
    return ray


def _check_server(host: str, port: int) -> None:
    """Check that a server listens at an address. Without one, Ray tries for minutes, and then ends the process."""
    socket.create_connection((host, port), ANSWER_SECONDS).close()


def _cluster_error(what: str, error: BaseException) -> ClusterError:
    """Return an error in one line: what failed, the type of Ray's own error, and its last line, which says most."""
    last = str(error).strip().rpartition("\n")[2].strip()
    return ClusterError(f"{what}: {type(error).__name__}: {last}")
