"""What may go wrong inside a driving system, each as a system that does it; docs/robustness.md has them as a table."""

import ctypes
import os
import random
import signal
import socket
import stat
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.drivers import Cruiser

DROVE = "drove"  # the outcome of a fault that does not keep the system from driving


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        does: what the system does after some meters.
        ads: the system's name in this module.
        outcome: kind of the recorded error, or `DROVE` where the records are those of a system without the fault.
        message: part of the recorded message.
    """

    does: str
    ads: str
    outcome: str
    message: str = ""


FAULTS = (
    Fault("raises an exception", "Raising", "raised", "ZeroDivisionError: no gap"),
    Fault("raises an exception that no `except Exception` catches", "Interrupting", "raised", "KeyboardInterrupt"),
    Fault("returns NaN", "NotANumber", "invalid", "finite numbers"),
    Fault("answers an array of a wrong shape", "WrongShape", "invalid", "actions of shape"),
    Fault("answers text", "Text", "invalid", "predict must return"),
    Fault("returns nothing", "Nothing", "invalid", "a pair (actions, state)"),
    Fault("hangs", "Hanging", "hang", "no answer within"),
    Fault("hangs and ignores SIGTERM", "Stubborn", "hang", "no answer within"),
    Fault("calls `sys.exit`", "Exiting", "exit", "sys.exit(3)"),
    Fault("calls `os._exit`", "Leaving", "crash", "exit code 0"),
    Fault("writes to address 0", "Segfaulting", "crash", "SIGSEGV"),
    Fault("aborts, as a failed assertion in C does", "Aborting", "crash", "SIGABRT"),
    Fault("is killed, as by the system when memory is short", "Killed", "crash", "SIGKILL"),
    Fault("eats memory", "Eating", "memory", "out of memory"),
    Fault("recurses without end", "Recursing", "raised", "RecursionError"),
    Fault("closes all open files, those of behavexplor included", "ClosingAll", "crash", "it closed the files"),
    Fault("closes all its files and hangs", "Vanishing", "hang", "no answer within"),
    Fault("writes into all its pipes and sockets", "Flooding", "crash", "sent what is no answer"),
    Fault("writes to a file", "Writing", "raised", "PermissionError"),
    Fault("opens a connection", "Connecting", "raised", "PermissionError"),
    Fault("sends a signal to the process that began it", "Signalling", "raised", "PermissionError"),
    Fault("closes stdin, stdout and stderr", "Closing", DROVE),
    Fault("prints rubbish to stdout and stderr", "Printing", DROVE),
    Fault("starts threads that never end", "Threading", DROVE),
    Fault("changes the working directory", "Moving", DROVE),
    Fault("seeds the global random generators and changes environment variables", "Seeding", DROVE),
    Fault("changes the observation that it was given", "Scribbling", DROVE),
)


class Faulty(Cruiser):
    """Drives 20 m, then does what `fail` does, then would drive on."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        answer = super().predict(observation, state)
        if (observation[:, 0, 4] < 6).all():
            return answer
        failed = self.fail(answer, observation)
        return answer if failed is None else failed

    def fail(self, answer, observation):
        raise NotImplementedError


class Raising(Faulty):
    def fail(self, answer, observation):
        raise ZeroDivisionError("no gap to divide by")


class Interrupting(Faulty):
    def fail(self, answer, observation):
        raise KeyboardInterrupt


class NotANumber(Faulty):
    def fail(self, answer, observation):
        return answer[0] * np.nan, answer[1]


class WrongShape(Faulty):
    def fail(self, answer, observation):
        return np.zeros((3, 7)), answer[1]


class Text(Faulty):
    def fail(self, answer, observation):
        return "full speed ahead"


class Nothing(Faulty):
    def fail(self, answer, observation):
        return ()


class Hanging(Faulty):
    def fail(self, answer, observation):
        time.sleep(1000)


class Stubborn(Faulty):
    def fail(self, answer, observation):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            pass


class Exiting(Faulty):
    def fail(self, answer, observation):
        sys.exit(3)


class Leaving(Faulty):
    def fail(self, answer, observation):
        os._exit(0)


class Segfaulting(Faulty):
    def fail(self, answer, observation):
        ctypes.memset(0, 1, 1)


class Aborting(Faulty):
    def fail(self, answer, observation):
        os.abort()


class Killed(Faulty):
    def fail(self, answer, observation):
        os.kill(os.getpid(), signal.SIGKILL)


class Eating(Faulty):
    def fail(self, answer, observation):
        eaten = []
        while True:
            eaten.append(np.zeros(2**26))


class Recursing(Faulty):
    def fail(self, answer, observation):
        return self.fail(answer, observation)


class ClosingAll(Faulty):
    def fail(self, answer, observation):
        os.closerange(3, 1000)


class Flooding(Faulty):
    def fail(self, answer, observation):
        for number in range(3, 100):
            with suppress(OSError):
                mode = os.fstat(number).st_mode
                if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode):
                    os.set_blocking(number, False)
                    os.write(number, b"\x00\x00\x00\x05hello" * 3)


class Vanishing(Faulty):
    def fail(self, answer, observation):
        os.closerange(3, 1000)
        time.sleep(1000)


class Writing(Faulty):
    def fail(self, answer, observation):
        Path(__file__).with_name("written").write_text("x")


class Connecting(Faulty):
    def fail(self, answer, observation):
        socket.create_connection(("127.0.0.1", 9))


class Signalling(Faulty):
    def fail(self, answer, observation):
        os.kill(os.getppid(), signal.SIGTERM)


class Closing(Faulty):
    def fail(self, answer, observation):
        os.closerange(0, 3)


class Printing(Faulty):
    def fail(self, answer, observation):
        for stream in (1, 2):
            os.write(stream, b"\x00\xff rubbish \x1b[2J\n")
        sys.stdout.write("more\n")
        sys.stdout.flush()


class Threading(Faulty):
    def fail(self, answer, observation):
        if threading.active_count() < 20:
            threading.Thread(target=time.sleep, args=(1000,)).start()


class Moving(Faulty):
    def fail(self, answer, observation):
        os.chdir("/")


class Seeding(Faulty):
    def fail(self, answer, observation):
        random.seed(0)
        np.random.seed(0)  # noqa: NPY002 - that is the fault
        os.environ.clear()


class Scribbling(Faulty):
    def fail(self, answer, observation):
        observation[:] = 7.0


def table():
    """All faults and what becomes of them, in Markdown."""
    rows = [f"| {fault.does} | {_outcome(fault)} | 0 |" for fault in FAULTS]
    return "\n".join(["| the system ... | recorded | executions lost |", "|---|---|---|", *rows])


def _outcome(fault):
    if fault.outcome == DROVE:
        return "the same as without the fault"
    return f"`error` of kind `{fault.outcome}`"
