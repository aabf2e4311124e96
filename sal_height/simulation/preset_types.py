"""Types of the values that presets may have."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from sal_height.configuration import Float

Decibels = Annotated[Float, Ge(-60), Le(60)]
Angle = Annotated[Float, Ge(-np.pi), Le(np.pi)]
