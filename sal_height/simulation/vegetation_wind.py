"""Wind moves vegetation: each scatterer has its own velocity along the line of sight during a dwell.

Of the power, a fraction is at rest; the rest has Doppler velocities whose spectrum falls as exp(-beta |v|), as has been
measured from VHF to X-band over three decades of power and more (Billingsley, Low-Angle Radar Land Clutter, 2002,
chapter 6). Its rms velocity is sqrt(2) / beta. The fraction at rest is r / (1 + r) with r = 489.8 w^-1.55 f^-1.21, for
a wind of w miles per hour and a frequency of f GHz.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from sal_height.configuration import Float, StrictKeys
from sal_height.numeric import F64


@dataclass(frozen=True)
class VegetationWind(StrictKeys):
    """Motion of vegetation.

    Attributes:
        rms_velocity_mps: rms velocity of the moving part along the line of sight, m/s: 0.12 in light air, 0.18 in a
            breeze, 0.25 in wind, 0.33 in a gale (beta 12, 8, 5.7 and 4.3 s/m).
        still_share: fraction of the power at rest; the higher the frequency, the less: at 10 GHz in 10 miles per hour
            0.46, for light 0.
    """

    rms_velocity_mps: Annotated[Float, Gt(0), Le(10)]
    still_share: Annotated[Float, Ge(0), Le(1)] = 0.0

    def drawn(self, count: int, rng: np.random.Generator) -> F64:
        """Velocities (m/s) of scatterers, away from the sensor."""
        moving = rng.uniform(size=count) >= self.still_share
        return rng.laplace(scale=self.rms_velocity_mps / np.sqrt(2), size=count) * moving
