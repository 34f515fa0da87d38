"""The environments of another package, which declares this module as an entry point."""

import gymnasium

gymnasium.register("declared/lane-change-v0", entry_point="behavexplor.envs.functional:LaneChangeEnv")
