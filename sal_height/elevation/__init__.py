"""elevation."""
