"""The command line interface: `python -m behavexplor`."""

import sys

from behavexplor.commands import main

if __name__ == "__main__":
    sys.exit(main())
