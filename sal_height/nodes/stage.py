"""Moved to `sal_height.nodes.transport.qos`; ends with the next release."""

from sal_height.renamed import names_of

__getattr__ = names_of(__name__, "sal_height.nodes.transport.qos")
