"""Worker processes: whatever happens in one, its task has an outcome and the others go on."""

import os
import signal
import time

import pytest

from behavexplor.rollout import ADSError, _ask
from behavexplor.workers import WorkerDiedError, WorkerPool
from tests.drivers import Cruiser


def begin():
    pass


def refuse():
    raise OSError("no such thing")


def echo(data):
    return data + str(os.getpid()).encode()


def raising(data):
    raise LookupError(data.decode())


def dying(data):
    os._exit(int(data))


def sleeping(data):
    time.sleep(float(data))
    return b"awake"


def failing_ads(data):
    raise ADSError("raised", data.decode())


FUNCTIONS = {function.__name__: function for function in (echo, raising, dying, sleeping, failing_ads)}


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def pool():
    pool = WorkerPool(2, FUNCTIONS, begin, (), time_limit=5.0, memory_limit=8.0)
    yield pool
    pool.shutdown(wait=False, cancel_futures=True)


def test_bytes_go_out_and_come_back_from_several_processes(pool):
    answers = [future.result() for future in [pool.submit(echo, b"x" * size) for size in (0, 1, 10**6) * 4]]
    assert [len(answer.rstrip(b"0123456789")) for answer in answers] == [0, 1, 10**6] * 4
    processes = {answer.lstrip(b"x") for answer in answers}
    assert 1 <= len(processes) <= 2
    assert str(os.getpid()).encode() not in processes


def test_an_exception_comes_back_as_words(pool):
    with pytest.raises(RuntimeError, match="LookupError: nothing there"):
        pool.submit(raising, b"nothing there").result()
    with pytest.raises(ADSError, match="it was me") as caught:
        pool.submit(failing_ads, b"it was me").result()
    assert (caught.value.kind, caught.value.message) == ("raised", "it was me")


def test_a_dead_worker_costs_its_own_task_and_no_other(pool):
    futures = [pool.submit(dying, b"7") if i % 3 == 0 else pool.submit(echo, b"alive") for i in range(9)]
    for i, future in enumerate(futures):
        if i % 3 == 0:
            with pytest.raises(WorkerDiedError, match="exit code 7"):
                future.result()
        else:
            assert future.result().startswith(b"alive")


def test_a_worker_that_takes_too_long_is_replaced():
    pool = WorkerPool(1, FUNCTIONS, begin, (), time_limit=0.5, memory_limit=8.0)
    late, after = pool.submit(sleeping, b"60"), pool.submit(echo, b"next")
    with pytest.raises(WorkerDiedError, match=r"no answer within 0\.5 s"):
        late.result()
    assert after.result().startswith(b"next")
    pool.shutdown()


def test_a_worker_that_cannot_begin_fails_its_task():
    pool = WorkerPool(1, FUNCTIONS, refuse, (), time_limit=5.0, memory_limit=8.0)
    with pytest.raises(WorkerDiedError, match="a worker ended"):
        pool.submit(echo, b"").result()
    pool.shutdown()


def test_shutting_down_ends_every_process_at_once():
    pool = WorkerPool(2, FUNCTIONS, begin, (), time_limit=60.0, memory_limit=8.0)
    first = [pool.submit(echo, b"") for _ in range(8)]
    processes = {int(future.result()) for future in first}
    running = [pool.submit(sleeping, b"50") for _ in range(5)]
    time.sleep(0.2)
    before = time.monotonic()
    pool.shutdown(wait=False, cancel_futures=True)
    assert time.monotonic() - before < 5
    deadline = time.monotonic() + 10
    while any(map(is_running, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, processes))
    assert any(future.cancelled() for future in running)
    with pytest.raises(RuntimeError, match="shut down"):
        pool.submit(echo, b"")


def test_only_bytes_are_taken(pool):
    with pytest.raises(TypeError, match="takes bytes"):
        pool.submit(echo, "text")


def test_an_interrupt_is_left_to_the_campaign(pool):
    process = int(pool.submit(echo, b"").result())
    os.kill(process, signal.SIGINT)
    assert pool.submit(echo, b"still here").result().startswith(b"still here")


@pytest.mark.parametrize(
    ("error", "kind"),
    [(ValueError("x"), "raised"), (MemoryError(), "memory"), (SystemExit(3), "exit"), (RecursionError("x"), "raised")],
)
def test_everything_an_ads_raises_is_its_own_failure(error, kind):
    class Failing(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            raise error

    with pytest.raises(ADSError) as caught:
        _ask(Failing(), None, None, [True], None)
    assert caught.value.kind == kind
