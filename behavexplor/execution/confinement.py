"""Confinement: a process permanently gives up its right to write files, to use the network and to use a terminal.

It is meant for driving systems that are third-party code. They may read what the user may read, compute, and answer.
Only Linux offers this to an unprivileged process: Landlock (https://docs.kernel.org/userspace-api/landlock.html) blocks
writing and devices, and a seccomp filter blocks new sockets and the calls that put input into a terminal. Both apply to
all threads and processes that are started afterwards.
"""

import errno
import tempfile
from pathlib import Path
from socket import SOCK_DGRAM
from typing import Final

# Devices that GPU computing, shared memory between threads, and discarded output use. All others are blocked, terminals
# among them.
_DEVICES: Final = ("null", "zero", "full", "random", "urandom", "shm", "nvidia*", "dri", "kfd")
# Calls that create sockets, directly or through io_uring. Socket pairs within the process and its children still work.
_SOCKET_CALLS: Final = ("socket", "io_uring_setup")
# Calls that change owner, permissions, times or attributes of a file, which Landlock leaves alone. The last three are
# fchmodat2, setxattrat and removexattrat, which older versions of libseccomp do not know by name.
_ATTRIBUTE_CALLS: Final = (
    *("chmod", "fchmod", "fchmodat", "chown", "lchown", "fchown", "fchownat"),
    *("utime", "utimes", "futimesat", "utimensat"),
    *("setxattr", "lsetxattr", "fsetxattr", "removexattr", "lremovexattr", "fremovexattr"),
    *(452, 463, 466),
)
# Calls that change limits, priority or processors of a process, with the argument that is 0 for the calling one.
_PROCESS_CALLS: Final = {
    "prlimit64": 0,
    "sched_setaffinity": 0,
    "sched_setattr": 0,
    "sched_setparam": 0,
    "sched_setscheduler": 0,
    "setpriority": 1,
    "ioprio_set": 1,
}
_KIND_OF_SOCKET: Final = 0xF  # its bits in the second argument of `socketpair`
_KNOWS_TRUNCATION: Final = 3  # version of Landlock, of Linux 6.2
# Requests of `ioctl` that put input into a terminal, or change what a terminal belongs to.
_TERMINAL_REQUESTS: Final = ("TIOCSTI", "TIOCLINUX", "TIOCSCTTY", "TIOCSETD", "TIOCCONS")
_REQUEST_BITS: Final = 0xFFFFFFFF  # of the 64 bits of the argument, which is all that Linux looks at


def confine() -> tuple[str, ...]:
    """Block file writes, network access and terminals for this thread, and for all threads and processes it starts.

    Attributes of files, and limits and priorities of other processes, cannot be changed either. Writing remains
    possible in the temporary folder of `tempfile`. Files that are open, such as a terminal, stay open. Return what this
    system cannot prevent, such as "write files".
    """
    loose = []
    if not _seal_files():
        loose.append("write files")
    if not _seal_calls():
        loose.append("use the network")
    return tuple(loose)


def _seal_files() -> bool:
    """Block writing files, opening devices, and from Linux 6.12 on signals to outside processes.

    Return whether writing is blocked.
    """
    try:
        from landlockpy import AccessFS, LandlockError, Ruleset, Scope, abi_version  # noqa: PLC0415 - Linux only
    except ModuleNotFoundError:
        return False
    sealed = ~(AccessFS.EXECUTE | AccessFS.READ_DIR | AccessFS.IOCTL_DEV)
    of_a_file = AccessFS.READ_FILE | AccessFS.WRITE_FILE | AccessFS.TRUNCATE
    # rules of Landlock only allow something, so reading is allowed everywhere but in /dev
    readable = [place for place in Path("/").iterdir() if place.name != "dev" and not place.is_symlink()]
    devices = [device for pattern in _DEVICES for device in Path("/dev").glob(pattern)]
    try:
        if abi_version() < 1:  # this system has no Landlock
            return False
        with Ruleset(handled_fs=sealed, scoped=Scope.SIGNAL | Scope.ABSTRACT_UNIX_SOCKET) as ruleset:
            for place in (Path(tempfile.gettempdir()), *devices):
                ruleset.allow_path(place, sealed if place.is_dir() else of_a_file)
            for place in readable:
                ruleset.allow_path(place, AccessFS.READ_FILE)
            ruleset.restrict()
        return abi_version() >= _KNOWS_TRUNCATION  # before, files could be emptied
    except LandlockError:
        return False


def _seal_calls() -> bool:
    """Block the calls named above: on sockets, attributes, processes and terminals. Return whether all are blocked."""
    try:
        import termios  # noqa: PLC0415 - not on Windows

        import pyseccomp  # noqa: PLC0415 - Linux only
    except (ImportError, OSError, RuntimeError):  # without libseccomp
        return False
    try:
        calls = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
        refused = pyseccomp.ERRNO(errno.EACCES)
        for call in (*_SOCKET_CALLS, *_ATTRIBUTE_CALLS):
            calls.add_rule(refused, call)
        for name, place in _PROCESS_CALLS.items():
            calls.add_rule(refused, name, pyseccomp.Arg(place, pyseccomp.NE, 0))
        datagrams = pyseccomp.Arg(1, pyseccomp.MASKED_EQ, _KIND_OF_SOCKET, SOCK_DGRAM)  # could reach local services
        calls.add_rule(refused, "socketpair", datagrams)
        for name in _TERMINAL_REQUESTS:
            request = pyseccomp.Arg(1, pyseccomp.MASKED_EQ, _REQUEST_BITS, getattr(termios, name))
            calls.add_rule(refused, "ioctl", request)
        calls.load()
    except (OSError, RuntimeError, ValueError):
        return False
    return True
