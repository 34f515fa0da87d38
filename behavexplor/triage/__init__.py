"""What the failures of a campaign are: their classes and causes, whose fault they were, how to avoid them."""
