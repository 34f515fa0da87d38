"""The waypoints of a scripted vehicle as a text that people can change: "position speed, position speed, ..."."""

from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.errors import InputError, brief


def waypoint_text(script: NPC) -> str:
    """Return the position [m] and speed [m/s] of each waypoint as a text, from which `read_script` restores them."""
    return ", ".join(f"{waypoint.position!r} {waypoint.speed!r}" for waypoint in script.waypoints)


def read_script(name: str, kind: str, route: str, text: str) -> NPC:
    """Return a scripted vehicle.

    Args:
        name: name of the vehicle in its scene, for error messages.
        kind: type of the vehicle.
        route: name of its route.
        text: its waypoints, as `waypoint_text` writes them.

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
