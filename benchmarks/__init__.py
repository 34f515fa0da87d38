"""How fast everything is, as ratios to plain highway-env."""
