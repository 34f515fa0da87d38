"""Commands where folders that libraries write to cannot be written."""

import os
import signal
import subprocess
import sys
import tempfile

import pytest

from behavexplor import commands
from behavexplor.commands import BAD_INPUT, NO_TEMPORARY_FOLDER, OK, main


@pytest.fixture
def seen(monkeypatch):
    """The folders of matplotlib that a command has seen."""
    found = []

    def command() -> int:
        found.append(os.environ.get("MPLCONFIGDIR"))
        return OK

    monkeypatch.setattr(commands, "_command", lambda _: command)
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    return found


@pytest.mark.parametrize("home", ["/nonexistent", os.devnull])
def test_matplotlib_gets_a_folder_where_home_cannot_be_written(home, seen, monkeypatch):
    assert main(["records"]) == OK
    monkeypatch.setenv("HOME", home)
    assert main(["records"]) == OK
    monkeypatch.setenv("MPLCONFIGDIR", "/mine")
    assert main(["records"]) == OK
    own, temporary, given = seen
    assert (own, given) == (None, "/mine")
    assert temporary.startswith(tempfile.gettempdir())
    assert not os.path.exists(temporary)  # noqa: PTH110 - removed in the end


def test_a_missing_folder_for_temporary_files_is_one_sentence(monkeypatch, capsys):
    def nowhere():
        raise FileNotFoundError(2, "No usable temporary directory found")

    def command() -> int:
        nowhere()
        return OK

    monkeypatch.setattr(commands, "_command", lambda _: command)
    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    assert main(["records"]) == BAD_INPUT
    assert capsys.readouterr().err.splitlines()[-1].endswith(NO_TEMPORARY_FOLDER)


INTERRUPTED_IMPORT = """
import os, signal, sys
import behavexplor.__main__

class Finder:
    def find_spec(self, name, *_):
        if name == "behavexplor.commands":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
behavexplor.__main__.run()
"""


def test_ctrl_c_during_the_imports_shows_no_traceback():
    ended = subprocess.run([sys.executable, "-c", INTERRUPTED_IMPORT], capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, b"")
