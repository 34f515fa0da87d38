"""The shape of a road for pictures: surfaces, borders and lines between lanes."""

import json
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.untrusted import object_fields, parse_json
from behavexplor.errors import InputError

ROAD_FILE: Final = "road.json"  # file in the run folder of a highway-env environment
DASH, PERIOD = 3.0, 6.0  # length of a dash between lanes, and distance of the starts of two of them [m]
MOST_POINTS: Final = 1_000_000  # of a road, dashes included
FARTHEST: Final = 1e7  # greatest coordinate [m]
_FIELDS: Final = ("surfaces", "striped", "borders")


@dataclass(frozen=True, eq=False)
class RoadShape:
    """The shape of a road, with lengths in meters."""

    surfaces: tuple[Floats, ...]  # polygons, each of shape (n, 2)
    striped: tuple[Floats, ...] = ()  # lines between lanes, each of shape (n, 2)
    borders: tuple[Floats, ...] = ()  # lines at the sides of roads, each of shape (n, 2)
    line_kinds: tuple[str, ...] = ()  # kinds of the illegal lines in a trace
    routes: dict[str, Floats] = field(default_factory=dict)  # center lines of NPCs' routes by name, of shape (n, 2)

    @property
    def n_points(self) -> int:
        """Number of points, plus about the number of dashes."""
        lengths = (np.hypot(*np.diff(line, axis=0).T).sum() for line in self.striped)
        return sum(len(line) for line in (*self.surfaces, *self.striped, *self.borders)) + int(sum(lengths) / PERIOD)

    def dashes(self, low: Floats, high: Floats) -> list[Floats]:
        """Return the dashes of the striped lines in a rectangle, each of shape (2, 2).

        `low` is the corner with the least x and y [m], `high` that with the greatest.
        """
        found = []
        for line in self.striped:
            ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
            starts = np.arange(0.0, ends[-1], PERIOD)
            stations = np.stack([starts, np.minimum(starts + DASH, ends[-1])], axis=1)
            points = np.stack([np.interp(stations, ends, line[:, axis]) for axis in (0, 1)], axis=-1)
            inside = ((points >= low) & (points <= high)).all((1, 2))
            found += list(points[inside])
        return found

    def to_json(self) -> str:
        """Return surfaces, striped lines and borders as JSON, from which `from_json` restores them."""
        return json.dumps({name: [np.round(line, 2).tolist() for line in getattr(self, name)] for name in _FIELDS})

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read the shape that `to_json` wrote.

        Raises:
            InputError: if it is not one.
        """
        values = object_fields("the shape of a road", parse_json(text, "the shape of a road"), _FIELDS)
        surfaces, striped, borders = (
            tuple(_line(name, points) for points in _listed(name, values[name])) for name in _FIELDS
        )
        made = cls(surfaces, striped, borders)
        if made.n_points > MOST_POINTS:
            raise InputError(f"The shape of a road has at most {MOST_POINTS} points and dashes, not {made.n_points}")
        return made


def _listed(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{name} of the shape of a road must be a list of lines")
    return value


def _line(name: str, points: Any) -> Floats:
    try:
        line = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        line = np.zeros(0)
    if line.ndim != 2 or line.shape[1] != 2 or len(line) < 2 or not (np.abs(line) <= FARTHEST).all():  # nor NaN
        raise InputError(f"{name} of the shape of a road must be lines of at least two points within {FARTHEST:g} m")
    return line
