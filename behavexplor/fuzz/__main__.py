"""Run `behavexplor fuzz` by `python -m behavexplor.fuzz`."""

import sys
from importlib import import_module

if __name__ == "__main__":
    commands = import_module("behavexplor.commands")  # by name: no module of the search imports the commands
    sys.exit(commands.main(["fuzz", *sys.argv[1:]]))
