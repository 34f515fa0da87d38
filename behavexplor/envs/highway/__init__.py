"""Environments of highway-env whose concrete scenarios are their own random draws."""
