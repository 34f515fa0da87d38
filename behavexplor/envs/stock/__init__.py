"""highway-env's own environments and their reactive traffic, compiled, many episodes in lock-step."""
