"""Judging a trace: requirements (specs), the violation event, whose fault it was, and its class."""
