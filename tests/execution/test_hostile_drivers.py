"""Drivers that do what none should: their executions fail, and the campaign, its records and its terminal do not."""

import math
import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.errors import LONGEST, InputError, described
from behavexplor.execution.messages import ADS_FAILED, READY, RESULT, SUSPECT, packed, with_key
from tests.drivers import Cruiser

HERE = __name__


class WithoutWordsError(Exception):
    def __str__(self):
        raise RuntimeError("there are none")

    __repr__ = __str__


class Driver(Cruiser):
    """Does something before each of its decisions."""

    def act(self):
        """Nothing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.act()
        return super().predict(observation, state)


class Verbose(Driver):
    def act(self):
        raise ValueError("x" * 10**7)


class Unprintable(Driver):
    def act(self):
        raise ValueError("\ud800\x1b[2J \u202e and a\nsecond line")


class Wordless(Driver):
    def act(self):
        raise WithoutWordsError


class Generating(Driver):
    def act(self):
        raise GeneratorExit


class Hoarding(Driver):
    """Leaves no file descriptors."""

    def act(self):
        self.files = []
        while True:
            try:
                self.files.append(os.dup(0))
            except OSError:
                return


class Chatty(Driver):
    """Announces two gigabytes on each pipe and socket of its process."""

    def act(self):
        for file in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # the listing's own
                if str(file.readlink()).startswith("socket:"):
                    os.write(int(file.name), b"\x7f\xff\xff\xff")


class Lying(Driver):
    """Writes answers of its own on each pipe and socket of its process."""

    answers = ()

    def act(self):
        message = packed([with_key(key, answer) for answer in self.answers for key in range(20)])
        for file in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # the listing's own
                if str(file.readlink()).startswith("socket:"):
                    os.write(int(file.name), len(message).to_bytes(4) + message)


class Silent(Lying):
    """Sends messages without answers, which would put off the time limit without end."""


class Ready(Lying):
    answers = (READY + b"1000000000",)


class Suspect(Lying):
    """Asks again and again for its calls to be repeated."""

    answers = (SUSPECT,)


class Unknown(Lying):
    answers = (b"?", b"")


class Forged(Lying):
    answers = (RESULT + b"a verdict",)


class Failing(Lying):
    """Has failed in a way that there is not."""

    answers = (ADS_FAILED + b'{"kind": "passed", "message": "no collision", "place": ""}',)


class Nested(Lying):
    answers = (ADS_FAILED + b'["kind"]',)


class Deep(Lying):
    """Nests its answer more deeply than anything that Python reads."""

    answers = (ADS_FAILED + b"[" * 99_999,)


class Forking(Driver):
    def act(self):
        os.fork()


class Leaving(Driver):
    """Asks for a signal that comes when the environment is at work, and ends the process."""

    def act(self):
        signal.signal(signal.SIGALRM, lambda *_: os._exit(9))
        signal.setitimer(signal.ITIMER_REAL, 0.0005)


def records(name, folder, **settings):
    config = CampaignConfig(env="lane-follow", ads=f"{HERE}:{name}", method="uniform", budget="3", seed=1, **settings)
    with opened(config, folder, 1, resume=False) as ready:
        ready.campaign.run(lambda _: None)
        return list(ready.store.records())


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("Verbose", "raised", "ValueError: xxx"),
        ("Unprintable", "raised", r"ValueError: \ud800\x1b[2J \u202e and a"),
        ("Wordless", "raised", "WithoutWordsError: it has no message"),
        ("Generating", "raised", "GeneratorExit"),
        ("Hoarding", "crash", "its process cannot go on: OSError: [Errno 24] Too many open files"),
        ("Chatty", "crash", ""),
        ("Leaving", "crash", "its process ended with exit code 9"),
        ("Silent", "crash", "its process sent what is no answer"),
        ("Ready", "crash", "its process sent what is no answer"),
        ("Suspect", "crash", "its process sent what is no answer"),
        ("Unknown", "crash", "its process sent what is no answer"),
        ("Forged", "crash", "its process sent what is no"),  # trace, if it guessed the key of a call, or answer
        ("Failing", "crash", "its process sent what is no answer"),
        ("Nested", "crash", "its process sent what is no answer"),
        ("Deep", "crash", "its process sent what is no answer"),
    ],
)
def test_what_a_driver_does_to_its_process_is_its_failure(name, kind, words, tmp_path):
    found = records(name, tmp_path / "run")
    assert [record.error["kind"] for record in found] == [kind] * 3
    assert all(record.error["message"].startswith(words) for record in found)
    assert all(len(record.error["message"]) <= LONGEST for record in found)


def test_copies_of_a_workers_process_end_and_answer_nothing(tmp_path):
    begun = time.monotonic()
    forked, plain = (records(name, tmp_path / name) for name in ("Forking", "Driver"))
    assert [record.to_json() for record in forked] == [record.to_json() for record in plain]
    assert time.monotonic() - begun < 300


def test_exceptions_are_described_in_bounds():
    assert described(ValueError("a" * 5000)) == f"ValueError: {'a' * (LONGEST - 16)} ..."
    assert described(type("E" * 500, (Exception,), {})("x")) == f"{'E' * 80}: x"
    assert described(KeyError()) == "KeyError: "


@pytest.mark.parametrize("limit", [0.0, 1e-9, math.inf, math.nan])
def test_a_limit_of_time_that_no_worker_could_keep_is_refused(limit):
    with pytest.raises(InputError, match=f"time_limit {limit} must be at least 0.1 s and less than"):
        CampaignConfig(time_limit=limit)


def test_a_limit_of_memory_that_no_worker_could_keep_is_refused():
    with pytest.raises(InputError, match=r"memory_limit 0\.15 must be at least 0\.5 GiB"):
        CampaignConfig(memory_limit=0.15)
