"""Search methods, which choose the scenarios to execute, and the tools that they share."""
