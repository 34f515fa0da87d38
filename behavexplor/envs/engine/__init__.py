"""The compiled engine: roads, vehicles and what they do in a frame, for many episodes in lock-step.

It knows no task. What an episode begins with, what is rewarded and when it ends is in `behavexplor.envs.tasks`.
"""
