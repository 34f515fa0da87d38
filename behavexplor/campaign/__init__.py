"""Campaigns: ask, execute, judge, tell and store, in a run folder that can be resumed."""
