"""Execution: an ADS drives scenarios in an environment, in this process, in worker processes or on a cluster."""
