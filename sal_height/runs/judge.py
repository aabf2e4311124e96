"""Moved to `sal_height.runs.replay.judge`; ends with the next release."""

from sal_height.renamed import names_of

__getattr__ = names_of(__name__, "sal_height.runs.replay.judge")
