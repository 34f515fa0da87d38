"""Campaigns: the loop of ask, execute, judge, tell and store, with a run folder from which it can be resumed."""
