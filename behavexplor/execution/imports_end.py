"""Turns garbage collection on when it is imported, for all objects that do not exist yet.

Otherwise the server process of the shared imports, at its end, and each of its copies would visit the objects of all
modules.
"""

import gc

gc.freeze()
gc.enable()
