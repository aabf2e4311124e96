"""Displacement of the surfaces of a dwell, and of its Doppler centroid, by errors of navigation and mounting.

Errors are stated less true values. With an error p of the antenna's position, a rotation e of the body (about the axes
of map), an error v u of the velocity along the line of sight u, and a further rotation j of the beams about the body, a
surface at the range R is displaced by

    p + e x arm + A l - V d + c (w (e + S b) + j) - (R / |V|) g (v u - shake)

where A turns the body and S the sensor into map, l is the error of the lever arm, b that of the boresight (about the
axes of the sensor), d that of the odometry's delay, g the shift of a surface per metre along the flight
(`geometry.shift_along`), and c and w are those of `relief.position_error`. If the image was located by the middle of
the beams, the last term is R g (t (e + S b) + q) instead: t = u x f with the direction of flight f, and q is the
assumed pointing of the beams ahead less that of the attitude.

An image of a strip is seen from the point where the antenna was abeam of its middle. Where nothing was removed from the
phase of its pulses, it is displaced as a dwell is. Autofocus removes all of the phase but that of the beams' pointing,
as measured in the first block (`imaging.strip_focus`): all images are in the middle of the beams then, with one q, and
no velocity moves them. The Doppler centroid of the first block is in q, and gives no more information on positions.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.drift import EXACT_M, STATE, Drift, Knot, PulseTrack, Stated
from sal_height.adjustment.equations import Equation, Form, Solution
from sal_height.adjustment.matching import LEAST_POINTS, Points
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Mounting, Trajectory, angles_of, shift_along, sphere_point
from sal_height.imaging import Placement, Slc
from sal_height.numeric import F64, Index, ShortRepr
from sal_height.relief import HeightField, position_jacobian, turn_jacobian
from sal_height.sensor import PhaseHistory, Sensor

BORESIGHT, LEVER_ARM, DELAY, PITCH, EDGES, GROUND, COMMON = slice(0, 3), slice(3, 6), 6, 7, 8, slice(9, 12), 12
"""Columns of the unknowns that all dwells have in common; EDGES is the apparent shift of edges (`by_edges`), and GROUND
the constant offset of the elevation model, east, north and up."""

OWN = 2
"""Number of unknowns of each dwell: its shift along the flight (m) and its angle off nadir (rad)."""

PLACE, TURN, STRETCH, POSE = slice(0, 3), slice(3, 6), 6, 7
"""Errors of the pose from which a dwell is seen: position of the antenna (m, map), rotation of the sensor (rad, about
the axes of map), and relative error of the angles between its beams."""


def placement_in_strip(placement: Placement, *, phase_removed: bool) -> Placement:
    """The placement of an image of a strip.

    Args:
        placement: placement of the strip by its first block.
        phase_removed: True if autofocus has removed the phase error of the block that completed the image.

    Raises:
        Rejected: it was removed in some blocks of the strip only, so that these are located by the beams and others
            are not.
    """
    by_beams = placement.centroid is not None or placement.by_beams
    if by_beams != phase_removed:
        raise Rejected(
            "autofocus",
            "Autofocus trusts the phase of some blocks of a strip and not of others, so that nothing says where its "
            "images lie; set autofocus to auto.",
        )
    return replace(placement, centroid=None, by_beams=by_beams)


@dataclass(frozen=True, eq=False)
class ObservedDwell(ShortRepr):
    """A height image, and the geometry that it was made with.

    Attributes:
        points: surfaces of the dwell.
        aperture: aperture from which it is seen, as published.
        placement: offset of the image from odometry; of an image of a strip as of `placement_in_strip`.
        stated: errors of base_link that odometry states, in the middle of the dwell, or abeam of that of the image.
        axis_middle: elevation of the middle of all beams, rad.
        look_side: +1 right, -1 left.
        ambiguity: ambiguity of the velocity along the line of sight, wavelength PRF / 2, m/s.
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
        """Observes a dwell by its heights, with its images, its sensor, the track of base_link, and its pulses.

        Of a strip the heights of an image, and the pulses of the block that completed it. Seconds count from the epoch.

        Raises:
            Rejected: it has too few points, or its placement is undetermined.
        """
        pulses, aperture = PulseTrack(track, history.stamp_ns, history.pulse_times, epoch_ns), slc.aperture
        if not aperture.sliding:
            return cls.seen_from(aperture, field, slc.placement, pulses.stated, sensor)
        placement = placement_in_strip(slc.placement, phase_removed=slc.autofocus_phase.size > 0)
        return cls.seen_from(aperture, field, placement, pulses.stated_abeam(aperture, sensor.mounting), sensor)

    @classmethod
    def seen_from(
        cls, aperture: ApertureState, field: HeightField, placement: Placement, stated: Stated, sensor: Sensor
    ) -> Self:
        """Observes a dwell by its heights, given the geometry that they were made with.

        Raises:
            Rejected: it has too few points.
        """
        points = Points.of(field)
        if (count := len(points.place)) < LEAST_POINTS:
            raise Rejected("few heights", f"A dwell has {count} heights; {LEAST_POINTS} are needed to compare it.")
        return cls(
            points=points,
            aperture=aperture,
            placement=placement,
            stated=stated,
            axis_middle=sensor.beams.axis_middle,
            look_side=sensor.look_side,
            ambiguity=sensor.wavelength * sensor.pulse_repetition_frequency / 2,
        )

    @property
    def jacobian(self) -> F64:
        """Derivative of the displacement at the middle of its surfaces by the POSE numbers, shape (3, POSE)."""
        return pose_jacobian(self.middle, self)

    @property
    def by_edges(self) -> F64:
        """Apparent displacement per metre of the unknown EDGES, shape (3,): outwards."""
        return np.array([*self.sight[:2], 0.0]) / np.linalg.norm(self.sight[:2])

    @property
    def edges_sigma(self) -> float:
        """Standard deviation of that unknown, m: 0.3 pixels.

        Edges appear farther from the sensor than they are: where a wall is in the same pixels as a roof, the roof
        starts later, and its last pixel reaches beyond it.
        """
        return 0.3 * self.points.spacing

    @property
    def seconds(self) -> float:
        """Time of its middle, s."""
        return self.stated.seconds

    @cached_property
    def middle(self) -> F64:
        """Middle of its points, in map, m, shape (3,)."""
        return sphere_point(*self.points.middle)

    @cached_property
    def slant_range(self) -> float:
        """Range of their middle, m."""
        return float(np.linalg.norm(self.middle - self.aperture.position))

    @property
    def sight(self) -> F64:
        """Unit vector to their middle, in map."""
        return np.asarray((self.middle - self.aperture.position) / self.slant_range)

    @cached_property
    def along(self) -> F64:
        """Shift of its surfaces per metre along the flight, shape (3,)."""
        return shift_along(self.aperture, self.sight)

    @property
    def speed(self) -> float:
        """Speed of the flight, m/s."""
        return float(np.linalg.norm(self.aperture.velocity))

    @property
    def lever(self) -> float:
        """Shift along the flight by a velocity along the line of sight, m per m/s."""
        return self.slant_range / self.speed


class Unknowns:
    """Numbers of the unknowns: first the common ones; then, as dwells arrive, knots of navigation and own unknowns."""

    common = np.arange(COMMON)

    def __init__(self, correlation: float) -> None:
        """Starts without dwells; `correlation`: correlation time of the navigation's errors, s."""
        self.drift = Drift(correlation)
        self._count = COMMON
        self._own: dict[int, Index] = {}

    def add(self, dwell: int, stated: Stated) -> list[Equation]:
        """Numbers the unknowns of a dwell, which is later than all others, and of a knot if it needs one.

        Returns:
            The prior of that knot.
        """
        equations: list[Equation] = []
        if self.drift.needs_knot(stated.seconds):
            equations = self.drift.add_knot(stated, self._numbered(STATE))
        self._own[dwell] = self._numbered(OWN)
        return equations

    def own(self, dwell: int) -> Index:
        """Numbers of a dwell's own unknowns."""
        return self._own[dwell]

    def forget(self, dwells: Collection[int], first: Knot) -> Index:
        """Forgets own unknowns of dwells, and knots before the first that is still needed; returns their numbers."""
        knots = [knot.columns for knot in self.drift.forget_before(first)]
        return np.concatenate([*knots, *(self._own.pop(dwell) for dwell in dwells)])

    def _numbered(self, count: int) -> Index:
        self._count += count
        return np.arange(self._count - count, self._count)


def pose(number: int, dwell: ObservedDwell, layout: Unknowns, mounting: Mounting) -> Form:
    """The error of the pose from which a dwell is seen, as a form of the unknowns: the POSE numbers.

    A shift of the image along the flight counts as an error of the position.

    Args:
        number: number of the dwell in the layout.
        dwell: the dwell.
        layout: numbers of the unknowns.
        mounting: mounting of the sensor, as described.
    """
    aperture, u, f, along = dwell.aperture, dwell.sight, dwell.aperture.direction, dwell.along
    body = aperture.rotation @ mounting.axes.inv().as_matrix()
    arm = body @ np.array(mounting.lever_arm)
    knot = layout.drift.knot_before(dwell.seconds)
    values = np.zeros((POSE, STATE + COMMON + OWN))
    constant = np.zeros(POSE)
    # The sensor turns with the body and with the boresight, and its beams by themselves about its forward axis.
    values[TURN, 6:9], values[TURN, -1] = np.eye(3), aperture.forward
    values[TURN, STATE:-OWN][:, BORESIGHT] = aperture.rotation
    # The antenna is where navigation, arm and delay put it.
    values[PLACE, :3], values[PLACE, 3:6] = np.eye(3), (dwell.seconds - knot.seconds) * np.eye(3)
    values[PLACE, 6:9] = -np.cross(np.eye(3), arm)
    values[PLACE, STATE:-OWN][:, LEVER_ARM], values[PLACE, STATE + DELAY] = body, -aperture.velocity
    # The image moves along the flight with the velocity, or with the beams.
    values[PLACE, -2] = along
    if dwell.placement.by_beams:
        values[PLACE, :-OWN] += dwell.slant_range * np.outer(along, np.cross(u, f)) @ values[TURN, :-OWN]
        constant[PLACE] = dwell.slant_range * dwell.placement.pointing * along
    else:
        values[PLACE, 3:6] -= dwell.lever * np.outer(along, u)
        constant[PLACE] = -dwell.lever * dwell.placement.speed * along
    values[STRETCH, STATE + PITCH] = 1.0
    columns = np.concatenate([knot.columns, layout.common, layout.own(number)])
    return Form(columns, values, constant)


def pose_jacobian(positions: F64, dwell: ObservedDwell) -> F64:
    """Derivative of positions (m, map, shape (..., 3)) of a dwell's surfaces by the POSE numbers, (..., 3, POSE)."""
    jacobian = np.empty((*positions.shape, POSE))
    jacobian[..., PLACE], jacobian[..., TURN] = np.eye(3), turn_jacobian(positions, dwell.aperture)
    _, elevation, _ = angles_of(positions, dwell.aperture, dwell.look_side)
    climb = position_jacobian(positions, dwell.aperture)[..., 0]
    jacobian[..., STRETCH] = -dwell.look_side * (np.asarray(elevation) - dwell.axis_middle)[..., None] * climb
    return jacobian


def displacement(pose_error: Form, dwell: ObservedDwell) -> Form:
    """The displacement of a dwell's surfaces east, north and up (m), at their middle, by the error of its pose."""
    jacobian = dwell.jacobian
    return Form(pose_error.columns, jacobian @ pose_error.values, jacobian @ pose_error.constant)


def seen(dwell: ObservedDwell, off: Form, layout: Unknowns) -> Form:
    """The apparent displacement of a dwell, by its edges, given the true one."""
    columns = np.append(off.columns, layout.common[EDGES])
    return Form(columns, np.column_stack([off.values, dwell.by_edges]), off.constant)


def centroid(number: int, dwell: ObservedDwell, layout: Unknowns, settings: AdjustmentSettings) -> Equation | None:
    """The equation of the Doppler centroid of a dwell; None: it was not measured.

    It differs from that of navigation by -v u + shake - |V| t (e + S b), with the shake of the dwell's own shift.
    """
    if (found := dwell.placement.centroid) is None:
        return None
    u, f = dwell.sight, dwell.aperture.direction
    ahead = -dwell.speed * np.cross(u, f)
    knot = layout.drift.knot_before(dwell.seconds)
    columns = np.concatenate([knot.columns[3:], layout.common[BORESIGHT], layout.own(number)[:1]])
    values = np.concatenate([-u, ahead, ahead @ dwell.aperture.rotation, [1 / dwell.lever]])[None]
    variance = found.error**2 + (dwell.speed * settings.jitter_rad) ** 2
    return Equation(columns, values, np.array([found.speed]), np.array([[1 / variance]]))


def vibration_of(dwells: Mapping[int, ObservedDwell], joined: Iterable[range]) -> float:
    """Standard deviation of the velocity along the line of sight by vibration that odometry does not contain, m/s.

    That is the spread of the Doppler centroids of consecutive dwells, whose errors of navigation are equal; they are
    angles on the circle of the ambiguity (Mardia and Jupp, Directional Statistics, section 2.3). It is at least the
    estimate from the curvature of their phases.

    Args:
        dwells: all dwells, by number.
        joined: numbers of consecutive dwells.
    """
    by_curvature = [dwell.placement.centroid.vibration for dwell in dwells.values() if dwell.placement.centroid]
    if not by_curvature:
        return 0.0
    weight = resultant = 0.0
    for members in joined:
        found = [one.speed / dwells[n].ambiguity for n in members if (one := dwells[n].placement.centroid)]
        if (count := len(found)) > 1:
            mean = abs(np.mean(np.exp(2j * np.pi * np.array(found))))
            resultant += count * float(mean) ** 2 - 1  # (count - 1) times the square of the true one, on the average
            weight += count - 1
    length = np.clip(resultant / weight, 0.01, 1.0) if weight else 1.0
    spread = float(np.sqrt(-np.log(length))) * next(iter(dwells.values())).ambiguity / (2 * np.pi)
    return max(spread, float(np.sqrt(np.mean(np.square(by_curvature)))))


def ambiguities_of(dwells: Mapping[int, ObservedDwell], layout: Unknowns, solution: Solution) -> dict[int, float]:
    """The whole number of ambiguities in the velocity error of each dwell, by number.

    A velocity beyond half of the ambiguity acts as if it were one ambiguity less.
    """
    along = {number: float(solution.of(layout.own(number)[:1])[0]) for number in dwells}
    return {
        number: 0.0 if dwell.placement.by_beams else round(along[number] / (dwell.lever * dwell.ambiguity))
        for number, dwell in dwells.items()
    }


def own_priors(
    dwells: Mapping[int, ObservedDwell],
    layout: Unknowns,
    settings: AdjustmentSettings,
    vibration: float,
    ambiguities: Mapping[int, float],
) -> list[Equation]:
    """The priors of each dwell's own errors: of vibration, or of the middle of its beams; and of jitter.

    Args:
        dwells: all dwells, by number.
        layout: numbers of the unknowns.
        settings: settings with the jitter.
        vibration: standard deviation of the velocity by vibration, m/s.
        ambiguities: ambiguities as of `ambiguities_of`; 0 where absent.
    """
    equations = []
    for number, dwell in dwells.items():
        along = max(dwell.lever * vibration, EXACT_M)
        if dwell.placement.by_beams:
            along = float(np.hypot(dwell.slant_range * settings.jitter_rad, dwell.lever * dwell.placement.beams_error))
        middle = np.array([ambiguities.get(number, 0.0) * dwell.lever * dwell.ambiguity, 0.0])
        information = np.diag([along**-2, settings.jitter_rad**-2])
        equations.append(Equation(layout.own(number), np.eye(OWN), middle, information))
    return equations


def stated_sigmas(settings: AdjustmentSettings) -> F64:
    """Prior standard deviations of the common unknowns but for edges and ground; 0: exact."""
    sigmas = np.empty(EDGES)
    sigmas[BORESIGHT], sigmas[LEVER_ARM] = settings.boresight_sigma_rad, settings.lever_arm_sigma_m
    sigmas[DELAY], sigmas[PITCH] = settings.odometry_delay_sigma_s, settings.pitch_sigma
    return sigmas


def common_prior(edges_sigma: float, ground_sigma: float, layout: Unknowns, settings: AdjustmentSettings) -> Equation:
    """The prior of mounting, delay, pitch of the beams, edges in images, and the elevation model.

    Args:
        edges_sigma: standard deviation of the apparent shift of edges, m.
        ground_sigma: standard deviation of the offset of the elevation model, m; 0: it is exact, or absent.
        layout: numbers of the unknowns.
        settings: settings of the adjustment.
    """
    exact = np.array([1e-9] * 3 + [1e-5] * 3 + [1e-9, 1e-8, 1e-6] + [1e-6] * 3)  # stand for 0
    sigmas = np.maximum([*stated_sigmas(settings), edges_sigma, *[ground_sigma] * 3], exact)
    return Equation(layout.common, np.eye(COMMON), np.zeros(COMMON), np.diag(sigmas**-2))
