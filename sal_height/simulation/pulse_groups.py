"""Pulses in groups within which the range of every scatterer is linear in time, but for a function of range alone.

During a few milliseconds the antenna flies all but straight. With the range of a point in the middle of the scene taken
off, that of a scatterer changes linearly with time; what is left, the curvature, is nearly a function of range. So the
echoes of a group follow from two numbers per scatterer, range and range rate, by one non-uniform FFT over range
frequency and pulse (`echoes`). How long a group may be is measured at the outermost scatterers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from sal_height.numeric import F64, Index
from sal_height.sensor import Sensor

LEAST_MIGRATION, MOST_MIGRATION = 8e-4, 0.07
"""Phase (rad) of an outermost scatterer by range migration, at the ends of group and band, from which on it is
corrected, and up to which its first order suffices.

It grows linearly with time, frequency and squint, each counted from the middle, and beams weigh great squints least:
the rms is an eighth of the first, and a twentieth of the second order. So samples are off by less than 1e-4 of their
rms.
"""

BEAM_ERROR = 2e-4
"""Greatest error of interpolated beams, as a fraction of their peak; its mean is several times less."""


@dataclass(frozen=True, eq=False)
class PulseGroup:
    """Some pulses in a row, and the point whose range history is common to all scatterers.

    Attributes:
        pulses: numbers of the pulses in the dwell.
        antenna: position of the antenna at each, m, shape (pulses, 3).
        centre: position of the point, m, shape (3,).
        nodes: pulses of the group in which beams are evaluated, increasing.
        migrates: True if the change of range within the group must be separated from one of phase.
    """

    pulses: slice
    antenna: F64
    centre: F64
    nodes: Index
    migrates: bool = False

    @property
    def count(self) -> int:
        """Number of pulses."""
        return len(self.antenna)

    @cached_property
    def steps(self) -> F64:
        """Pulses from the middle of the group on, as an FFT counts them, shape (pulses,)."""
        return np.arange(self.count, dtype=np.float64) - self.count // 2

    @cached_property
    def common(self) -> F64:
        """Range of the centre, m, shape (pulses,)."""
        return np.asarray(np.linalg.norm(self.centre - self.antenna, axis=-1))

    @cached_property
    def ends(self) -> tuple[int, int]:
        """The two pulses through whose ranges the line goes: a parabola has there its best line, by least squares."""
        half, reach = (self.count - 1) / 2, self.count / np.sqrt(12)
        return round(half - reach), round(half + reach)

    def off_line(self, positions: F64) -> tuple[F64, F64, F64]:
        """Range (m) and range per pulse (m) of points (n, 3) on their lines, and the rest, m, shape (n, pulses)."""
        distance = np.linalg.norm(positions[:, None] - self.antenna, axis=-1) - self.common
        first, last = self.ends
        rate = (distance[:, last] - distance[:, first]) / max(1, last - first)
        start = distance[:, first] - rate * self.steps[first]
        return start, rate, distance - start[:, None] - rate[:, None] * self.steps

    def curvature(self, ranges: F64) -> F64:
        """Residual of the line, m, (n, pulses), at ranges (m, (n,)) beyond the centre on its line of sight."""
        middle = self.count // 2
        sight = (self.centre - self.antenna[middle]) / self.common[middle]
        return self.off_line(self.centre + ranges[:, None] * sight)[2]

    @cached_property
    def interpolation(self) -> F64:
        """Lagrange's polynomials of the nodes, shape (nodes, pulses)."""
        steps, nodes = np.arange(self.count), self.nodes
        others = [np.delete(nodes, k) for k in range(len(nodes))]
        return np.stack(
            [
                np.prod((steps[:, None] - other) / (node - other), axis=-1)
                for node, other in zip(nodes, others, strict=True)
            ]
        )


def pulse_groups(count: int, group_of: Callable[[slice], PulseGroup | None]) -> list[PulseGroup]:
    """All pulses in the groups with the least computation; empty if groups of eight are too long.

    Work is counted in the beams that scatterers are spread with; transforms of migrating ones take half as much again.

    Args:
        count: number of pulses.
        group_of: function that makes the group of some pulses, or None if its errors are too great (`smooth_group`).
    """
    best: list[PulseGroup] = []
    cost, parts = float("inf"), 1
    # Shortest group in which the FFT over pulses pays: it spreads a scatterer over TAPS bins, which replace the pulses.
    least_pulses = 8
    while count >= least_pulses * parts and parts < cost:
        edges = np.linspace(0, count, parts + 1).round().astype(int).tolist()
        found, work = list[PulseGroup](), 0.0
        for ends in pairwise(edges):
            group = group_of(slice(*ends))
            work += len(group.nodes) * (1.5 if group.migrates else 1) if group else float("inf")
            if group is None or work >= cost:
                break
            found.append(group)
        if len(found) == parts:
            best, cost = found, work
        parts = parts + 1 if parts < 4 else parts * 3 // 2
    return best


def outermost(positions: F64) -> F64:
    """The points of (3, n) that lie farthest along the axes and diagonals of the box around all, shape (m, 3)."""
    x, y, z = (row / max(np.ptp(row), 1e-9) for row in positions)
    directions = (x, y, z, x + y + z, x + y - z, x - y + z, y + z - x)
    extremes = [find(along) for along in directions for find in (np.argmin, np.argmax)]
    return positions[:, np.unique(extremes)].T


def single_pulse(probes: F64, antenna: F64, pulse: int) -> PulseGroup:
    """Return a group of one pulse, in which nothing is left out; arguments as of `smooth_group`."""
    pulses = slice(pulse, pulse + 1)
    return PulseGroup(pulses, antenna[pulses], _middle(probes, antenna[pulse]), np.zeros(1, dtype=np.intp))


def smooth_group(sensor: Sensor, probes: F64, antenna: F64, beam_angles: F64, pulses: slice) -> PulseGroup | None:
    """Return the group of some pulses; None if its errors would be greater than those of this module.

    Args:
        sensor: sensor with the frequencies.
        probes: positions of the outermost scatterers, m, shape (n, 3).
        antenna: position at each pulse of the dwell, m, shape (all pulses, 3).
        beam_angles: angles by which scatterers move in the beams in these pulses, beamwidths, shape (pulses, angles).
        pulses: numbers of the pulses.
    """
    nodes = _beam_nodes(beam_angles)
    if nodes is None:
        return None
    track = antenna[pulses]
    group = PulseGroup(pulses, track, _middle(probes, track[len(track) // 2]), nodes)
    start, rate, rest = group.off_line(probes)
    window = sensor.range_window
    left = rest - group.curvature(np.mod(start + window / 2, window) - window / 2)
    # In rad, for an outermost scatterer; the rms over scatterers is far below it.
    if sensor.centre_wavenumber * np.abs(left).max() > 3e-4:
        return None
    fastest = float(np.abs(rate).max())
    migration = fastest * group.count / 2 * sensor.wavenumber_step * sensor.sample_count / 2
    turn = fastest * sensor.centre_wavenumber / (2 * np.pi)
    # Phases of more than half a turn from pulse to pulse are ambiguous, and their range migration cannot be corrected.
    # At the edge of the main lobe, the 1 % has no weight.
    if migration > MOST_MIGRATION or (migration > LEAST_MIGRATION and turn > 0.505):
        return None
    return replace(group, migrates=migration > LEAST_MIGRATION)


def _middle(points: F64, seen_from: F64) -> F64:
    """The point half way between the least and the greatest range of points (n, 3), on a line of sight amidst them."""
    ranges = np.linalg.norm(points - seen_from, axis=-1)
    sight = (np.min(points, axis=0) + np.max(points, axis=0)) / 2 - seen_from
    return np.asarray(seen_from + sight * ((np.min(ranges) + np.max(ranges)) / 2 / np.linalg.norm(sight)))


def _beam_nodes(angles: F64) -> Index | None:
    """The fewest pulses from which beams that move by `angles` (beamwidths, (pulses, angles)) are interpolated.

    The amplitude of a beam is the spectrum of an aperture as wide as a wavelength over a beamwidth. By Bernstein its
    derivative of order n is at most pi^n of its peak, and interpolation between n of Chebyshev's nodes, over a motion
    of d to each side, is off by at most 2 (pi d / 2)^n / n!.
    """
    count = len(angles)
    reach = float(np.max(np.ptp(angles, axis=0), initial=0.0)) / 2
    bound = 2.0
    for number in range(1, min(6, count) + 1):
        bound *= np.pi * reach / 2 / number
        nodes = np.rint((1 - np.cos(np.pi * (np.arange(number) + 0.5) / number)) / 2 * count - 0.5).astype(np.intp)
        if bound <= BEAM_ERROR and _are_smooth(angles, nodes):
            return nodes
    return None


def _are_smooth(angles: F64, nodes: Index) -> bool:
    """True if a polynomial through the nodes, of degree 1 or more, gives all angles within the error of beams."""
    if len(nodes) < 2:
        return True
    group = PulseGroup(slice(0), np.zeros((len(angles), 3)), np.zeros(3), nodes)
    off = angles - group.interpolation.T @ angles[nodes]
    return bool(np.abs(off).max(initial=0.0) <= BEAM_ERROR / np.pi)
