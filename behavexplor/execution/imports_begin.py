"""Turns garbage collection off when it is imported, until `behavexplor.execution.imports_end` is imported.

The server process of the shared imports imports both, before and after all others. What imports make lives as long as
the process, so collections would only slow them down.
"""

import gc

gc.disable()
