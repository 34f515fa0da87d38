"""Driving policies trained with this package: their observations, their actions and their training."""
