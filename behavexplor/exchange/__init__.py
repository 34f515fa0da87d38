"""Scenes for other tools: roads as OpenDRIVE, scenes as OpenSCENARIO XML, and traces as CSV."""
