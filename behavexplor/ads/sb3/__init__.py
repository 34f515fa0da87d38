"""Policies trained with Stable-Baselines3 and sb3-contrib, read from their files without executing code from them."""
