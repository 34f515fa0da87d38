"""Regression suites: scenarios in which a driver failed once, with what must hold in them."""
