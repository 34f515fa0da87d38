"""Import this module to exempt all objects that exist by then from garbage collection.

The server process of the shared imports imports it last. Otherwise each of its copies, and itself at its end, would
visit the objects of all modules.
"""

import gc

gc.freeze()
