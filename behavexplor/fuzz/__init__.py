"""Search: the methods that choose which scenarios to execute, and the tools they share."""
