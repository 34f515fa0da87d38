"""Ends the shared imports when it is imported: see `behavexplor.execution.imports_begin`.

It loads what each worker would load with its first compiled function. Garbage collection is turned on for the objects
that do not exist yet. Otherwise the server process, at its end, and each of its copies would visit the objects of all
modules.
"""

import gc

from behavexplor.jit import load_compiler

load_compiler()
gc.freeze()
gc.enable()
