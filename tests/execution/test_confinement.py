"""A confined process can neither write files nor use the network, and says what the system cannot prevent."""

import os
import platform
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from behavexplor.data.target import Target
from behavexplor.execution import evaluator
from behavexplor.execution.confinement import confine
from behavexplor.execution.evaluator import Evaluator
from behavexplor.execution.start import check_ads, start_executor
from tests.confining import confines

pytestmark = pytest.mark.skipif(not confines(), reason="this system cannot confine a process")
ROOT = Path(__file__).parents[2]


def confined(code, tmp_path):
    """What a Python program prints after its process has been confined, to a folder `own` for temporary files."""
    own, victim = tmp_path / "own", tmp_path / "victim"
    own.mkdir()
    victim.write_text("untouched")
    begin = f"""
        import ctypes, errno, fcntl, os, resource, socket, sys, tempfile, termios, threading
        from pathlib import Path
        tempfile.tempdir, victim = {str(own)!r}, Path({str(victim)!r})
        from behavexplor.execution.confinement import confine
        assert confine() == ()

        def outcome(call):
            try:
                call()
            except OSError as error:
                return type(error).__name__
            return "done"
    """
    program = textwrap.dedent(begin) + textwrap.dedent(code)
    environment = {**os.environ, "TMPDIR": str(own)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert victim.read_text() == "untouched"
    return done.stdout.split()


@pytest.mark.parametrize(
    "call",
    [
        "victim.write_text('x')",
        "victim.unlink()",
        "victim.rename(victim.with_name('other'))",
        "os.truncate(victim, 0)",
        "os.link(victim, victim.with_name('other'))",
        "victim.with_name('new').mkdir()",
        "victim.with_name('new').symlink_to(victim)",
        "(Path(tempfile.gettempdir()) / '..' / 'new').write_text('x')",
        "(Path('/proc/self/cwd') / 'new').write_text('x')",
        "socket.create_connection(('127.0.0.1', 9))",
        "socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
        "socket.socket(socket.AF_INET6)",
        "socket.socket(socket.AF_UNIX)",
        "socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)",
        "victim.chmod(0o777)",
        "os.chmod(os.open(victim, os.O_RDONLY), 0o777)",
        "os.chown(victim, 0, 0)",
        "os.utime(victim)",
        "os.setxattr(victim, 'user.x', b'')",
        "os.removexattr(victim, 'user.x')",
        "ctypes.CDLL(None).syscall(452, -100, str(victim).encode(), 0o777, 0) + 1 or os.chmod(victim, 0o777)",
        "resource.prlimit(os.getppid(), resource.RLIMIT_CPU, (9, 9))",
        "os.setpriority(os.PRIO_PROCESS, os.getppid(), 19)",
        "os.sched_setaffinity(os.getppid(), {0})",
        "os.sched_setscheduler(os.getppid(), os.SCHED_BATCH, os.sched_param(0))",
        "open('/dev/tty')",
        "open('/dev/tty', 'w')",
        "open('/dev/ptmx')",
    ],
)
def test_a_confined_process_may_not(call, tmp_path):
    assert confined(f"print(outcome(lambda: {call}))", tmp_path) == ["PermissionError"]


def test_it_may_not_put_input_into_a_terminal(tmp_path):
    """Its filter refuses that of any file. Linux itself says of a pipe that it is no terminal."""
    code = """
        ioctl, pipe = ctypes.CDLL(None, use_errno=True).ioctl, os.pipe()[0]
        for name in ("TIOCGWINSZ", "TIOCSTI", "TIOCLINUX", "TIOCSCTTY", "TIOCSETD", "TIOCCONS"):
            request = getattr(termios, name)
            print(outcome(lambda: fcntl.ioctl(pipe, request, bytes(8))))
            for ignored in (1 << 32, 0xFFFFFFFF << 32):  # Linux looks at 32 bits of the request
                assert ioctl(pipe, ctypes.c_ulong(ignored | request), bytes(8)) == -1
                print(errno.errorcode[ctypes.get_errno()])
    """
    expected = ["OSError", "ENOTTY", "ENOTTY", *["PermissionError", "EACCES", "EACCES"] * 5]
    assert confined(code, tmp_path) == expected


def test_nor_may_its_threads_and_children(tmp_path):
    code = """
        threading.Thread(target=lambda: print(outcome(lambda: victim.write_text('x')))).start()
        child = f"open({str(victim)!r}, 'w')"
        import subprocess
        print(subprocess.run([sys.executable, "-c", child], stderr=subprocess.DEVNULL).returncode)
    """
    assert sorted(confined(code, tmp_path)) == ["1", "PermissionError"]


def test_it_cannot_end_the_process_that_began_it(tmp_path):
    assert confined("print(outcome(lambda: os.kill(os.getppid(), 0)))", tmp_path) == ["PermissionError"]


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the numbers of calls are those of x86-64")
@pytest.mark.parametrize(("process", "outcome"), [("os.getppid()", "PermissionError"), ("0", "done")])
def test_it_may_change_limits_and_priorities_of_itself_and_of_no_other_process(process, outcome, tmp_path):
    """By values that are zero and others: the filter looks at the process, and at nothing else."""
    code = f"""
        process, call = {process}, ctypes.CDLL(None, use_errno=True).syscall
        def checked(*arguments):
            if call(*arguments) == -1:
                raise OSError(ctypes.get_errno(), "refused")
        attributes = (ctypes.c_uint32 * 12)(48)  # of sched_setattr: their size, and zeros
        soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
        for attempt in (
            lambda: os.sched_setaffinity(process, os.sched_getaffinity(0)),
            lambda: os.sched_setscheduler(process, os.SCHED_BATCH, os.sched_param(0)),
            lambda: os.sched_setscheduler(process, os.SCHED_OTHER, os.sched_param(0)),
            lambda: os.sched_setparam(process, os.sched_param(0)),
            lambda: checked(314, process, attributes, 0),
            lambda: checked(251, 1, process, 0),
            lambda: checked(251, 1, process, 2 << 13 | 4),
            lambda: os.setpriority(os.PRIO_PROCESS, process, 0),
            lambda: os.setpriority(os.PRIO_PROCESS, process, 19),
            lambda: resource.prlimit(process, resource.RLIMIT_CPU, (soft, hard)),
            lambda: resource.prlimit(process, resource.RLIMIT_CORE, resource.getrlimit(resource.RLIMIT_CORE)),
        ):
            print(outcome(attempt))
    """
    assert confined(code, tmp_path) == [outcome] * 11


def test_it_may_read_compute_and_have_temporary_files(tmp_path):
    code = """
        print(victim.read_text())
        print(outcome(lambda: tempfile.NamedTemporaryFile("w").write("x")))
        print(outcome(lambda: open(os.devnull, "w").write("x")))
        print(outcome(socket.socketpair), outcome(lambda: os.sched_setaffinity(0, os.sched_getaffinity(0))))
        print(outcome(lambda: open("/dev/urandom", "rb").read(1)), outcome(lambda: open("/proc/self/stat").read()))
        import numpy
        print((numpy.ones((300, 300)) @ numpy.ones((300, 300))).sum())
    """
    assert confined(code, tmp_path) == ["untouched", *["done"] * 6, "27000000.0"]


FRESH = "from behavexplor.jit import kernel\n\n\n@kernel\ndef doubled(x):\n    return x + x\n"
FOREIGN = "import numba\n\n\n@numba.njit(cache=True)\ndef tripled(x):\n    return 3 * x\n"


def test_kernels_can_be_compiled_though_nothing_can_be_kept(tmp_path):
    (tmp_path / "fresh.py").write_text(FRESH)
    code = f"""
        tempfile.tempdir = "/"
        sys.path.insert(0, {str(tmp_path)!r})
        import fresh
        print(fresh.doubled(21.0))
    """
    assert confined(code, tmp_path) == ["42.0"]
    assert not list(tmp_path.rglob("*.nbi"))


def test_a_confined_process_uses_machine_code_that_is_kept_and_keeps_more_for_itself(tmp_path):
    (tmp_path / "fresh.py").write_text(FRESH)
    (tmp_path / "foreign.py").write_text(FOREIGN)
    own, kept = tmp_path / "own", tmp_path / "kept"
    program = f"""
import sys, tempfile
from pathlib import Path
import fresh
from behavexplor.execution.confinement import confine
from behavexplor.jit import keep_code_in

if "confined" in sys.argv:
    tempfile.tempdir = {str(own)!r}
    keep_code_in(Path(tempfile.mkdtemp()))
    assert confine() == ()
    from foreign import tripled

    print(fresh.doubled(1), tripled(2))
print(fresh.doubled(21.0), sum(fresh.doubled.stats.cache_hits.values()))
"""
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{tmp_path}", "NUMBA_CACHE_DIR": str(kept)}

    def ran(*arguments):
        command = [sys.executable, "-c", program, *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    own.mkdir()
    assert ran() == ["42.0", "0"]
    files = sorted(kept.rglob("*"))
    assert ran("confined") == ["2", "6", "42.0", "1"]
    assert sorted(kept.rglob("*")) == files
    assert {file.name.partition("-")[0] for file in own.rglob("*.nbi")} == {"fresh.doubled", "foreign.tripled"}


def test_an_ads_that_writes_is_stopped_unless_it_may(tmp_path, monkeypatch):
    diary = tmp_path / "diary"
    (tmp_path / "diarist.py").write_text(
        "from pathlib import Path\n"
        "from tests.drivers import Cruiser\n"
        "class Diarist(Cruiser):\n"
        "    def predict(self, observation, *arguments, **keywords):\n"
        f"        Path({str(diary)!r}).open('a').write('x')\n"
        "        return super().predict(observation, *arguments, **keywords)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with start_executor(Target("lane-follow", "diarist:Diarist"), 1) as workers:
        warnings = check_ads(workers)
    assert "PermissionError" in warnings[0]
    assert "--unconfined" in warnings[0]
    assert not diary.exists()
    with start_executor(Target("lane-follow", "diarist:Diarist", unconfined=True), 1) as workers:
        assert check_ads(workers) == []
    assert diary.stat().st_size > 0


def test_what_a_system_cannot_prevent_is_said(monkeypatch):
    for library in ("landlockpy", "pyseccomp"):
        monkeypatch.setitem(sys.modules, library, None)
    assert confine() == ("write files", "use the network")
    monkeypatch.setattr(evaluator, "confine", lambda: ("write files",))
    monkeypatch.setattr(evaluator, "keep_code_in", lambda _: None)
    monkeypatch.setattr(evaluator, "preflight_warnings", lambda _: [])
    service = Evaluator(env="lane-follow", ads="tests.drivers:cruiser")
    service.confine()
    service.begin()
    assert b"write files" in service.preflight(b"")
