"""Behavior of the ego: features of a trace, abstract traces, and the distance between them."""
