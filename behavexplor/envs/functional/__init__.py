"""The functional scenarios: each file is one, its name that of the scenario.

A new one is a new file with a subclass of `behavexplor.envs.driving.DrivingEnv` named after it: `lane_follow.py`
holds `LaneFollowEnv`, and its vector environment `LaneFollowVectorEnv`, and is registered as
`behavexplor/lane-follow-v0`.
"""
