"""Execution on a cluster of Ray or Dask: each node has a supervised worker, as on a single machine."""
