"""Gymnasium environments of the functional scenarios."""
