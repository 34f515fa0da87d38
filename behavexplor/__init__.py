"""BehAVExplor: behaviour-diversity guided testing of autonomous driving systems, on highway-env."""
