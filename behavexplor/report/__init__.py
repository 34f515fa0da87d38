"""The report: one HTML page, made from run folders alone, that loads nothing."""
