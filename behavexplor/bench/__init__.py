"""Experiments: comparisons of search methods over environments, driving systems and seeds, with tables of results."""
