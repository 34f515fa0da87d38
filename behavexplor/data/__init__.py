"""Data types shared by all parts of the package: scenarios, road maps and traces, with their geometry."""
