import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
