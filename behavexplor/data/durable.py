"""Files that are written whole or not at all, and never through a symbolic link.

A folder may come from someone else, with links in the places where a command will write. The folder that the user names
may be a link itself; what lies in it does not lead out of it.
"""

import errno
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter, BytesIO
from pathlib import Path

from behavexplor.errors import InputError


@contextmanager
def writing(what: str | Path) -> Iterator[None]:
    """Return a context in which an `OSError` becomes an `InputError`: that `what` cannot be written, and why."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{what} cannot be written: {error.strerror}") from None


def write_durably(path: Path, content: str | bytes) -> None:
    """Write a file atomically and flush it to disk, so that a crash leaves no partial file.

    Raises:
        OSError: if it cannot be written.
    """
    with new_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_saved(path: Path, save: Callable[[BytesIO], object]) -> None:
    """Write what `save` writes to a file in memory, since torch hides errors of the disk; see `write_durably`."""
    saved = BytesIO()
    save(saved)
    write_durably(path, saved.getvalue())


def write_whole(path: Path, text: str) -> None:
    """Write a file atomically, without waiting for the disk: after a power cut it may be missing or empty.

    Raises:
        OSError: if it cannot be written.
    """
    _check_replaceable(path)
    partial = Path(f"{path}.part")
    with _new(partial) as file:
        file.write(text.encode())
    partial.replace(path)


def write_given(path: Path, text: str) -> None:
    """Write a file that the user has named, which may also be a pipe or a terminal.

    Raises:
        OSError: if it cannot be written.
    """
    if path.exists() and not path.is_file():
        path.write_text(text)
    else:
        write_durably(path, text)


def check_given(path: Path) -> None:
    """Check that `write_given` can write a file, by writing another one beside it, which is removed at once.

    Raises:
        OSError: if it cannot.
    """
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    if path.is_file() or not path.exists():
        with tempfile.NamedTemporaryFile(prefix=f"{path.name}.", dir=path.parent):
            pass


def append_durably(path: Path, content: bytes) -> None:
    """Append to a file, which may not exist, and flush it to disk. A crash may leave a part of the content at its end.

    Raises:
        OSError: if it cannot be written, or is no regular file.
    """
    check_file(path)
    with path.open("ab") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def new_file(path: Path) -> Iterator[BufferedWriter]:
    """Open a new file, which is flushed to disk and takes the place of `path` when the block ends without an error.

    A link to a file, or to nothing, is replaced, and that file is left as it is.

    Raises:
        OSError: if the file cannot be written, or something other than a file is in its place.
    """
    _check_replaceable(path)
    partial = path.with_name(path.name + ".part")
    with _new(partial) as file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
        except BaseException as error:
            partial.unlink(missing_ok=True)
            if isinstance(error, OSError) and error.filename is None:
                error.filename = str(path)  # a full disk names no file
            raise
    partial.replace(path)


def _check_replaceable(path: Path) -> None:
    """Check before anything is written that a file can take the place of what is there."""
    try:
        kind = path.stat().st_mode
    except OSError:  # nothing is there, or a link that leads to nothing
        return
    if stat.S_ISDIR(kind):  # the folders "." and "/" have no names to change, either
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(kind):
        raise OSError(errno.EEXIST, "it is a pipe or a device, and no file", str(path))


def _new(partial: Path) -> BufferedWriter:
    try:
        return partial.open("xb")  # "x" follows no link
    except FileExistsError:  # left by an earlier crash
        partial.unlink()
        return partial.open("xb")


def make_folder(folder: Path, *names: str) -> Path:
    """Return a folder, or the one inside it that the names lead to. All are created if they do not exist.

    Raises:
        OSError: if one of them cannot be created, or one inside the first is a symbolic link.
    """
    check_no_file(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        folder = folder / name
        if folder.is_symlink():
            raise _leading_out(folder)
        folder.mkdir(exist_ok=True)
    return folder


def check_no_file(folder: Path) -> None:
    """Check that no file is in the place where a folder will be, or in that of one above it.

    Raises:
        OSError: if there is one, or a link that leads to nothing.
    """
    file = next((one for one in (folder, *folder.parents) if os.path.lexists(one) and not one.is_dir()), None)
    if file is not None:
        kind = "a file" if file.exists() else "a symbolic link to nothing"
        raise NotADirectoryError(errno.ENOTDIR, f"{file} is {kind}: name a folder", str(folder))


def check_file(path: Path) -> None:
    """Check that a path is a regular file, if there is anything.

    Raises:
        OSError: if it is a symbolic link, which may lead anywhere, or a pipe, which may have no other end.
    """
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            raise _leading_out(path)
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, f"{path.name} in it is not a regular file", str(path))


def _leading_out(path: Path) -> OSError:
    return OSError(errno.ELOOP, f"{path.name} in it is a symbolic link, which may lead out of it", str(path))
