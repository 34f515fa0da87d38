"""Replay of one execution: an animation, its decisive frame, and a check that the execution is reproducible."""

import base64
from functools import cached_property
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Final

from PIL import Image

from behavexplor.campaign.store import Execution
from behavexplor.data.durable import new_file
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.report.drawing import decisive_frame, draw, footage_of, save_animation

_SUFFIXES: Final = (".gif", ".png")


class Replay:
    """The replay of one execution, which a notebook shows as an animation.

    Args:
        execution: the execution.
        shape: the road on which it was driven.

    Attributes:
        number: number of the execution.
        trace: its trace.
        caption: what happened, such as "violates collision and destination, ended by a collision".
    """

    def __init__(self, execution: Execution, shape: RoadShape) -> None:
        self.number = execution.id
        self._footage = footage_of(execution, shape)
        self.trace: Trace = self._footage.trace
        self.caption = self._footage.caption

    def __repr__(self) -> str:
        return f"<Replay of execution {self.number}: {self.caption}>"

    @cached_property
    def gif(self) -> bytes:
        """The animation as a GIF file."""
        file = BytesIO()
        save_animation(file, self._footage)
        return file.getvalue()

    @property
    def picture(self) -> Image.Image:
        """The decisive frame: the collision, the first touch of a line, or the end."""
        return draw(self._footage, decisive_frame(self.trace, self._footage.violated))

    def save(self, path: str | Path) -> Path:
        """Write the animation (.gif) or the decisive frame (.png) to a file, and return its path.

        Raises:
            InputError: if the file has another suffix, or cannot be written.
        """
        target = Path(path)
        if target.suffix not in _SUFFIXES:
            raise InputError(f"A replay is saved as {' or '.join(_SUFFIXES)}, not as {target.name!r}")
        try:
            with new_file(target) as file:
                if target.suffix == ".gif":
                    file.write(self.gif)
                else:
                    self.picture.save(file, "PNG")
        except OSError as error:
            raise InputError(f"The replay {target} cannot be written: {error.strerror}") from None
        return target

    def _repr_html_(self) -> str:
        data = base64.b64encode(self.gif).decode()
        title = escape(f"Execution {self.number} {self.caption}")
        return (
            f'<figure><img alt="{title}" src="data:image/gif;base64,{data}"><figcaption>{title}</figcaption></figure>'
        )
