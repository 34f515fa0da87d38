"""A module that cannot be imported."""

ADS = 1 / 0
