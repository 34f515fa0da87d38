"""The values that cross every boundary: scenarios, road maps and traces, with the geometry they share."""
