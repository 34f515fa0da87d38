"""What third-party code prints reaches the user, who keeps the terminal to himself."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import pytest

from behavexplor.execution.executor import ADSError
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.service import Recipe, Service
from behavexplor.execution.worker_output import WorkerOutput
from tests.confining import confines

ROOT = Path(__file__).parents[2]
PRELOAD = ("behavexplor.execution.evaluator",)


def printing(data):
    os.write(1, data)
    return b"printed"


def dying(data):
    os.write(2, data)
    os._exit(7)


def closing(data):
    os.close(1)
    os.close(2)
    return b"closed"


def leaving(data):
    sys.stdout.write(f"a child {subprocess.Popen(['sleep', '100']).pid}\n")
    return b"left"


class Talking(Service):
    """Stands for third-party code."""

    is_confined = True
    functions = {function.__name__: function for function in (printing, dying, closing, leaving)}


@pytest.fixture
def pool():
    pool = WorkerPool(1, Recipe(f"{__name__}:Talking", preload=PRELOAD), time_limit=20.0, memory_limit=8.0)
    yield pool
    pool.shutdown(wait=False)


def test_lines_come_with_escapes_in_place_of_control_characters(pool, capsys):
    pool.submit("printing", "one\n\x1b[2Jtwo\u202e\n".encode() + b"\xff three").result()
    pool.shutdown()
    said = capsys.readouterr()
    assert said.err == "one\n\\x1b[2Jtwo\\u202e\n\\xff three\n"
    assert said.out == ""


def test_megabytes_neither_block_the_worker_nor_get_lost(pool, capsys):
    lines = b"".join(b"%d" % number + b"x" * 100 + b"\n" for number in range(40_000))
    assert pool.submit("printing", lines).result() == b"printed"
    pool.shutdown()
    assert capsys.readouterr().err == lines.decode()


def test_a_line_without_end_does_not_wait_in_memory(pool, capsys):
    pool.submit("printing", b"x" * 10**7).result()
    pool.shutdown()
    assert capsys.readouterr().err.replace("\n", "") == "x" * 10**7


def test_the_last_words_of_a_dying_worker_are_printed(pool, capsys):
    with pytest.raises(ADSError, match="exit code 7"):  # third-party code is to blame
        pool.submit("dying", b"first\nlast words").result()
    pool.shutdown()
    assert capsys.readouterr().err == "first\nlast words\n" * 2  # it was tried twice


def test_a_worker_that_closes_its_output_works_on(pool):
    assert pool.submit("closing", b"").result() == b"closed"
    assert pool.submit("closing", b"").exception() is not None  # they are closed


def test_a_pipe_that_has_ended_is_not_read_again():
    output = WorkerOutput()
    output.pass_on()
    assert not output.connection.closed  # nothing has come yet
    output.theirs.close()
    output.pass_on()
    assert output.connection.closed


def test_a_child_that_a_worker_has_left_ends_with_it_and_delays_nothing(pool, capsys):
    pool.submit("leaving", b"").result()
    begin = time.monotonic()
    pool.shutdown()
    assert time.monotonic() - begin < 5.0
    assert has_ended(int(capsys.readouterr().err.removeprefix("a child ")))


def test_output_is_passed_on_to_a_stderr_that_is_closed(monkeypatch):
    output = WorkerOutput()
    os.write(output.theirs.fileno(), b"text\n")
    monkeypatch.setattr(sys, "stderr", None)
    output.pass_on(ended=True)
    assert output.connection.closed


def has_ended(process):
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2].startswith("Z"):
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.02)
    return False


class Terminal:
    """A terminal, and a command that it belongs to."""

    BEGIN = (
        "import faulthandler, fcntl, signal, sys, termios; faulthandler.register(signal.SIGUSR1); "
        "fcntl.ioctl(0, termios.TIOCSCTTY, 0); import runpy; sys.argv.pop(0); "
    )
    RUN = BEGIN + "runpy.run_module('behavexplor', run_name='__main__', alter_sys=True)"

    def __init__(self, folder, *arguments):
        self.user, self.line = pty.openpty()
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{folder}", "VICTIM": os.ttyname(self.line), "TERM": "xterm"}
        files = {"stdin": self.line, "stdout": self.line, "stderr": self.line}
        command = [sys.executable, "-c", self.RUN, "behavexplor", *map(str, arguments)]
        self.process = subprocess.Popen(command, **files, env=environment, cwd=folder, start_new_session=True)
        self.shown = b""
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        while not self.shown.endswith(b"THE END"):
            self.shown += os.read(self.user, 65536)

    def wait_for(self, pattern):
        deadline = time.monotonic() + 60.0
        while not (found := re.search(pattern, self.shown)) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert found, self.shown
        return found

    def end(self):
        """The exit code, and all that the terminal shows."""
        try:
            code = self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGUSR1)  # shows where it is
            time.sleep(1)
            self.process.kill()
            raise AssertionError(self.shown.decode()) from None
        os.write(self.line, b"THE END")
        self._reader.join()
        return code, self.shown.decode()

    @property
    def has_input(self):
        return bool(select.select([self.line], [], [], 0)[0])


INTRUDER = """
import fcntl, os, sys, termios
from tests.drivers import Cruiser


def attempt(name, call):
    try:
        print(name, "done", call())
    except OSError as error:
        print(name, type(error).__name__)


class Intruder(Cruiser):
    def predict(self, observation, *arguments, **keywords):
        victim = os.environ["VICTIM"]
        for file in range(3):
            attempt("push", lambda: fcntl.ioctl(file, termios.TIOCSTI, b"x"))
            attempt("paste", lambda: fcntl.ioctl(file, termios.TIOCLINUX, b"\\3"))
        for place in ("/dev/tty", victim, f"/proc/{os.getppid()}/fd/1"):
            attempt("read", lambda: os.open(place, os.O_RDONLY | os.O_NOCTTY))
            attempt("write", lambda: os.open(place, os.O_WRONLY | os.O_NOCTTY))
        attempt("take", lambda: os.open(victim, os.O_RDWR))
        files = map(int, os.listdir("/proc/self/fd"))
        print("terminals:", [file for file in files if os.isatty(file)], "leader:", os.getsid(0) == os.getpid())
        print("typed:", repr(sys.stdin.read() + os.read(0, 9).decode()), "\\033]0;owned\\007", file=sys.stderr)
        sys.stdout.write("half a line")
        os._exit(1)
"""
HOLDER = """
import os, re, subprocess
from tests.drivers import Cruiser


class Holder(Cruiser):
    def predict(self, observation, *arguments, **keywords):
        child = subprocess.Popen(["sleep", "100"])
        print("processes", os.getpid(), child.pid, flush=True)
        re.match(r"(a+)+$", "a" * 60 + "b")  # lets no other thread run, for ages
"""
CAMPAIGN = ("--env", "lane-follow", "--budget", "1", "--workers", "1", "--quiet", "--out", "run")


@pytest.mark.skipif(not confines(), reason="this system cannot confine a process")
def test_a_confined_driver_reaches_no_terminal_and_what_it_prints_is_shown(tmp_path):
    (tmp_path / "intruder.py").write_text(INTRUDER)
    terminal = Terminal(tmp_path, "fuzz", "--ads", "intruder:Intruder", *CAMPAIGN)
    _, shown = terminal.end()
    words = ["push", "paste"] * 3 + ["read", "write"] * 3 + ["take"]
    said = [f"{word} PermissionError" for word in words]
    said += ["terminals: [] leader: True", r"typed: '' \x1b]0;owned\x07", "half a line"]
    assert "\r\n".join(said) in shown
    assert "done" not in shown
    assert "\x1b]0;" not in shown
    assert not terminal.has_input
    os.write(terminal.user, b"seen\n")
    assert terminal.has_input  # as it would have been


def test_control_c_ends_a_campaign_whose_workers_do_not_hear_it(tmp_path):
    (tmp_path / "holder.py").write_text(HOLDER)
    terminal = Terminal(tmp_path, "fuzz", "--ads", "holder:Holder", *CAMPAIGN)
    processes = terminal.wait_for(rb"processes (\d+) (\d+)\r\n").groups()
    os.write(terminal.user, b"\3")
    assert terminal.end()[0] == 130
    assert all(map(has_ended, map(int, processes)))


@pytest.mark.parametrize("ends", [os.kill, os.killpg])
def test_nothing_is_left_of_a_campaign_that_is_killed(ends, tmp_path):
    (tmp_path / "holder.py").write_text(HOLDER)
    terminal = Terminal(tmp_path, "fuzz", "--ads", "holder:Holder", *CAMPAIGN)
    processes = terminal.wait_for(rb"processes (\d+) (\d+)\r\n").groups()
    ends(terminal.process.pid, signal.SIGKILL)
    assert terminal.end()[0] == -signal.SIGKILL
    assert all(map(has_ended, map(int, processes)))
