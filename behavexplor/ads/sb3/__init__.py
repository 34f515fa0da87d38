"""Policies trained with Stable-Baselines3 and sb3-contrib, read from their files without running what these contain."""
