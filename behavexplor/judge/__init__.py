"""Judging of traces: requirements (specs), violation events, fault of collisions, and classes of violations."""
