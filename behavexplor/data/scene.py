"""Layout of the `Scene` observation: the ego and the vehicles around it, without noise.

As in the paper (section 4.4, threats), perception is bypassed: positions and motions are the true ones. Environments
fill the scene and planners read it. This module is the single definition of its rows and columns.
"""

from typing import Final

PRESENT: Final = 0  # 1 for a vehicle, 0 for an empty row
X: Final = 1  # center [m]
Y: Final = 2  # center [m]
HEADING: Final = 3  # [rad]
SPEED: Final = 4  # along the heading [m/s]
ACCELERATION: Final = 5  # along the heading [m/s2]
LENGTH: Final = 6  # [m]
WIDTH: Final = 7  # [m]

N_COLUMNS: Final = 8
EGO: Final = 0  # the ego's row; NPCs follow in the order of the scenario
