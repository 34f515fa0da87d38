"""Worker processes: whatever happens in one, its task has an outcome and the others go on."""

import fcntl
import gc
import logging
import math
import multiprocessing
import os
import resource
import signal
import time
from collections import deque
from concurrent.futures import Future
from itertools import count
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from threading import Lock, Thread
from types import SimpleNamespace

import pytest

from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.pool import WorkerDiedError, WorkerPool, _Task, _Worker
from behavexplor.execution.rollout import ask
from behavexplor.execution.service import Recipe, Service
from tests.drivers import Cruiser

PRELOAD = ("behavexplor.execution.evaluator",)  # one process starts all workers of these tests, and loads once


def echo(data):
    return data + str(os.getpid()).encode()


def raising(data):
    raise LookupError(data.decode())


def dying(data):
    os._exit(int(data))


def dying_once(data):
    if Path(data.decode()).exists():
        return b"second time"
    Path(data.decode()).touch()
    return os.kill(os.getpid(), signal.SIGKILL)


def sleeping(data):
    time.sleep(float(data))
    return b"awake"


def limit_of_memory(data):
    return str(resource.getrlimit(resource.RLIMIT_DATA)[0] / 2**30).encode()


def may_have_children(data):
    return str(not multiprocessing.current_process().daemon).encode()


def levels_of_loggers(data):
    return " ".join(logging.getLogger(name).getEffectiveLevel() * "x" for name in data.decode().split()).encode()


def writable_pipes(data):
    """The pipes into which a process can write, beside its standard files."""
    places = {int(file.name): file for file in Path("/proc/self/fd").iterdir() if file.exists()}
    pipes = [number for number, file in places.items() if number > 2 and file.is_fifo()]
    return b" ".join(b"%d" % one for one in pipes if fcntl.fcntl(one, fcntl.F_GETFL) & os.O_ACCMODE == os.O_WRONLY)


def collecting(data):
    return str(gc.isenabled()).encode()


def failing_ads(data):
    raise ADSError("raised", data.decode())


class Functions(Service):
    """Offers the functions above."""

    functions = {
        function.__name__: function
        for function in (
            *(echo, raising, dying, dying_once, sleeping, collecting, failing_ads),
            *(limit_of_memory, may_have_children, levels_of_loggers, writable_pipes),
        )
    }


class Refusing(Functions):
    def begin(self):
        raise OSError("no such thing")


class Declining(Functions):
    def begin(self):
        raise InputError("no such road")


def recipe(service, **settings):
    return Recipe(f"{__name__}:{service.__name__}", settings, preload=PRELOAD)


def make_pool(service=Functions, workers=1, time_limit=5.0):
    return WorkerPool(workers, recipe(service), time_limit, memory_limit=8.0)


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def pool():
    pool = make_pool(workers=2)
    yield pool
    pool.shutdown(wait=False)


def test_bytes_go_out_and_come_back_from_several_processes(pool):
    answers = [future.result() for future in [pool.submit("echo", b"x" * size) for size in (0, 1, 10**6) * 4]]
    assert [len(answer.rstrip(b"0123456789")) for answer in answers] == [0, 1, 10**6] * 4
    processes = {answer.lstrip(b"x") for answer in answers}
    assert 1 <= len(processes) <= 2
    assert str(os.getpid()).encode() not in processes


def test_workers_collect_garbage(pool):
    """The process that they are copied from does not, because it only imports."""
    assert pool.submit("collecting", b"").result() == b"True"


def test_a_worker_has_its_limit_of_memory_and_no_children_that_would_outlive_it(pool):
    assert float(pool.submit("limit_of_memory", b"").result()) == 8.0
    assert pool.submit("may_have_children", b"").result() == b"False"


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs the files in /proc")
def test_a_worker_can_write_into_no_pipe_of_those_that_begin_workers(pool):
    assert pool.submit("writable_pipes", b"").result() == b""


def test_a_worker_does_not_say_that_it_compiles_or_has_no_home(pool):
    levels = pool.submit("levels_of_loggers", b"behavexplor.jit matplotlib other").result().split()
    assert [len(level) for level in levels] == [logging.ERROR, logging.ERROR, logging.WARNING]


def test_an_exception_comes_back_as_words(pool):
    with pytest.raises(RuntimeError, match="LookupError: nothing there"):
        pool.submit("raising", b"nothing there").result()
    with pytest.raises(ADSError, match="it was me") as caught:
        pool.submit("failing_ads", b"it was me").result()
    assert (caught.value.kind, caught.value.message) == ("raised", "it was me")


def test_a_dead_worker_costs_its_own_task_and_no_other(pool):
    futures = [pool.submit("dying", b"7") if i % 3 == 0 else pool.submit("echo", b"alive") for i in range(9)]
    for i, future in enumerate(futures):
        if i % 3 == 0:
            with pytest.raises(WorkerDiedError, match="exit code 7"):
                future.result()
        else:
            assert future.result().startswith(b"alive")


def test_a_worker_that_takes_too_long_is_replaced():
    pool = make_pool(time_limit=0.5)
    process = int(pool.submit("echo", b"").result())
    late, after = pool.submit("sleeping", b"60"), pool.submit("echo", b"next")
    with pytest.raises(WorkerDiedError, match=r"no answer within 0\.5 s"):
        late.result()
    assert after.result().startswith(b"next")
    assert not is_running(process)
    pool.shutdown()


def test_a_worker_that_cannot_begin_fails_its_task():
    pool = make_pool(Refusing)
    with pytest.raises(InputError, match="cannot be loaded: its process ended"):
        pool.submit("echo", b"").result()
    pool.shutdown()


def test_why_a_worker_cannot_begin_is_said():
    pool = make_pool(Declining)
    for _ in range(2):
        with pytest.raises(InputError, match="no such road"):
            pool.submit("echo", b"").result()
    pool.shutdown()


def test_a_call_is_made_again_if_its_worker_was_killed_once(pool, tmp_path):
    mark = str(tmp_path / "mark").encode()
    assert pool.submit("dying_once", mark).result() == b"second time"


class Adding:
    """Works on up to three requests: in each turn each of them becomes one less, until it is zero.

    -1 raises when it has company, and -2 ends the process whenever it does.
    """

    capacity = 3

    def __init__(self, file):
        self.file, self.requests = file, {}

    def begin(self, key, request):
        self.requests[key] = int(request)
        with Path(self.file).open("a") as file:
            file.write(f"{len(self.requests)}\n")

    def advance(self):
        if -2 in self.requests.values():
            os._exit(3)
        if -1 in self.requests.values():
            keys = list(self.requests)
            self.requests.clear()
            return [(key, None) for key in keys]
        self.requests = {key: number - 1 for key, number in self.requests.items()}
        done = [key for key, number in self.requests.items() if number <= 0]
        return [(key, str(self.requests.pop(key)).encode()) for key in done]


def count_down(data):
    if data == b"-2":
        os._exit(3)
    return b"alone"


class Adder(Service):
    functions = {"count_down": count_down, "echo": echo}

    def __init__(self, file):
        self.batch = Adding(file)


class Slow(Service):
    """Sleeps, up to four calls at a time, and leaves a file for each of its processes."""

    capacity = 4

    def __init__(self, folder):
        self.folder, self.batch, self.functions, self.ends = folder, self, {"slow": sleeping}, {}

    def begin(self, key=None, request=None):
        if key is None:  # the service begins, and not a call
            Path(self.folder, str(os.getpid())).touch()
        else:
            self.ends[key] = time.monotonic() + float(request)

    def advance(self):
        time.sleep(0.005)
        done = [key for key, end in self.ends.items() if end <= time.monotonic()]
        return [(key, self.ends.pop(key) and b"awake") for key in done]


@pytest.fixture
def pool_of_slow(tmp_path):
    made = Recipe(f"{__name__}:Slow", {"folder": str(tmp_path)}, batched="slow", preload=PRELOAD)
    pool = WorkerPool(3, made, time_limit=5.0, memory_limit=8.0)
    pool.submit("slow", b"0").result()
    yield pool, tmp_path
    pool.shutdown(wait=False)


@pytest.fixture(params=[1, 2, 100])
def adders(tmp_path, request):
    file = str(tmp_path / "together")
    settings = {"batched": "count_down", "preload": PRELOAD, "together": request.param}
    made = Recipe(f"{__name__}:Adder", {"file": file}, **settings)
    pool = WorkerPool(2, made, time_limit=5.0, memory_limit=8.0)
    yield pool, tmp_path / "together"
    pool.shutdown(wait=False)


def test_calls_are_worked_on_together_as_many_as_there_is_room_for(adders):
    pool, file = adders
    futures = [pool.submit("count_down", b"%d" % number) for number in [30_000, *range(1, 40), 20_000]]
    assert [future.result() for future in futures] == [b"0"] * 41
    sizes = {int(line) for line in file.read_text().split()}
    assert max(sizes) == 3


def test_an_answer_does_not_wait_for_that_of_a_longer_call(adders):
    pool, _ = adders
    pool.submit("count_down", b"1").result()
    long, short = pool.submit("count_down", b"10000000"), pool.submit("count_down", b"1")
    assert short.result(20) == b"0"
    assert not long.done()


def test_one_worker_does_it_all_while_its_caller_has_other_things_to_do(pool_of_slow):
    pool, folder = pool_of_slow
    for _ in range(8):
        future = pool.submit("slow", b"0.01")
        time.sleep(0.3)
        future.result()
    assert len(list(folder.iterdir())) == 1


def test_another_worker_starts_if_the_caller_does_nothing_but_wait(pool_of_slow):
    pool, folder = pool_of_slow
    end = time.monotonic() + 60.0
    while len(list(folder.iterdir())) == 1 and time.monotonic() < end:
        pool.submit("slow", b"0.05").result()
    assert len(list(folder.iterdir())) == 2


def test_other_workers_start_at_once_if_there_are_more_calls_than_one_can_take(pool_of_slow):
    pool, folder = pool_of_slow
    futures = [pool.submit("slow", b"0.5") for _ in range(17)]
    for future in futures:
        future.result()
    end = time.monotonic() + 60.0
    while pool.room < 24 and time.monotonic() < end:
        time.sleep(0.01)
    assert len(list(folder.iterdir())) == 3
    assert pool.room == 24  # two batches of four calls for each: all are ready, also without a call


def test_what_fails_in_company_is_called_alone(adders):
    pool, _ = adders
    futures = [pool.submit("count_down", number) for number in (b"100000", b"-1", b"100000")]
    assert futures[1].result() == b"alone"
    assert {future.result() for future in futures} <= {b"0", b"alone"}
    assert pool.submit("count_down", b"5").result() == b"0"


def test_what_kills_its_company_is_found_out_and_the_company_lives(adders):
    pool, _ = adders
    futures = [pool.submit("count_down", b"-2" if i == 3 else b"20") for i in range(8)]
    for i, future in enumerate(futures):
        if i == 3:
            with pytest.raises(WorkerDiedError, match="exit code 3"):
                future.result()
        else:
            assert future.result() in (b"0", b"alone")


def test_a_refused_request_disturbs_no_other(adders):
    pool, _ = adders
    futures = [pool.submit("count_down", data) for data in (b"50", b"x", b"50")]
    with pytest.raises(RuntimeError, match="ValueError: invalid literal"):
        futures[1].result()
    assert [futures[0].result(), futures[2].result()] == [b"0", b"0"]
    assert pool.submit("echo", b"").result()


def test_shutting_down_ends_every_process_at_once():
    pool = make_pool(workers=2, time_limit=60.0)
    first = [pool.submit("echo", b"") for _ in range(8)]
    processes = {int(future.result()) for future in first}
    running = [pool.submit("sleeping", b"50") for _ in range(5)]
    time.sleep(0.2)
    before = time.monotonic()
    pool.shutdown(wait=False)
    assert time.monotonic() - before < 5
    deadline = time.monotonic() + 10
    while any(map(is_running, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, processes))
    assert any(future.cancelled() for future in running)
    with pytest.raises(RuntimeError, match="shut down"):
        pool.submit("echo", b"")


class Patient(Functions):
    """Has a call that ends as soon as it is told to stop, or after a minute."""

    def __init__(self):
        self.stopped = False
        self.functions = {"wait": self.wait, "echo": echo, "may_have_children": may_have_children}

    def stop(self):
        self.stopped = True

    def wait(self, data):
        Path(data.decode()).touch()
        deadline = time.monotonic() + 60
        while not self.stopped and time.monotonic() < deadline:
            time.sleep(0.01)
        return b"stopped" if self.stopped else b"late"


def test_long_calls_end_early_when_they_are_told_to_and_each_has_a_process(tmp_path):
    made = Recipe(f"{__name__}:Patient", long_calls=True, preload=PRELOAD)
    pool = WorkerPool(1, made, math.inf, math.inf)
    first, second = (pool.submit("echo", b"").result() for _ in range(2))
    assert first != second
    assert pool.submit("may_have_children", b"").result() == b"True"
    running, waiting = pool.submit("wait", str(tmp_path / "begun").encode()), pool.submit("echo", b"")
    while not (tmp_path / "begun").exists():
        time.sleep(0.01)
    pool.stop()
    assert running.result() == b"stopped"
    assert waiting.cancelled()
    pool.shutdown()


def test_a_call_whose_worker_dies_after_it_was_told_to_stop_is_not_made_again(pool, tmp_path):
    ready: set[int] = set()
    while len(ready) < 2:  # a worker that is still loading would be ended, and nothing else
        ready |= {int(call.result()) for call in [pool.submit("echo", b"") for _ in range(2)]}
    running = pool.submit("sleeping", b"60")
    worker = int(pool.submit("echo", b"").result())
    other = next(w for w in pool._workers if w is not None and w._process.pid != worker)
    pool.stop()  # these workers have no way to end a call early
    os.kill(other._process.pid, signal.SIGKILL)
    with pytest.raises(WorkerDiedError, match="ended"):
        running.result(timeout=30)


class Starting:
    """Stands for the start of workers: those after the first few fail."""

    def __init__(self, monkeypatch, allowed):
        self.left, start = allowed, ForkServerProcess.start

        def begin(process):
            self.left -= 1
            if self.left < 0:
                raise OSError(11, "Resource temporarily unavailable")
            start(process)

        monkeypatch.setattr(ForkServerProcess, "start", begin)


def test_calls_fail_if_no_worker_can_be_started(monkeypatch):
    Starting(monkeypatch, 0)
    pool = make_pool()
    first = pool.submit("echo", b"a")
    with pytest.raises(WorkerDiedError, match=r"no worker could be started: .*Resource temporarily unavailable"):
        first.result(60)
    with pytest.raises(WorkerDiedError, match="no worker could be started"):
        pool.submit("echo", b"b").result(60)
    pool.shutdown()


def test_a_worker_is_not_blamed_if_the_others_cannot_be_started(monkeypatch):
    Starting(monkeypatch, 1)
    pool = make_pool(workers=3)
    calls = [pool.submit("echo", b"%d" % i) for i in range(4)]
    for call in calls:
        with pytest.raises(WorkerDiedError, match="no worker could be started"):
            call.result(60)
    pool.shutdown(wait=False)


def test_an_unknown_function_is_named(pool):
    with pytest.raises(RuntimeError, match="KeyError: 'nonsense'"):
        pool.submit("nonsense", b"").result()


def test_an_interrupt_is_left_to_the_campaign(pool):
    process = int(pool.submit("echo", b"").result())
    os.kill(process, signal.SIGINT)
    assert pool.submit("echo", b"still here").result().startswith(b"still here")


@pytest.mark.parametrize(
    ("error", "kind"),
    [(ValueError("x"), "raised"), (MemoryError(), "memory"), (SystemExit(3), "exit"), (RecursionError("x"), "raised")],
)
def test_everything_an_ads_raises_is_its_own_failure(error, kind):
    class Failing(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            raise error

    with pytest.raises(ADSError) as caught:
        ask(Failing(), None, None, [True], None)
    assert caught.value.kind == kind


def test_a_worker_without_calls_is_not_waited_for():
    pool = make_pool(time_limit=0.5)
    first = pool.submit("echo", b"").result()
    time.sleep(1.2)
    assert pool.submit("echo", b"").result() == first
    pool.shutdown()


@pytest.mark.parametrize(
    ("alone", "capacity", "expected"),
    [
        ("", 9, ["abcde"]),
        ("", 2, ["ab", "cd", "e"]),
        ("a", 9, ["a", "bcde"]),
        ("c", 9, ["ab", "c", "de"]),
        ("ace", 9, ["a", "b", "c", "d", "e"]),
    ],
)
def test_a_worker_gets_as_many_calls_as_it_can_take_or_one_that_needs_it_to_itself(alone, capacity, expected):
    """Five calls wait."""
    handed_out, calls = [], [(name, name in alone) for name in "abcde"]
    pool = object.__new__(WorkerPool)
    pool._lock, pool._keys, pool._time_limit = Lock(), count(), 1.0
    pool._waiting = deque(_Task(Future(), "f", name.encode(), is_alone) for name, is_alone in calls)
    worker = object.__new__(_Worker)
    worker.tasks, worker.is_ready, worker.capacity, worker._together = {}, True, capacity, 1
    worker.ask = lambda tasks, _: worker.tasks.update(tasks)
    pool._workers = [worker]
    while pool._waiting:
        pool._hand_out()
        handed_out.append("".join(task.data.decode() for task in worker.tasks.values()))
        worker.tasks.clear()
    assert handed_out == expected


def test_calls_that_another_thread_cancels_meanwhile_do_not_end_the_pool():
    class Interrupted(deque):
        def __bool__(self):
            stopping = Thread(target=cancel, daemon=True)
            stopping.start()
            stopping.join(0.2)
            return len(self) > 0

    def cancel():
        with pool._lock:
            pool._waiting = deque()

    pool = object.__new__(WorkerPool)
    pool._lock, pool._waiting = Lock(), Interrupted([SimpleNamespace(alone=True)])
    pool._workers = [SimpleNamespace(tasks={0: None}, is_alone=True, is_ready=True, capacity=1)]
    pool._hand_out()
