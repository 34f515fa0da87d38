"""The Python interface: campaigns on drivers in memory, runs as objects, and replays. Nothing is printed unasked.

Its names are attributes of the package itself, such as `behavexplor.find_failures`.
"""
