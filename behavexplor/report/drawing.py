"""Pictures of traces, seen from above: single frames and animations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from behavexplor.campaign.store import Execution
from behavexplor.data.array_types import Bools, Floats
from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.judge.events import ViolationEvent, violation_event
from behavexplor.report.marks import Color, decisions, outcome, page_colors, type_color, violation_place
from behavexplor.report.road_shapes import line_kinds

_Number = TypeVar("_Number", bound=np.generic)

SIDE = 600  # width of a picture, and its greatest height [px]
VIEW = 80.0  # width of the region around the ego that a picture shows [m]
MARGIN = 8.0  # least height of what is shown above and below the road; text is at the top [m]
MAX_FRAMES = 300  # greatest number of frames of an animation; longer episodes run faster
FRAME_TIME = 0.1  # time between two pictures of an animation [s]

MOST_DRAWN = 100  # greatest number of other vehicles in a picture, those nearest to the ego
_PATH_POINTS = 8000  # greatest number of points of all paths in a picture; longer ones are thinned
_ANIMATION_POINTS = 12_000_000  # greatest number of points in all pictures of an animation; a larger road gets fewer
_PAIRS_AT_ONCE = 20_000  # pairs of vehicles whose distances are computed together, which takes memory
_SHARPNESS = 2  # factor by which pictures are drawn larger before they are reduced


@dataclass(frozen=True)
class Footage:
    """An episode as it is drawn."""

    trace: Trace  # its trace
    shape: RoadShape  # the road on which it was driven
    caption: str  # line of text below the time and the speed
    types: Sequence[str] = ()  # types of the other vehicles, as far as they are known
    violated: Sequence[str] = ()  # names of the violated specs
    decisions: Sequence[tuple[int, str]] = ()  # the driver's meta-actions, each with its frame

    @cached_property
    def event(self) -> ViolationEvent | None:
        """The violation that is marked."""
        return violation_event(self.trace, self.violated)

    @cached_property
    def height(self) -> int:
        """Height of a picture [px], in which the road is seen at its full width from wherever the ego is."""
        if not self.shape.surfaces:
            return SIDE
        across = np.concatenate([surface[:, 1] for surface in self.shape.surfaces])
        ego = self.trace.position[:, 0, 1]
        reach = max(float(across.max() - ego.min()), float(ego.max() - across.min())) + MARGIN
        return min(SIDE, 2 * round(reach * SIDE / VIEW))

    def color(self, vehicle: int) -> Color:
        """Return the color of a vehicle, as on the pages; 0 is the ego."""
        if not vehicle:
            return page_colors()["ego"]
        return page_colors()[f"v{type_color(self.types[vehicle - 1] if vehicle <= len(self.types) else '')}"]


def footage_of(execution: Execution, shape: RoadShape) -> Footage:
    """Return an execution as it is drawn.

    Raises:
        InputError: if its record holds no valid scenario.
    """
    record, scenario, trace = execution.record, execution.scenario, execution.load_trace()
    types, caption = [npc.type for npc in scenario.npcs], outcome(record.violated, record.end)
    return Footage(trace, shape, caption, types, record.violated, decisions(trace, scenario))


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
    nearest = []
    step = max(1, _PAIRS_AT_ONCE // len(trace.size))
    for start in range(0, len(trace.time), step):
        boxes = box_corners(trace.position[start : start + step], trace.heading[start : start + step], trace.size)
        nearest.append(box_distance(boxes[:, :1], boxes[:, 1:]).min(1))
    return int(np.concatenate(nearest).argmin())


def save_animation(file: Path | IO[bytes], footage: Footage) -> None:
    """Write an animation of a whole episode as a GIF; its last frame is shown for two seconds."""
    trace = footage.trace
    count = min(_most_pictures(footage), max(2, round(trace.duration / FRAME_TIME) + 1))
    frames = np.unique(np.searchsorted(trace.time, np.linspace(0, trace.duration, count) - 1e-9))
    pictures = [draw(footage, int(frame)) for frame in frames]
    palette = _palette(pictures)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    times = [int(FRAME_TIME * 1000)] * (len(pictures) - 1) + [2000]
    # `optimize=False`: the file is larger, but it is written in half of the time
    pictures[0].save(file, "GIF", save_all=True, append_images=pictures[1:], duration=times, loop=0, optimize=False)


def _most_pictures(footage: Footage) -> int:
    """Return the greatest number of pictures of an animation, so that it does not take minutes."""
    points = _PATH_POINTS + footage.shape.n_points + 2 * len(footage.trace.illegal_lines)
    return min(MAX_FRAMES, max(2, _ANIMATION_POINTS // points))


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """Return one palette for all pictures, from a sample of them and all colors of the pages."""
    sample = pictures[:: max(1, len(pictures) // 4)]
    height = pictures[0].height
    sheet = Image.new("RGB", (SIDE, height * len(sample)))
    for i, picture in enumerate(sample):
        sheet.paste(picture, (0, height * i))
    swatch = SIDE // len(page_colors())
    for i, color in enumerate(page_colors().values()):
        sheet.paste(color, (swatch * i, 0, swatch * (i + 1), min(swatch, height)))
    return sheet.quantize(colors=255)


def draw(footage: Footage, frame: int) -> Image.Image:
    """Draw one frame: the road, the illegal lines, the vehicles' paths, the vehicles, and a circle at a violation."""
    trace, shape, colors = footage.trace, footage.shape, page_colors()
    canvas = _Canvas(trace.position[frame, 0], footage.height)
    canvas.road(shape, trace)
    canvas.path(_thinned(trace.route, _PATH_POINTS // 4), colors["accent"], 0.25)
    if not trace.signals or ARRIVED in trace.signals:
        canvas.circle(trace.destination, 1.0, colors["accent"])
    boxes = box_corners(trace.position[frame], trace.heading[frame], trace.size)
    present = trace.present if trace.present.size else np.broadcast_to(np.True_, trace.heading.shape)
    drawn = _nearest(trace.position[frame], present[frame])
    most = _PATH_POINTS // (len(drawn) + 1)  # points of each path
    later = _thinned(np.arange(frame, len(trace.time)), most)
    for npc in drawn:
        canvas.path(trace.position[later, npc][present[later, npc]], footage.color(npc), 0.15)
        canvas.vehicle(boxes[npc], footage.color(npc), colors["edge"])
    canvas.path(trace.position[_thinned(np.arange(frame + 1), most), 0], footage.color(0), 0.15)
    canvas.vehicle(boxes[0], footage.color(0), colors["accent"])
    if footage.event is not None and frame >= footage.event.frame:
        canvas.circle(np.array(violation_place(trace, footage.event)), 2.2, colors["hit"], 0.4)
    speed = float(np.hypot(*trace.velocity[frame, 0]))
    command = next((name for begin, name in reversed(footage.decisions) if begin <= frame), "")
    return canvas.finished(f"{trace.time[frame]:.1f} s   {speed:.1f} m/s   {command}".rstrip(), footage.caption)


def _nearest(position: Floats, present: Bools) -> list[int]:
    """Return the present vehicles that are nearest to the ego, at most `MOST_DRAWN`, in their order."""
    others = np.flatnonzero(present[1:]) + 1
    distance = np.hypot(*(position[others] - position[0]).T)
    nearest: list[int] = np.sort(others[np.argsort(distance, kind="stable")[:MOST_DRAWN]]).tolist()
    return nearest


def _thinned(points: NDArray[_Number], most: int) -> NDArray[_Number]:
    """Return at most about `most` of the points of a path, or of their frames, with the first and the last one."""
    step = -(-len(points) // most)
    return points if step < 2 else np.concatenate([points[:-1:step], points[-1:]])


class _Canvas:
    """A picture of the world around a point."""

    def __init__(self, middle: Floats, height: int) -> None:
        self._scale, self._size = SIDE * _SHARPNESS / VIEW, (SIDE, height)
        self._view = np.array(self._size) * VIEW / SIDE  # width and height of what is shown [m]
        self._origin = middle - self._view / 2
        self._colors = page_colors()
        self._image = Image.new("RGB", (SIDE * _SHARPNESS, height * _SHARPNESS), self._colors["ground"])
        self._draw = ImageDraw.Draw(self._image)

    def _pixels(self, points: Floats) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - self._origin) * self._scale]

    def _width(self, width: float) -> int:
        return max(1, round(width * self._scale))

    def road(self, shape: RoadShape, trace: Trace) -> None:
        """Draw the lanes, and the lines between and beside them."""
        for surface in shape.surfaces:
            self._draw.polygon(self._pixels(surface), fill=self._colors["road"])
        for dash in shape.dashes(self._origin, self._origin + self._view):
            self.path(dash, self._colors["dash"], 0.15)
        for border in shape.borders:
            self._illegal_line(border, CURB)
        for line, kind in zip(trace.illegal_lines, line_kinds(shape, trace), strict=True):
            self._illegal_line(line, kind)

    def _illegal_line(self, line: Floats, kind: str) -> None:
        """Draw a curb or a double yellow line."""
        if kind != DOUBLE_YELLOW:
            self.path(line, self._colors["curb"], 0.25)
            return
        along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
        aside = 0.14 * np.array([-along[1], along[0]])
        self.path(line + aside, self._colors["yellow"], 0.14)
        self.path(line - aside, self._colors["yellow"], 0.14)

    def path(self, points: Floats, color: Color, width: float) -> None:
        """Draw a polyline with a width [m]."""
        self._draw.line(self._pixels(points), fill=color, width=self._width(width), joint="curve")

    def circle(self, middle: Floats, radius: float, color: Color, width: float = 0.3) -> None:
        """Draw a circle with a radius and a width [m]."""
        corners = self._pixels(np.array([middle - radius, middle + radius]))
        self._draw.ellipse([*corners[0], *corners[1]], outline=color, width=self._width(width))

    def vehicle(self, corners: Floats, color: Color, edge: Color) -> None:
        """Draw a vehicle with a windscreen near its front, given the corners from `box_corners`."""
        self._draw.polygon(self._pixels(corners), fill=color, outline=edge, width=self._width(0.15))
        right, left, back_left, back_right = corners
        shares = ((0.25, 0.12), (0.25, 0.88), (0.42, 0.82), (0.42, 0.18))  # shares backward and from right to left
        screen = [
            right
            + back * (back_right - right)
            + across * ((left - right) + back * (back_left - left - back_right + right))
            for back, across in shares
        ]
        self._draw.polygon(self._pixels(np.array(screen)), fill=edge)

    def finished(self, title: str, caption: str) -> Image.Image:
        """Return the picture in its final size, with text."""
        picture = self._image.reduce(_SHARPNESS)
        pen = ImageDraw.Draw(picture)
        pen.rectangle([0, 0, SIDE, 48], fill=self._colors["paper"])
        pen.text((12, 5), title, fill=self._colors["ink"], font=ImageFont.load_default(18))
        pen.text((12, 28), caption, fill=self._colors["ink"], font=ImageFont.load_default(14))
        return picture
