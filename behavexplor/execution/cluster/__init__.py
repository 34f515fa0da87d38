"""Campaigns on a cluster, of Ray or of Dask: supervised workers on each of its nodes, as on one machine."""
