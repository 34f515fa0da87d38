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
