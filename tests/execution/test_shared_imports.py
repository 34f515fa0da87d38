import gc
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from behavexplor.execution.shared_imports import collections_off

SCRIPT = """
from multiprocessing import forkserver
from behavexplor.execution.shared_imports import share_imports

share_imports(["json"])
print(forkserver._forkserver._forkserver_pid, flush=True)
input()
"""
OTHER = """
import gc, multiprocessing
from behavexplor.execution.shared_imports import share_imports

if __name__ == "__main__":
    share_imports(["json"])
    with multiprocessing.get_context("forkserver").Pool(1) as pool:
        print(pool.apply(gc.isenabled), pool.apply(gc.get_freeze_count) > 1000)
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="needs the files in /proc")
def test_the_process_that_imports_for_all_is_not_interrupted():
    """Ctrl-C reaches it, too; in the middle of an import, it would end with a traceback on the terminal."""

    def blocks(pid):
        mask = Path(f"/proc/{pid}/status").read_text().partition("SigBlk:")[2].split()[0]
        return bool(int(mask, 16) & 1 << (signal.SIGINT - 1))

    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        server = int(process.stdout.readline())
        assert blocks(server)
        assert not blocks(process.pid)
        process.communicate(b"\n")


def test_other_processes_of_the_program_collect_garbage(tmp_path):
    """A program has one server for all its processes, such as the environments of Stable-Baselines3."""
    (tmp_path / "script.py").write_text(OTHER)
    command = [sys.executable, "script.py"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert result.stdout == "True True\n", result.stderr


def test_garbage_is_collected_again_after_imports():
    with collections_off():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_garbage_that_is_not_collected_stays_so():
    gc.disable()
    try:
        with collections_off():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
