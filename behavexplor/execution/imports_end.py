"""Ends the shared imports when it is imported: see `behavexplor.execution.imports_begin`.

What each worker would load with its first compiled function is loaded here. Then garbage collection is turned on, but
only for objects that are made from now on: no worker needs to visit those of all modules, nor does the server process
at its end.
"""

import gc

from behavexplor.data.first_use import end_loading_at_first_use
from behavexplor.jit import load_compiler

load_compiler()
end_loading_at_first_use()
gc.freeze()
gc.enable()
