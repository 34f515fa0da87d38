"""Experiments: search methods compared over environments, driving systems and seeds, and the tables that come of it."""
