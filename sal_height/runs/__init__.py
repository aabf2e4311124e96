"""Whole runs of the graph: simulate, replay, import; what they leave behind."""
