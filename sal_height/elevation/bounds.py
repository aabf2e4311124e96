"""Moved to `sal_height.elevation.array.bounds`; ends with the next release."""

from sal_height.renamed import names_of

__getattr__ = names_of(__name__, "sal_height.elevation.array.bounds")
