"""A planner of rules and search, with modules like those of a full driving system."""

from behavexplor.ads.rule.parameters import Parameters
from behavexplor.ads.rule.planner import RulePlanner

__all__ = ["Parameters", "RulePlanner"]
