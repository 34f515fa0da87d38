"""Speeds up imports when it is imported, until `behavexplor.execution.imports_end` is imported.

The server process of the shared imports imports both, before and after all others. What imports make lives as long as
the process, so garbage collections would only slow them down. Modules that workers rarely use are loaded at their first
use.
"""

import gc

from behavexplor.data.first_use import begin_loading_at_first_use

begin_loading_at_first_use()
gc.disable()
