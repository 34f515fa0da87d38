"""Triage of failures: reproducibility, classes, fault, causes, and ways to avoid collisions."""
