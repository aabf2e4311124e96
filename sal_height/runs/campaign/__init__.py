"""Many bags with many variants of parameters."""
