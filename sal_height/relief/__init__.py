"""relief."""
