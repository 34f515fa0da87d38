"""From failures to a better driver: regression suites, paired comparison, and retraining."""
