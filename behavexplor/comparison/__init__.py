"""Comparison of two drivers on the same scenarios."""
