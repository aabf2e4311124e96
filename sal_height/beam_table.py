"""Measured beams: a table of complex amplitudes over angles, for one detector each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError

LEAST_NODES = 4
"""Of a cubic spline."""


@dataclass(frozen=True)
class BeamTable:
    """What a detector's beam was measured to be; the same content as sal_height_msgs/BeamTable.

    Attributes:
        elevation: offsets from the detector's boresight along the detector axis, rad, increasing.
        azimuth: offsets beside it, rad, increasing; a single one: the beam is taken to depend on elevation only.
        real: of the amplitude at every elevation and, within it, every azimuth. The unit is that of all detectors of
            the sensor, which are compared with each other; their greatest modulus near 1 keeps CNRs what they mean.
        imaginary: as `real`.

    Raises:
        UserError: too few or no increasing angles, values that are not finite, of another number, or all zero.
    """

    elevation: tuple[float, ...]
    azimuth: tuple[float, ...]
    real: tuple[float, ...]
    imaginary: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("elevation", "azimuth"):
            angles = np.array(getattr(self, name), dtype=np.float64)
            few = angles.size < LEAST_NODES and not (name == "azimuth" and angles.size == 1)
            if few or not (np.all(np.isfinite(angles)) and np.all(np.diff(angles) > 0)):
                raise UserError(
                    f"A beam table has {angles.size} offsets in {name}; they must be {LEAST_NODES} or more"
                    f"{' (or one in azimuth)' if name == 'azimuth' else ''}, finite and increasing."
                )
        size = len(self.elevation) * len(self.azimuth)
        if not len(self.real) == len(self.imaginary) == size:
            raise UserError(
                f"A beam table has {len(self.real)} real and {len(self.imaginary)} imaginary parts; its "
                f"{len(self.elevation)} x {len(self.azimuth)} angles need {size} each."
            )
        values = self.values
        if not np.all(np.isfinite(values)) or not np.any(values):
            raise UserError("A beam table has amplitudes that are not finite, or all zero; all must be finite.")

    @property
    def values(self) -> npt.NDArray[np.complex128]:
        """Amplitudes, shape (elevations, azimuths)."""
        flat = np.array(self.real, dtype=np.float64) + 1j * np.array(self.imaginary, dtype=np.float64)
        return flat.reshape(len(self.elevation), len(self.azimuth))
