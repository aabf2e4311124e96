"""Replays of a bag, through nodes or by calls, and how they differ from the recording. Read `bag_replay` first."""

from sal_height.renamed import names_of

__getattr__ = names_of(__name__, "sal_height.runs.replay.bag_replay")
