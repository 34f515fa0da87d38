"""Confinement: a process gives up, for good, its right to write files and to use the network.

For driving systems that are programs of somebody else: they may read what the user may, compute, and answer. Linux
alone can do this for a process without rights of its own: Landlock (https://docs.kernel.org/userspace-api/landlock.html)
refuses to write, and a seccomp filter refuses to make sockets. Both hold for all threads and processes that are begun
afterwards.
"""

import errno
import tempfile
from pathlib import Path
from typing import Final

# What arithmetic on a GPU, shared memory of threads, and programs that throw their output away write to.
_DEVICES: Final = ("null", "zero", "full", "tty", "shm", "nvidia*", "nvidia-caps", "dri", "kfd")
# Sockets, and the one other door to them; pairs of sockets within the process and its children remain.
_SYSTEM_CALLS: Final = ("socket", "io_uring_setup")


def confine() -> tuple[str, ...]:
    """Take from this thread, and all that it begins, the right to write files and to use the network.

    Files of its own it may write in the folder of `tempfile`.

    Returns:
        What this system cannot prevent, a few words each.
    """
    loose = []
    if not _seal_files():
        loose.append("write files")
    if not _seal_network():
        loose.append("use the network")
    return tuple(loose)


def _seal_files() -> bool:
    """Whether writing is refused from now on; so are signals to processes outside, from Linux 6.12 on."""
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
    """Whether new sockets are refused from now on."""
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
