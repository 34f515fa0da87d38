"""The road as arrays for compiled drivers: lanes, the ego's path, and steering along it."""
