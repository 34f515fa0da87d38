"""Pictures of traces, seen from above: single frames and animations."""

from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.judge.events import violation_event
from behavexplor.report.road_shapes import line_kinds

Floats = NDArray[np.float64]
Color = tuple[int, int, int]

SIDE = 600  # width and height of a picture [px]
VIEW = 80.0  # side of the square around the ego that a picture shows [m]
MAX_FRAMES = 300  # greatest number of frames of an animation; longer episodes run faster
FRAME_TIME = 0.1  # time between two pictures of an animation [s]

_SHARPNESS = 2  # factor by which pictures are drawn larger before they are reduced
_GROUND, _ASPHALT, _DIVIDER, _CURB, _YELLOW = (
    (228, 232, 226),
    (92, 97, 104),
    (205, 208, 212),
    (245, 245, 245),
    (245, 190, 50),
)
_EGO, _HIT, _INK, _PAPER = (46, 170, 90), (222, 60, 60), (30, 34, 40), (255, 255, 255)
_NPCS = ((66, 133, 222), (226, 128, 60), (160, 104, 206), (40, 168, 178), (206, 96, 152), (120, 110, 90))
_GLASS = (28, 36, 48)
_COLORS = (_GROUND, _ASPHALT, _DIVIDER, _CURB, _YELLOW, _EGO, _HIT, _INK, _PAPER, _GLASS, *_NPCS)


def decisive_frame(trace: Trace, violated: Sequence[str]) -> int:
    """Return the frame that shows the reason for a verdict.

    For a touched line, this is the first touch. For a collision or a missed destination, it is the last frame. Without
    a violation, it is the frame in which the ego came nearest to another vehicle.
    """
    if "lines" in violated and "collision" not in violated:
        event = violation_event(trace, ("lines",))
        return len(trace.time) - 1 if event is None else event.frame
    if violated or len(trace.size) == 1:
        return len(trace.time) - 1
    boxes = box_corners(trace.position, trace.heading, trace.size)
    return int(box_distance(boxes[:, :1], boxes[:, 1:]).min(1).argmin())


def save_animation(file: Path | IO[bytes], trace: Trace, shape: RoadShape, caption: str) -> None:
    """Write an animation of the whole trace as a GIF; its last frame is shown for two seconds."""
    count = min(MAX_FRAMES, max(2, round(trace.duration / FRAME_TIME) + 1))
    frames = np.unique(np.searchsorted(trace.time, np.linspace(0, trace.duration, count) - 1e-9))
    pictures = [draw(trace, shape, int(frame), caption) for frame in frames]
    palette = _palette(pictures)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    times = [int(FRAME_TIME * 1000)] * (len(pictures) - 1) + [2000]
    pictures[0].save(file, "GIF", save_all=True, append_images=pictures[1:], duration=times, loop=0)


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """Return one palette for all pictures, from a sample of them and all base colors."""
    sample = pictures[:: max(1, len(pictures) // 4)]
    sheet = Image.new("RGB", (SIDE, SIDE * len(sample)))
    for i, picture in enumerate(sample):
        sheet.paste(picture, (0, SIDE * i))
    swatch = SIDE // len(_COLORS)
    for i, color in enumerate(_COLORS):
        sheet.paste(color, (swatch * i, 0, swatch * (i + 1), swatch))
    return sheet.quantize(colors=255)


def draw(trace: Trace, shape: RoadShape, frame: int, caption: str) -> Image.Image:
    """Draw one frame: the road, the illegal lines, the vehicles' paths, and the vehicles.

    Args:
        trace: trace of an episode.
        shape: road on which it was driven.
        frame: index of the frame.
        caption: line of text below the time and the speed.
    """
    canvas = _Canvas(trace.position[frame, 0])
    present = trace.present if trace.present.size else np.ones(trace.heading.shape, dtype=bool)
    for surface in shape.surfaces:
        canvas.surface(surface)
    for dash in shape.dashes(*canvas.corners):
        canvas.path(dash, _DIVIDER, 0.15)
    for border in shape.borders:
        canvas.illegal_line(border, CURB)
    for line, kind in zip(trace.illegal_lines, line_kinds(shape, trace), strict=True):
        canvas.illegal_line(line, kind)
    canvas.path(trace.route, _EGO, 0.25)
    if not trace.signals or ARRIVED in trace.signals:
        canvas.circle(trace.destination, 1.0, _EGO)
    boxes = box_corners(trace.position[frame], trace.heading[frame], trace.size)
    hit = np.concatenate([[False], box_distance(boxes[:1], boxes[1:]) == 0])
    if trace.partner > 0 and frame == len(trace.time) - 1:
        hit[trace.partner] = True
    for npc in np.flatnonzero(present[frame, 1:]) + 1:
        color = _HIT if hit[npc] else _NPCS[(npc - 1) % len(_NPCS)]
        canvas.path(trace.position[frame:, npc][present[frame:, npc]], color, 0.15)
        canvas.vehicle(boxes[npc], color)
    canvas.path(trace.position[: frame + 1, 0], _INK, 0.15)
    canvas.vehicle(boxes[0], _EGO)
    speed = float(np.hypot(*trace.velocity[frame, 0]))
    return canvas.finished(f"{trace.time[frame]:.1f} s   {speed:.1f} m/s", caption)


class _Canvas:
    """A picture of the world around a point."""

    def __init__(self, middle: Floats) -> None:
        self._scale = SIDE * _SHARPNESS / VIEW
        self._origin = middle - VIEW / 2
        self._image = Image.new("RGB", (SIDE * _SHARPNESS,) * 2, _GROUND)
        self._draw = ImageDraw.Draw(self._image)

    def _pixels(self, points: Floats) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - self._origin) * self._scale]

    def _width(self, width: float) -> int:
        return max(1, round(width * self._scale))

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """The corners of the picture with the least and the greatest coordinates, each of shape (2,) [m]."""
        return self._origin, self._origin + VIEW

    def surface(self, outline: Floats) -> None:
        """Draw the surface of a lane, given its outline, shape (n, 2)."""
        self._draw.polygon(self._pixels(outline), fill=_ASPHALT)

    def illegal_line(self, line: Floats, kind: str) -> None:
        """Draw a curb or a double yellow line."""
        if kind != DOUBLE_YELLOW:
            self.path(line, _CURB, 0.25)
            return
        along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
        aside = 0.14 * np.array([-along[1], along[0]])
        self.path(line + aside, _YELLOW, 0.14)
        self.path(line - aside, _YELLOW, 0.14)

    def path(self, points: Floats, color: Color, width: float) -> None:
        """Draw a polyline with a width [m]."""
        self._draw.line(self._pixels(points), fill=color, width=self._width(width), joint="curve")

    def circle(self, middle: Floats, radius: float, color: Color) -> None:
        """Draw a circle with a radius [m]."""
        corners = self._pixels(np.array([middle - radius, middle + radius]))
        self._draw.ellipse([*corners[0], *corners[1]], outline=color, width=self._width(0.3))

    def vehicle(self, corners: Floats, color: Color) -> None:
        """Draw a vehicle with a windscreen near its front, given the corners from `box_corners`."""
        self._draw.polygon(self._pixels(corners), fill=color, outline=_INK, width=self._width(0.1))
        right, left, back_left, back_right = corners
        shares = ((0.25, 0.12), (0.25, 0.88), (0.42, 0.82), (0.42, 0.18))  # shares backward and from right to left
        screen = [
            right
            + back * (back_right - right)
            + across * ((left - right) + back * (back_left - left - back_right + right))
            for back, across in shares
        ]
        self._draw.polygon(self._pixels(np.array(screen)), fill=_GLASS)

    def finished(self, title: str, caption: str) -> Image.Image:
        """Return the picture in its final size, with text."""
        picture = self._image.resize((SIDE, SIDE), Image.Resampling.LANCZOS)
        pen = ImageDraw.Draw(picture)
        pen.rectangle([0, 0, SIDE, 48], fill=_PAPER)
        pen.text((12, 5), title, fill=_INK, font=ImageFont.load_default(18))
        pen.text((12, 28), caption, fill=_INK, font=ImageFont.load_default(14))
        return picture
