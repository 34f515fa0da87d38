"""Parts of a scenario: what minimization may remove, or replace by something plain."""

from typing import NamedTuple

Value = float | str | None


class Part(NamedTuple):
    """A vehicle, or another part of a scene, as a list of values.

    Attributes:
        label: what stays as it is as long as the part is there, such as the route of a vehicle.
        values: the values of the part; None stands for a plain value, such as the speed of the waypoint before, or the
            median of a draw.
    """

    label: str
    values: tuple[Value, ...]

    @property
    def free(self) -> int:
        """Number of values that are not plain."""
        return sum(value is not None for value in self.values)


Parts = tuple[Part, ...]


class Size(NamedTuple):
    """The size of a scenario.

    Attributes:
        parts: number of vehicles, or of parts with a value that is not plain where parts cannot be removed.
        values: number of values that are not plain.
    """

    parts: int
    values: int
