"""The functional scenarios as gymnasium environments."""
