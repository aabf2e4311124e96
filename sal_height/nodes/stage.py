"""Former place of the qualities of service; `sal_height.nodes.transport.quality` has them."""

from __future__ import annotations

import warnings

from sal_height.nodes.transport.quality import FRAMES_QOS, INSTRUMENT_QOS, LATCHED_KEPT, LATCHED_QOS, ODOMETRY_QOS

__all__ = ["FRAMES_QOS", "INSTRUMENT_QOS", "LATCHED_KEPT", "LATCHED_QOS", "ODOMETRY_QOS"]

warnings.warn(
    "sal_height.nodes.stage will be removed; import qualities of service from sal_height.nodes.transport.quality.",
    DeprecationWarning,
    stacklevel=2,
)
