"""Run `behavexplor fuzz` by `python -m behavexplor.fuzz`."""

import sys

from behavexplor.commands import main

if __name__ == "__main__":
    sys.exit(main(["fuzz", *sys.argv[1:]]))
