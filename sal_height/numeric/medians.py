"""Standard error of a median."""

from __future__ import annotations

import numpy as np

MEDIAN_ERROR = float(np.sqrt(np.pi / 2))
"""Standard error of a median of many normal numbers over that of their mean."""
