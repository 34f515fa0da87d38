"""Policies trained with Stable-Baselines3 and sb3-contrib, read from their files without executing code from them.

`policy.load_policy` is the entry: `archive` reads the zip, `building` builds the network, `policy` drives.
"""
