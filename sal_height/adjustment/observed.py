"""How the errors of navigation and mounting move the surfaces of a dwell, and its Doppler centroid.

Errors are what is stated less what is true. With the antenna's position off by p, the body turned by e (about the axes
of map), the velocity along the line of sight u off by v u, and the beams turned on by j about the body, a surface at
the range R lies off by

    p + e x arm + A l - V d + c (w (e + S b) + j) - (R / |V|) f (v u - shake)

where A turns the body and S the sensor into map, l is the error of the lever arm, b that of the boresight (about the
axes of the sensor), d that of the odometry's delay, f the direction of flight, and c and w are those of
`relief.position_error`. If the image was put into the middle of the beams, the last term is R f (t (e + S b)) instead,
with t = u x f.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from sal_height.adjustment.drift import EXACT_M, STATE, Drift, Stated
from sal_height.adjustment.equations import Equation, Form, Solution
from sal_height.adjustment.matching import Points
from sal_height.adjustment.settings import AdjustmentSettings
from sal_height.geometry import ApertureState, Mounting, Trajectory, angles_of, sphere_point
from sal_height.imaging import Placement, Slc
from sal_height.numeric import F64, Index
from sal_height.relief import HeightField, position_jacobian, turn_jacobian
from sal_height.sensor import PhaseHistory, Sensor

BORESIGHT, LEVER_ARM, DELAY, PITCH, EDGES, COMMON = slice(0, 3), slice(3, 6), 6, 7, 8, 9
"""Among the unknowns that all dwells share."""

EXACT = np.array([1e-9] * 3 + [1e-5] * 3 + [1e-9, 1e-8, 1e-6])
"""Standard deviations of those that are exact."""

EDGES_SPACINGS = 0.3
"""Standard deviation of how much farther from the sensor edges are seen than they are, in spacings of pixels: where a
wall is in the same pixels as a roof, the roof begins later, and its last pixel reaches beyond it."""

OWN = 2
"""Unknowns of each dwell: its shift along the flight (m) and its angle off nadir (rad)."""


@dataclass(frozen=True, eq=False)
class ObservedDwell:
    """A height image, and what it was made with.

    Attributes:
        points: its surfaces.
        aperture: from which it is seen, as published.
        placement: where it lies other than odometry says.
        stated: what odometry states, of base_link, in the middle of the dwell.
        axis_middle: elevation of the middle of all beams, rad.
        look_side: +1 right, -1 left.
        ambiguity: velocity along the line of sight that pulses cannot tell from none, wavelength PRF / 2, m/s.
    """

    points: Points
    aperture: ApertureState
    placement: Placement
    stated: Stated
    axis_middle: float
    look_side: int
    ambiguity: float

    @classmethod
    def of(
        cls,
        field: HeightField,
        slc: Slc,
        sensor: Sensor,
        track: Trajectory,
        history: PhaseHistory,
        epoch_ns: int = 0,
    ) -> Self:
        """The heights of a dwell, with its images, its sensor, the track of base_link, and its pulses.

        Seconds count from the epoch.
        """
        begin_ns, times = history.stamp_ns, history.pulse_times
        stated = Stated(
            seconds=(begin_ns - epoch_ns) * 1e-9 + float(times.mean()),
            pose=track.aperture(begin_ns, times).covariance,
            velocity=track.velocity_covariance(begin_ns, times),
        )
        return cls(
            points=Points.of(field),
            aperture=slc.aperture,
            placement=slc.placement,
            stated=stated,
            axis_middle=sensor.beams.axis_middle,
            look_side=sensor.look_side,
            ambiguity=sensor.wavelength * sensor.pulse_repetition_frequency / 2,
        )

    @property
    def seconds(self) -> float:
        """Its middle in time, s."""
        return self.stated.seconds

    @cached_property
    def middle(self) -> F64:
        """Of its points, in map, m, shape (3,)."""
        return sphere_point(*self.points.middle)

    @cached_property
    def slant_range(self) -> float:
        """To their middle, m."""
        return float(np.linalg.norm(self.middle - self.aperture.position))

    @property
    def sight(self) -> F64:
        """Unit vector to their middle, in map."""
        return np.asarray((self.middle - self.aperture.position) / self.slant_range)

    @property
    def speed(self) -> float:
        """Of the flight, m/s."""
        return float(np.linalg.norm(self.aperture.velocity))

    @property
    def lever(self) -> float:
        """Shift along the flight by a velocity along the line of sight, m per m/s."""
        return self.slant_range / self.speed


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the unknowns are: the knots of navigation, what all dwells share, and each dwell's own."""

    drift: Drift
    dwells: int

    @property
    def common(self) -> Index:
        """Columns that all dwells share."""
        return STATE * len(self.drift.seconds) + np.arange(COMMON)

    def own(self, dwell: int) -> Index:
        """Columns of a dwell."""
        return STATE * len(self.drift.seconds) + COMMON + OWN * dwell + np.arange(OWN)

    @property
    def count(self) -> int:
        """Of all unknowns."""
        return STATE * len(self.drift.seconds) + COMMON + OWN * self.dwells


def displacement(number: int, dwell: ObservedDwell, layout: Layout, mounting: Mounting) -> Form:
    """How far east, north and up (m) the surfaces of a dwell lie off, at their middle.

    Args:
        number: of the dwell in the layout.
        dwell: the dwell.
        layout: of the unknowns.
        mounting: of the sensor, as described.
    """
    aperture, u, f = dwell.aperture, dwell.sight, dwell.aperture.direction
    climb = position_jacobian(dwell.middle, aperture)[:, 0]
    body = aperture.rotation @ mounting.axes.inv().as_matrix()
    arm = body @ np.array(mounting.lever_arm)

    by_turn = turn_jacobian(dwell.middle, aperture)  # of the sensor, about the axes of map
    by_velocity = -dwell.lever * np.outer(f, u)
    constant = -dwell.lever * dwell.placement.speed * f
    if dwell.placement.by_beams:
        by_turn += dwell.slant_range * np.outer(f, np.cross(u, f))
        by_velocity, constant = np.zeros((3, 3)), np.zeros(3)

    knot, since = layout.drift.knot_of(dwell.seconds)
    values = np.zeros((3, STATE + COMMON + OWN))
    values[:, :3] = np.eye(3)
    values[:, 3:6] = since * np.eye(3) + by_velocity
    values[:, 6:9] = by_turn - np.cross(np.eye(3), arm)
    shared = values[:, STATE : STATE + COMMON]
    shared[:, BORESIGHT] = by_turn @ aperture.rotation
    shared[:, LEVER_ARM] = body
    shared[:, DELAY] = -aperture.velocity
    _, elevation, _ = angles_of(dwell.middle, aperture, dwell.look_side)
    shared[:, PITCH] = -dwell.look_side * (float(elevation) - dwell.axis_middle) * climb
    values[:, -2], values[:, -1] = f, climb
    columns = np.concatenate([STATE * knot + np.arange(STATE), layout.common, layout.own(number)])
    return Form(columns, values, constant)


def seen(dwell: ObservedDwell, off: Form, layout: Layout) -> Form:
    """How far a dwell is seen to lie off by its edges, where it lies off by so much."""
    outwards = np.array([*dwell.sight[:2], 0.0]) / np.linalg.norm(dwell.sight[:2])
    columns = np.append(off.columns, layout.common[EDGES])
    return Form(columns, np.column_stack([off.values, outwards]), off.constant)


def centroid(number: int, dwell: ObservedDwell, layout: Layout, settings: AdjustmentSettings) -> Equation | None:
    """What the Doppler centroid of a dwell tells; None: it was not measured.

    It is off that of navigation by -v u + shake - |V| t (e + S b), with the shake of the dwell's own shift.
    """
    if (found := dwell.placement.centroid) is None:
        return None
    u, f = dwell.sight, dwell.aperture.direction
    ahead = -dwell.speed * np.cross(u, f)
    knot, _ = layout.drift.knot_of(dwell.seconds)
    columns = np.concatenate([STATE * knot + np.arange(3, 9), layout.common[BORESIGHT], layout.own(number)[:1]])
    values = np.concatenate([-u, ahead, ahead @ dwell.aperture.rotation, [1 / dwell.lever]])[None]
    variance = found.error**2 + (dwell.speed * settings.jitter_rad) ** 2
    return Equation(columns, values, np.array([found.speed]), np.array([[1 / variance]]))


def vibration_of(dwells: Sequence[ObservedDwell], joined: Iterable[range]) -> float:
    """Standard deviation of the velocity along the line of sight by vibration that odometry does not contain, m/s.

    That is the spread of the Doppler centroids of dwells that follow each other, whose navigation errs alike; they are
    angles on the circle of the ambiguity (Mardia and Jupp, Directional Statistics, section 2.3). At least what the
    curvature of their phases told.

    Args:
        dwells: all of them.
        joined: numbers of those that follow each other.
    """
    told = [dwell.placement.centroid.vibration for dwell in dwells if dwell.placement.centroid]
    if not told:
        return 0.0
    weight = resultant = 0.0
    for members in joined:
        found = [one.speed / dwells[n].ambiguity for n in members if (one := dwells[n].placement.centroid)]
        if (count := len(found)) > 1:
            mean = abs(np.mean(np.exp(2j * np.pi * np.array(found))))
            resultant += count * float(mean) ** 2 - 1  # (count - 1) times the square of the true one, on the average
            weight += count - 1
    length = np.clip(resultant / weight, 0.01, 1.0) if weight else 1.0
    spread = float(np.sqrt(-np.log(length))) * dwells[0].ambiguity / (2 * np.pi)
    return max(spread, float(np.sqrt(np.mean(np.square(told)))))


def own_priors(
    dwells: Sequence[ObservedDwell],
    layout: Layout,
    settings: AdjustmentSettings,
    vibration: float,
    solution: Solution | None = None,
) -> list[Equation]:
    """What is known beforehand of each dwell's own errors: of vibration and of the jitter of its beams.

    A velocity that is beyond the half of the ambiguity acts as if it were one ambiguity less.

    Args:
        dwells: all of them.
        layout: of the unknowns.
        settings: of the jitter.
        vibration: standard deviation of the velocity by vibration, m/s.
        solution: in which such dwells are looked for; None: there are none.
    """
    equations = []
    for number, dwell in enumerate(dwells):
        along, middle = max(dwell.lever * vibration, EXACT_M), 0.0
        if dwell.placement.by_beams:
            along = dwell.slant_range * settings.jitter_rad
        elif solution is not None:
            whole = dwell.lever * dwell.ambiguity
            middle = whole * float(np.rint(solution.unknowns[layout.own(number)[0]] / whole))
        information = np.diag([along**-2, settings.jitter_rad**-2])
        equations.append(Equation(layout.own(number), np.eye(OWN), np.array([middle, 0.0]), information))
    return equations


def stated_sigmas(settings: AdjustmentSettings) -> F64:
    """Standard deviations of what all dwells share, but for the edges, as they are known beforehand; 0: exact."""
    sigmas = np.empty(EDGES)
    sigmas[BORESIGHT], sigmas[LEVER_ARM] = settings.boresight_sigma_rad, settings.lever_arm_sigma_m
    sigmas[DELAY], sigmas[PITCH] = settings.odometry_delay_sigma_s, settings.pitch_sigma
    return sigmas


def common_prior(dwells: Sequence[ObservedDwell], layout: Layout, settings: AdjustmentSettings) -> Equation:
    """What is known beforehand of the mounting, the delay, the pitch of the beams, and the edges in images."""
    edges = EDGES_SPACINGS * max(dwell.points.spacing for dwell in dwells)
    sigmas = np.maximum(np.append(stated_sigmas(settings), edges), EXACT)
    return Equation(layout.common, np.eye(COMMON), np.zeros(COMMON), np.diag(sigmas**-2))
