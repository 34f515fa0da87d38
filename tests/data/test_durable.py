"""Files are written whole, in one place of the package, and never through a link."""

import ast
import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import pytest

import behavexplor
from behavexplor.campaign.config import read_yaml
from behavexplor.commands.fuzz import read_known_classes
from behavexplor.data.durable import check_file, make_folder, new_file, write_durably, write_given, write_saved
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError

PACKAGE = Path(behavexplor.__file__).parent
OTHERS = {  # modules that write elsewhere than into a folder that a user names
    "data/durable.py": "writes all others",
    "commands/__init__.py": "the null device, in place of an output that is closed",
    "campaign/database_file.py": "the lock, which check_file looks at",
    "jit.py": "compiled code, in a folder of its own",
    "campaign/provenance.py": "the list of own folders, in the user's state folder",
    "execution/worker.py": "nothing: it opens the null device",
    "execution/worker_output.py": "nothing: it opens the null device",
}
WRITING = {"write_text", "write_bytes", "touch", "mkdir", "makedirs", "copyfile", "copytree", "write_xml"}


@pytest.mark.parametrize("place", ["file.part", "file"])
def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path, canary, place):
    (tmp_path / place).symlink_to(canary)
    write_durably(tmp_path / "file", "new")
    assert (tmp_path / "file").read_text() == "new"
    assert not (tmp_path / "file").is_symlink()
    assert not (tmp_path / "file.part").is_symlink()


def test_a_failed_writing_leaves_the_old_file_alone(tmp_path):
    write_durably(tmp_path / "file", b"old")
    with pytest.raises(ZeroDivisionError), new_file(tmp_path / "file") as file:
        file.write(bytes(1 // 0))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"old"


def test_a_pipe_is_written_only_where_the_user_names_it(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="it is a pipe or a device"):
        write_durably(tmp_path / "pipe", "text")
    got = []
    reader = threading.Thread(target=lambda: got.append((tmp_path / "pipe").read_text()))
    reader.start()
    write_given(tmp_path / "pipe", "text")
    reader.join(5)
    assert got == ["text"]
    assert (tmp_path / "pipe").is_fifo()


def test_an_error_of_the_disk_is_not_hidden_by_what_saves(tmp_path):
    """torch, which fills the file, would end with an error of its own instead."""
    code = """
import resource, sys, torch
from functools import partial
from pathlib import Path
from behavexplor.data.durable import write_saved
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_saved(Path("weights.pt"), partial(torch.save, torch.zeros(10_000)))
except OSError as error:
    print(error.strerror, error.filename)
"""
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120).stdout
    assert said == "File too large weights.pt\n"
    assert not list(tmp_path.iterdir())
    write_saved(tmp_path / "weights.pt", lambda file: file.write(b"numbers"))
    assert (tmp_path / "weights.pt").read_bytes() == b"numbers"


def test_a_folder_inside_may_not_be_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "mine").symlink_to(tmp_path / "elsewhere")
    assert make_folder(tmp_path / "mine", "a", "b") == tmp_path / "mine" / "a" / "b"  # the outer one is the user's word
    (tmp_path / "mine" / "a" / "c").symlink_to(tmp_path)
    with pytest.raises(OSError, match="c in it is a symbolic link, which may lead out of it"):
        make_folder(tmp_path / "mine", "a", "c", "d")
    assert not (tmp_path / "d").exists()


def test_only_a_regular_file_is_kept_open(tmp_path):
    check_file(tmp_path / "missing")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for name, words in (("pipe", "not a regular file"), ("dangling", "symbolic link")):
        with pytest.raises(OSError, match=words):
            check_file(tmp_path / name)


def test_what_is_read_is_a_file_of_a_size(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe is not a regular file"):
        read_file(tmp_path / "pipe")
    with pytest.raises(InputError, match="/dev/zero is not a regular file"):
        read_file(Path("/dev/zero"))
    with pytest.raises(InputError, match="/dev/zero has more than 100 bytes"):
        read_file(Path("/dev/zero"), 100, pipes=True)
    for read in (partial(read_file, pipes=True), read_yaml, read_known_classes):  # what a user names, too
        with pytest.raises(InputError, match="pipe is not a regular file"):
            read(tmp_path / "pipe")
    ours, theirs = os.pipe()
    os.write(theirs, b"env: lane-follow")
    os.close(theirs)
    assert read_yaml(Path(f"/dev/fd/{ours}")) == {"env": "lane-follow"}
    os.close(ours)
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(InputError, match="has more than 100000000 bytes, which are not read"):
        read_file(tmp_path / "large")


def writes(node):
    """Return whether a call may write a file by its path."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute | ast.Name):
        return False
    name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
    texts = [given.value for given in node.args if isinstance(given, ast.Constant) and isinstance(given.value, str)]
    modes = name == "open" and any(set(text) <= set("rwaxbt+") and set(text) & set("wax+") for text in texts)
    return modes or (name in WRITING and not texts[1:])


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_files_are_written_in_one_place(path):
    module = path.relative_to(PACKAGE).as_posix()
    found = [node.lineno for node in ast.walk(ast.parse(path.read_text())) if writes(node)]
    assert not found or module in OTHERS
