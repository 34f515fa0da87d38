"""BehAVExplor: find out how a driving policy fails, by fuzzing it in traffic scenarios on highway-env.

Importing this registers the environments `behavexplor/<functional scenario>-v0` with gymnasium, and nothing
else; the simulator is imported when an environment is made.
"""

import gymnasium

__version__ = "0.1.0"

NAMESPACE = "behavexplor"
FUNCTIONAL_SCENARIOS = {"intersection-straight": "behavexplor.envs.intersection_straight:IntersectionStraightEnv"}

for _name, _entry_point in FUNCTIONAL_SCENARIOS.items():
    _id = f"{NAMESPACE}/{_name}-v0"
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point=_entry_point)
