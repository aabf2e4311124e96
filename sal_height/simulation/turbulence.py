"""Phase by the turbulence of the air on the path to the scene and back, the same in all detectors.

Air of the structure constant C_n^2(h) gives a spherical wave between two points, of which one moves by x and the other
stays, phases whose difference has the variance (Tatarskii; Goodman, Statistical Optics, chapter 8)

    D(x) = 2.914 k^2 x^(5/3) integral over the path of C_n^2 (1 - s / R)^(5/3) ds

with s from the end that moves. Echoes pass the same air twice within a millisecond, so that phases double and D is four
times greater. C_n^2(h) is the model of Hufnagel and Valley: ground, troposphere, and the wind of the tropopause. The
air stands still while the platform passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.integrate
import scipy.special
from annotated_types import Ge, Le

from sal_height.configuration import Float, StrictKeys
from sal_height.numeric import F64
from sal_height.simulation.harmonics import Harmonics

LINES = 400


@dataclass(frozen=True)
class Turbulence(StrictKeys):
    """The air below and around the platform.

    Attributes:
        ground_cn2: structure constant C_n^2 at the ground, m^(-2/3): 1.7e-14 on a usual day, 0 is calm.
        wind_mps: rms wind at 5 to 20 km; 21 is usual.
    """

    ground_cn2: Annotated[Float, Ge(0), Le(1e-11)]
    wind_mps: Annotated[Float, Ge(0), Le(100)] = 21.0

    def cn2(self, height: F64) -> F64:
        """C_n^2 (m^(-2/3)) at heights above the ground (m)."""
        tropopause = 0.00594 * (self.wind_mps / 27) ** 2 * (1e-5 * height) ** 10 * np.exp(-height / 1000)
        return np.asarray(tropopause + 2.7e-16 * np.exp(-height / 1500) + self.ground_cn2 * np.exp(-height / 100))

    def structure(self, wavelength: float, slant_range: float, height: float) -> float:
        """Factor of x^(5/3) in the structure function D (rad^2) of echoes, for an antenna at a height (m)."""
        share = np.linspace(0.0, 1.0, 2001)
        way = self.cn2(height * (1 - share)) * (1 - share) ** (5 / 3)
        integral = slant_range * float(scipy.integrate.simpson(way, x=share))
        return 4 * 2.914 * (2 * np.pi / wavelength) ** 2 * integral

    def drawn(self, structure: float, speed: float, rng: np.random.Generator) -> Harmonics:
        """Phases of this structure function along a flight, as the displacement (rad) of harmonics over time.

        The spectrum a w^(-8/3) over the angular wavenumber w has the structure function
        -2 a Gamma(-5/3) cos(5 pi / 6) x^(5/3).
        """
        # Lengths of the waves, m. Waves longer than L add (x / L)^(1/3) to the structure function: there is no outer
        # scale, beyond which real air has less.
        edges = 2 * np.pi / np.geomspace(1e10, 1e-3, LINES + 1)
        level = structure / (-2 * scipy.special.gamma(-5 / 3) * np.cos(5 * np.pi / 6))
        power = level * 3 / 5 * (edges[:-1] ** (-5 / 3) - edges[1:] ** (-5 / 3))
        omega = speed * np.sqrt(edges[1:] * edges[:-1])
        return Harmonics(omega, (omega * np.sqrt(2 * power))[:, None], rng.uniform(0, 2 * np.pi, (LINES, 1)))
