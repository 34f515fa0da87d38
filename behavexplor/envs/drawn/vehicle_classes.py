"""Parameters of highway-env's vehicle classes, which one environment would change for all others in the process.

`IntersectionEnv` sets attributes of the class of its vehicles in each reset, and relies on them while it runs.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from highway_env.vehicle.behavior import IDMVehicle

Parameters = dict[type, dict[str, Any]]


class VehicleClasses:
    """The parameters of the vehicle classes as one environment has left them.

    An environment begins with those that it finds in its process, as it does without this class.
    """

    def __init__(self) -> None:
        self._own: Parameters | None = None

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let the environment run with the parameters that it left, and give all others theirs back afterwards."""
        others = parameters()
        if self._own is not None:
            set_parameters(self._own)
        try:
            yield
        finally:
            self._own = parameters()
            set_parameters(others)


def parameters() -> Parameters:
    """Return the parameters, which are named in capitals, by class."""
    found: Parameters = {}
    classes: list[type] = [IDMVehicle]
    while classes:
        kind = classes.pop()
        found[kind] = {name: value for name, value in vars(kind).items() if name.isupper()}
        classes += kind.__subclasses__()
    return found


def set_parameters(parameters: Parameters) -> None:
    """Give the classes the parameters, and take from them those that are not named."""
    for kind, wanted in parameters.items():
        present = {name: value for name, value in vars(kind).items() if name.isupper()}
        for name in present.keys() - wanted.keys():
            delattr(kind, name)
        for name, value in wanted.items():
            if present.get(name, ...) is not value:
                setattr(kind, name, value)
