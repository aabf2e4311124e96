"""Replays of a bag, through nodes or by calls, and how they differ from the recording."""
