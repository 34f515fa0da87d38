"""Import this module to turn garbage collection off; `gc.enable` turns it on again.

The server process of the shared imports imports it first. What the other imports make lives as long as the process, so
collections would only slow them down.
"""

import gc

gc.disable()
