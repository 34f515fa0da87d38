"""highway-env's own environments and their reactive traffic, compiled, many episodes in lock-step.

`vector_env` makes a vector environment of a class of highway-env, or of a subclass with another road or other starts.
"""

from behavexplor.envs.stock.registered import vector_env
from behavexplor.envs.stock.stock_env import StockVectorEnv

__all__ = ["StockVectorEnv", "vector_env"]
