"""Link budget: mean power for a carrier-to-noise ratio, and the reverse; gain and slope of the relief paper's radar.

It applies to radar and to coherent lidar: both receive the echo of a resolution cell in one mode of the antenna,
sum it coherently over the aperture, and compare its energy with the energy of the noise in one mode (Skolnik,
Introduction to Radar Systems, 3rd ed., chapter 1, written with mean power and coherent time).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.constants import Boltzmann, Planck, speed_of_light

from sal_height.beams import Pattern
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

FARTHEST_BEAMWIDTHS, STEP_BEAMWIDTHS = 40.0, 0.1
"""Part of a pattern over which its power is summed, to each side, and the steps: of that of a circular aperture 0.4 %
lie outside."""


@dataclass(frozen=True)
class Link:
    """A transmitter that illuminates a solid angle evenly, a resolution cell in it, and a receiver.

    Attributes:
        slant_range: slant range of the cell, m.
        lit_angle: illuminated solid angle, sr.
        cell_area: area of a resolution cell on the ground, m^2.
        backscatter: radar cross-section per area of ground, sigma0.
        effective_area: effective area of the receive antenna for a target straight ahead, m^2.
        coherent_time: time for which a cell is illuminated and received in an aperture, s.
        noise: `noise_density` of the receiver, W/Hz.
        loss: loss of power in transmitter, air and receiver together, power ratio of 1 or more.
    """

    slant_range: float
    lit_angle: float
    cell_area: float
    backscatter: float
    effective_area: float
    coherent_time: float
    noise: float
    loss: float = 1.0

    @property
    def cnr_per_watt(self) -> float:
        """Carrier-to-noise ratio of an unweighted pixel, for each watt of mean power.

        A watt has the density 1 / (lit_angle R^2) at the cell, which returns sigma0 area / (4 pi R^2) of it.
        """
        density = 1 / (self.lit_angle * self.slant_range**2)
        returned = density * self.backscatter * self.cell_area / (4 * np.pi * self.slant_range**2)
        return float(returned * self.effective_area * self.coherent_time / (self.noise * self.loss))


def noise_density(wavelength: float, noise_figure: float = 1.0) -> float:
    """Noise power in a hertz of a receiver, W/Hz: F h f / (1 - exp(-h f / k T)).

    A perfect receiver of one mode (F = 1) has k T at radio frequencies, where T is 290 K, and h f in light: its shot
    noise (Caves, Physical Review D 26, 1982).

    Args:
        wavelength: wavelength of the carrier, m.
        noise_figure: F, noise over that of a perfect receiver; of a lidar, one over the efficiency of detection.
    """
    photon = Planck * speed_of_light / wavelength
    return float(noise_figure * photon / -np.expm1(-photon / (Boltzmann * 290.0)))


def diffuse_backscatter(albedo: float, incidence: float) -> float:
    """Radar cross-section per area of a Lambertian surface: 4 rho cos^2 of the angle of incidence (rad)."""
    return float(4 * albedo * np.cos(incidence) ** 2)


def effective_area(pattern: Pattern, elevation_diameter: float, azimuth_diameter: float) -> float:
    """Effective area (m^2) of an antenna, from its pattern: wavelength^2 over the solid angle of the beam.

    Within 1 %: sidelobes more than FARTHEST_BEAMWIDTHS off are left out.

    Args:
        pattern: pattern of the antenna, whose power straight ahead counts as 1, over beamwidths.
        elevation_diameter: diameter along the first axis of the pattern, m.
        azimuth_diameter: diameter along the second axis, m.
    """
    nodes = np.arange(-FARTHEST_BEAMWIDTHS, FARTHEST_BEAMWIDTHS, STEP_BEAMWIDTHS) + STEP_BEAMWIDTHS / 2
    known = nodes[(nodes >= pattern.domain[0]) & (nodes <= pattern.domain[1])]
    power = np.nan_to_num(np.abs(pattern.amplitude(known[:, None], nodes)) ** 2)
    solid_angle = power.sum() * STEP_BEAMWIDTHS**2 / np.abs(pattern.amplitude(np.zeros(()), np.zeros(()))) ** 2
    return float(elevation_diameter * azimuth_diameter / solid_angle)


def hybrid_gain(coupling: npt.ArrayLike, loss: npt.ArrayLike) -> F64:
    """Return the gain in signal-to-noise power ratio of a hybrid before the receivers over sums after them: 2 c^2 / L.

    The hybrid forms c (upper + lower) / sqrt(L) and c (upper - lower) / sqrt(L), and the same receivers follow. With
    c = 1 / sqrt(2) and no loss it is unitary and gains nothing: it rotates the two channels, which leaves equal
    independent noise unchanged. The gain of 2 that the relief paper's eq. 3 implies (c = 1) would need twice the power
    that the two beams deliver.

    Args:
        coupling: c, amplitude ratio.
        loss: L, power ratio, 1 or more.
    """
    return 2 * np.asarray(coupling) ** 2 / np.asarray(loss)


def synthesise(pulses: C128, phase: F64) -> C128:
    """Sum pulses (the last axis) coherently, after removing the `phase` (rad) that the flight gave to each.

    The sum is linear and the same for every channel, so that sum and difference may be formed before or after it. The
    estimate of gamma is not linear and must come last.
    """
    return np.sum(pulses * np.exp(-1j * phase), axis=-1)


def crossover_slope(pattern: Pattern, separation: float, beamwidth: float) -> float:
    """Return the slope g = -G'(delta/2) / G(delta/2) of gamma in the equisignal direction, 1/rad (relief paper, eq. 4).

    Args:
        pattern: G of both beams, even in elevation.
        separation: delta between the two beams' axes, rad.
        beamwidth: wavelength / aperture diameter, rad.

    Raises:
        UserError: the beams do not overlap in that direction, or gamma does not rise.
    """
    half = separation / 2 / beamwidth
    amplitude, slope = np.asarray(pattern.amplitude(half, 0.0)).item(), np.asarray(pattern.slope(half, 0.0)).item()
    steepness = float(np.real(-slope / amplitude)) / beamwidth if amplitude else np.nan
    if not (np.isfinite(steepness) and steepness > 0):
        raise UserError(
            f"Beams {separation:.6g} rad apart have the discriminator slope {steepness:.6g} /rad half way between "
            "them; it must be finite and greater than 0."
        )
    return steepness
