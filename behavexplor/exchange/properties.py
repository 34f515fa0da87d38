"""Properties in OpenSCENARIO files: their names, and the waypoints of a scripted vehicle as the text of one."""

from typing import Final

from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.errors import InputError, brief

ENVIRONMENT: Final = "behavexplor:environment"  # properties of the file
ENV_CONFIG: Final = "behavexplor:env_config"
SCENARIO: Final = "behavexplor:scenario"
VEHICLES: Final = "behavexplor:vehicles"
ROUTE: Final = "behavexplor:route"  # properties of a vehicle
WAYPOINTS: Final = "behavexplor:waypoints"
RECORDED: Final = "behavexplor:recorded"


def waypoint_text(script: NPC) -> str:
    """Return the position [m] and speed [m/s] of each waypoint as a text, from which `read_script` restores them."""
    return ", ".join(f"{waypoint.position!r} {waypoint.speed!r}" for waypoint in script.waypoints)


def read_script(name: str, kind: str, route: str, text: str) -> NPC:
    """Return a scripted vehicle of this type, on the route of this name, with the waypoints in a `waypoint_text`.

    `name`, that of the vehicle in its scene, is for error messages.

    Raises:
        InputError: if the text does not describe waypoints.
    """
    waypoints = []
    for pair in text.split(","):
        try:
            position, speed = map(float, pair.split())
        except ValueError:
            raise InputError(
                f"{name}: a waypoint is a position [m] and a speed [m/s], separated by a space, got {brief(pair)}"
            ) from None
        waypoints.append(Waypoint(position, speed))
    return NPC(kind, route, tuple(waypoints))
