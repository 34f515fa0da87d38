"""Confinement: a process permanently gives up its right to write files and to use the network.

It is meant for driving systems that are third-party code. They may read what the user may read, compute, and answer.
Only Linux offers this to an unprivileged process: Landlock (https://docs.kernel.org/userspace-api/landlock.html) blocks
writing, and a seccomp filter blocks new sockets. Both apply to all threads and processes that are started afterwards.
"""

import errno
import tempfile
from pathlib import Path
from typing import Final

# Devices that GPU computing, shared memory between threads, and discarded output write to.
_DEVICES: Final = ("null", "zero", "full", "tty", "shm", "nvidia*", "nvidia-caps", "dri", "kfd")
# Calls that create sockets, directly or through io_uring. Socket pairs within the process and its children still work.
_SYSTEM_CALLS: Final = ("socket", "io_uring_setup")


def confine() -> tuple[str, ...]:
    """Block file writes and network access for this thread, and for all threads and processes that it starts.

    Writing remains possible in the temporary folder of `tempfile`.

    Returns:
        Actions that this system cannot prevent, such as "write files".
    """
    loose = []
    if not _seal_files():
        loose.append("write files")
    if not _seal_network():
        loose.append("use the network")
    return tuple(loose)


def _seal_files() -> bool:
    """Block writing files, and from Linux 6.12 on signals to outside processes. Return whether writing is blocked."""
    try:
        from landlockpy import AccessFS, LandlockError, Ruleset, Scope, supported  # noqa: PLC0415 - Linux only
    except ModuleNotFoundError:
        return False
    reading = AccessFS.EXECUTE | AccessFS.READ_FILE | AccessFS.READ_DIR
    writing = ~(reading | AccessFS.IOCTL_DEV)
    of_a_file = AccessFS.WRITE_FILE | AccessFS.TRUNCATE
    devices = [device for pattern in _DEVICES for device in Path("/dev").glob(pattern)]
    try:
        if not supported():
            return False
        with Ruleset(handled_fs=writing, scoped=Scope.SIGNAL | Scope.ABSTRACT_UNIX_SOCKET) as ruleset:
            for place in (Path(tempfile.gettempdir()), *devices):
                ruleset.allow_path(place, writing if place.is_dir() else of_a_file)
            ruleset.restrict()
    except LandlockError:
        return False
    return True


def _seal_network() -> bool:
    """Block new sockets. Return whether they are blocked."""
    try:
        import pyseccomp  # noqa: PLC0415 - Linux only
    except (ImportError, OSError, RuntimeError):  # without libseccomp
        return False
    try:
        calls = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
        for name in _SYSTEM_CALLS:
            calls.add_rule(pyseccomp.ERRNO(errno.EACCES), name)
        calls.load()
    except (OSError, RuntimeError, ValueError):
        return False
    return True
