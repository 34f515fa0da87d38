"""Sizes of the vehicles in the scenes of this package."""

from collections.abc import Mapping
from types import MappingProxyType

EGO_SIZE = (4.70, 2.06)  # length and width [m], Lincoln MKZ
VEHICLE_SIZES: Mapping[str, tuple[float, float]] = MappingProxyType(  # length and width [m]
    {
        "sedan": (4.57, 2.08),
        "suv": (4.71, 2.08),
        "jeep": (4.24, 1.87),
        "hatchback": (4.05, 1.89),
        "school-bus": (9.21, 3.26),
    }
)
