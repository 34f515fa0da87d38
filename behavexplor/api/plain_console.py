"""A console of rich for texts that may quote files of others and messages of drivers."""

from typing import Any

from rich.console import Console
from rich.text import Text

from behavexplor.errors import printable


class PlainConsole(Console):
    """A console on which a text is nothing but text: control characters, markup and emoji codes have no effect.

    Args:
        settings: settings of the `Console`.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **settings)

    def render_str(self, text: str, **settings: Any) -> Text:
        """Return a text as it is shown. All strings that are printed, also in tables, go through this."""
        return super().render_str(printable(text), **settings)
