"""elevation/monopulse."""
