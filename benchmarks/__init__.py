"""Benchmarks of speed, as ratios to plain highway-env."""
