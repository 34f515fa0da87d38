"""The functional scenarios, one per file. Each file is named after its scenario.

To add a scenario, add a file with a subclass of `behavexplor.envs.driving.DrivingEnv` that is named after it. For
example, `lane_follow.py` holds `LaneFollowEnv` and its vector environment `LaneFollowVectorEnv`, and is registered as
`behavexplor/lane-follow-v0`. Its class states the logical scenario. If that is one of
`behavexplor.envs.logical_scenarios`, campaigns know it without importing the simulator, and begin a second earlier.
"""
