"""Names in the exchanged files that are this package's own: properties of the file and of its vehicles."""

from typing import Final

ENVIRONMENT: Final = "behavexplor:environment"  # properties of the file
ENV_CONFIG: Final = "behavexplor:env_config"
SCENARIO: Final = "behavexplor:scenario"
VEHICLES: Final = "behavexplor:vehicles"
ROUTE: Final = "behavexplor:route"  # properties of a vehicle
WAYPOINTS: Final = "behavexplor:waypoints"
RECORDED: Final = "behavexplor:recorded"
