"""The road as compiled arrays that drivers use: lanes, the ego's path, and steering along it."""
