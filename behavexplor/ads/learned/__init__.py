"""Driving policies that are learned here: what they see, what they command, and how they are trained."""
