"""The command line interface: `python -m behavexplor`."""

import signal
import sys


def run() -> int:
    """Run a command, and return the exit code. Ctrl-C during the imports ends the process without a traceback."""
    is_own = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not one that `nohup` and the like ignore
    if is_own:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from behavexplor.commands import main  # noqa: PLC0415 - while Ctrl-C has this effect

    if is_own:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(run())
