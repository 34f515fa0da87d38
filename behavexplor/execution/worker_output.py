"""The output of a worker that runs third-party code: a pipe in place of the user's terminal.

Such a worker could type into a terminal, read what the user types, and send it control characters. So it has none. The
supervisor reads its output line by line, and prints it on stderr with escapes in place of control characters.
"""

import multiprocessing
import os
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from behavexplor.errors import printable

CAN_LEAVE: Final = hasattr(os, "setsid")  # Windows has no terminals of this kind
_LONGEST: Final = 4096  # a longer line is broken, so that it does not wait for its end in memory [bytes]
_PIPE: Final = 2**20  # greatest size of a pipe without special rights on Linux [bytes]


class WorkerOutput:
    """The supervisor's end of the pipe. It is closed if nothing can come any more.

    `theirs` is the worker's end, which the supervisor must close after it has started the worker.
    """

    def __init__(self) -> None:
        self.connection, self.theirs = multiprocessing.Pipe(duplex=False)
        os.set_blocking(self.connection.fileno(), False)
        self._begun = b""  # a line without its end

    def pass_on(self, *, ended: bool = False) -> None:
        """Print the lines that have come. Does not wait for more.

        If the worker has ended, the rest is a line, too. Processes that it has left behind may have the pipe, but are
        no longer read.
        """
        if self.connection.closed:
            return
        some = b""
        with suppress(BlockingIOError):
            some = os.read(self.connection.fileno(), _PIPE)
            ended = ended or not some
        whole, newline, self._begun = (self._begun + some).rpartition(b"\n")
        if self._begun and (ended or len(self._begun) > _LONGEST):
            whole, newline, self._begun = whole + newline + self._begun, b"\n", b""
        with suppress(Exception):  # stderr is closed, or an object of the user
            sys.stderr.write(printable((whole + newline).decode(errors="backslashreplace")))
            sys.stderr.flush()
        if ended:
            self.connection.close()


def leave_terminal(output: Connection) -> None:
    """Give this process a session without a terminal, and make it print into the worker's end of the pipe.

    No file of the process is a terminal afterwards, and its stdin is empty.
    """
    os.setsid()
    with Path(os.devnull).open("r+b", buffering=0) as nothing:
        for file in (int(entry.name) for entry in Path("/dev/fd").iterdir()):
            if os.isatty(file):
                os.dup2(nothing.fileno(), file)
        if sys.__stdin__ is not None:
            os.dup2(nothing.fileno(), 0)
    for stream in (sys.__stdout__, sys.__stderr__):
        if stream is not None:  # else its file has been closed, and the number belongs to another one
            os.dup2(output.fileno(), stream.fileno())
            stream.reconfigure(line_buffering=True)
    output.close()
