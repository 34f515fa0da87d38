"""Driving systems under test."""
