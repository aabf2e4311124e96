"""Autofocus of a strip: the phase error of the pulses of a block, which joins on to those of the pulses before.

In stripmap the beam moves along with the antenna. Relative to the ground abeam of each pulse, speckle has the same
covariance between two pulses of a strip as between two at the same distance in a dwell; so a window of pulses is
linked as a dwell is (`phase_linking`), from the responses abeam. A window contains pulses that were linked before; the
phase of the new ones continues that of the last of those. Its trend is determined by the middle of the beam. So the
phase of a strip is known but for a constant; uneven ground moves the trend of each window a little, and blurs images
along the flight, by centimetres in lidar.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.imaging.autofocus.coherence import Coherence, beam_coherence
from sal_height.imaging.autofocus.gradient import AutofocusSettings, Focus, cell_responses
from sal_height.imaging.autofocus.phase_error import phase_gradient
from sal_height.imaging.autofocus.phase_linking import (
    Likelihood,
    find_trend,
    link_phases,
    signal_modes,
    speckle_classes,
    which_fit,
)
from sal_height.numeric import C64, F64, Complex
from sal_height.sensor import PhaseHistory, Sensor, aperture_length

WINDOW = 256  # pulses that are linked at a time, if available: more take more memory for little information
OVERLAP = 32  # of them at least that have been linked before


def stays_in_range_cell(sensor: Sensor, slant_range: float) -> bool:
    """True if pulses of a strip can be linked: their noise is known, and lit ground abeam stays in a range cell."""
    curvature = aperture_length(sensor, slant_range) ** 2 / (8 * slant_range)
    return curvature <= sensor.range_resolution / 2 and min(sensor.noise_power) > 0


def link_block(
    history: PhaseHistory,
    antenna: F64,
    before: tuple[PhaseHistory, F64] | None,
    sight: F64,
    direction: F64,
    sensor: Sensor,
    settings: AutofocusSettings,
) -> Focus:
    """Estimate the phase error of a block, all of it, and decide if it is to be trusted.

    `standard_error` is that of the phase from one pulse to the next where it is known worst, in OVERLAP pulses, and
    `trend_error` that of the trend of a window.

    Args:
        history: phase history of all detectors in a block.
        antenna: position at each of its pulses, m, shape (pulses, 3).
        before: earlier pulses of the strip without their phase errors, and the antenna at these; None: no such pulses.
        sight: unit vector in the middle of the beams, by prior knowledge, map axes.
        direction: unit vector of flight.
        sensor: wavelength, frequencies, beams and noise power.
        settings: criteria for trust.
    """
    line = _Line(antenna.mean(axis=0), float(history.reference_range[0]) * sight, direction)
    responses = line.responses(history, antenna, sensor)
    new_ones = len(antenna)
    if before:
        kept = slice(-max(OVERLAP, WINDOW - new_ones), None)
        earlier = line.responses(before[0].pulses(kept), before[1][kept], sensor)
        responses, antenna = np.concatenate([earlier, responses], axis=-1), np.concatenate([before[1][kept], antenna])
    phase, errors = np.zeros(len(antenna)), []
    for new in np.array_split(np.arange(len(antenna) - new_ones, len(antenna)), -(-new_ones // WINDOW)):
        first, end = int(new[0]), int(new[-1]) + 1
        start = max(0, min(first - OVERLAP, end - WINDOW))
        seen = responses[..., start:end] * np.exp(-1j * phase[start:end]).astype(responses.dtype)
        modes, snr = signal_modes(seen, sensor.sample_count * sensor.noise_covariance)
        if not len(modes):
            return Focus(np.zeros(new_ones), np.inf)
        coherence = beam_coherence(sensor, antenna[start:end])
        fits = which_fit(modes, snr, coherence)
        modes = modes[fits]
        found, trend_error = _link(modes, snr[fits], coherence)
        phase[first:end] = found[first - start :] - (found[first - start - 1] if first > start else 0.0)
        known = modes * np.exp(-1j * found).astype(modes.dtype)
        errors.append((_step_error(known[:, max(0, first - start - 1) :]), trend_error))
    step_error = float(np.max([error for error, _ in errors]))
    trend_error = float(np.sqrt(np.mean([error**2 for _, error in errors])))
    trusted = step_error <= settings.autofocus_max_error_rad
    return Focus(phase[-new_ones:], step_error, trusted, trend_error=trend_error)


@dataclass(frozen=True, eq=False)
class _Line:
    """The ground in the middle of the beams: a line along the flight.

    Attributes:
        middle: position of the antenna, from which the line is `reach` away, m, shape (3,).
        reach: vector from the antenna to the middle of the beams, m, shape (3,).
        along: unit vector of the line.
    """

    middle: F64
    reach: F64
    along: F64

    def responses(self, history: PhaseHistory, antenna: F64, sensor: Sensor) -> C64:
        """Contribution of each pulse to the range cells of the line, in the middle of the beams.

        Shape (detectors, cells, pulses). The phase of ground at rest does not turn from pulse to pulse, for any squint
        of the beams.
        """
        way = (antenna - self.middle) @ self.along
        found = cell_responses(history, antenna, sensor, self.middle + self.reach + way[:, None] * self.along)
        ahead = float(self.reach @ self.along) / float(np.linalg.norm(self.reach))
        found *= np.exp(-1j * sensor.centre_wavenumber * ahead * way).astype(found.dtype)
        return found


def _link(modes: Complex, snr: F64, coherence: Coherence) -> tuple[F64, float]:
    """The phase of a window but for a constant, and the standard error of its trend, rad."""
    likelihood = Likelihood.of(speckle_classes(modes, snr), coherence)
    phase = link_phases(likelihood, phase_gradient(modes))
    trend, trend_error = find_trend(modes, snr, coherence, likelihood, phase)
    return phase + trend * np.arange(len(phase)), trend_error


def _step_error(modes: Complex) -> float:
    """Greatest standard error of the phase from one pulse to the next in OVERLAP pulses, rad.

    That is sqrt((1 - c^2) / (2 n c^2)) for n responses of the coherence c (Rodriguez & Martin, IEE Proc. F 139, 1992).
    """
    power: F64 = np.sum(np.abs(modes) ** 2, axis=0)
    product: Complex = np.sum(modes[:, :-1].conj() * modes[:, 1:], axis=0)
    together = np.abs(product) ** 2 / np.maximum(power[:-1] * power[1:], 1e-300)
    pieces = np.arange(0, max(1, len(together) - OVERLAP + 1), OVERLAP)
    coherence = np.add.reduceat(together, pieces) / np.diff(np.append(pieces, len(together)))
    least = float(np.clip(coherence.min(), 1e-6, 1.0))
    return float(np.sqrt((1 - least) / (2 * len(modes) * least)))
