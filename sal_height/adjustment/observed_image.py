"""Dwells of one detector: images of ground whose level is known, instead of heights.

A surface at the height h over the level of the ground lies in the image where ground of its range and Doppler is:
on the circle of both, whose direction is c = u x f (u: line of sight, f: direction of flight). So errors that displace
surfaces by d, of which range and Doppler tell nothing along c, move the image by

    d - c d_up / c_up,

and the surface lies off by -c h / c_up, which turns from dwell to dwell with c. The height of the ground over its level
is therefore an unknown that all dwells share, in the place of that of the edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from sal_height.adjustment.comparing import search_reaches
from sal_height.adjustment.drift import Pulses, Stated
from sal_height.adjustment.equations import Equation, Form, Solution
from sal_height.adjustment.ground_image import CELLS_PER_PIXEL, SAMPLING, GroundImage, shift_between, vertex_of
from sal_height.adjustment.matching import LEAST_INFORMATION, REFERENCE, Points
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import PLACE, POSE, ObservedDwell
from sal_height.adjustment.reference import Target
from sal_height.adjustment.settings import ImageAdjustmentSettings
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Trajectory, sphere_point
from sal_height.imaging import Slc
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor

DELTA = 0.39
"""Standard deviation of the place of a point in clutter, in resolutions over the root of the signal-to-clutter ratio:
sqrt(3 / 2) / pi, the Cramer-Rao bound of a flat spectrum (Bamler and Eineder, IEEE Geoscience and Remote Sensing
Letters 2, 2005)."""

TARGET_DB, OVER_IMAGE_DB = 10.0, 20.0
"""By which a target is brighter than all else where it may be, and than half of the image. More than of heights: it is
known by two coordinates only, and the strongest of a million pixels of speckle is 13 dB over their median."""

EXTENT = 2.0
"""Resolutions around the peak of a target that show the target itself."""

AROUND = 6.0
"""Resolutions around where a target may be that it is compared with."""


@dataclass(frozen=True, eq=False)
class ObservedImage(ObservedDwell):
    """An image, and what it was made with; its only point is the middle of the ground that it shows.

    Attributes:
        ground: what it shows.
        ground_sigma: standard deviation of its height, m.
        resolution: on the ground across the flight, and along it, m, shape (2,).
    """

    ground: GroundImage
    ground_sigma: float
    resolution: F64

    @classmethod
    def of_image(
        cls,
        slc: Slc,
        sensor: Sensor,
        track: Trajectory,
        history: PhaseHistory,
        settings: ImageAdjustmentSettings,
        step: float,
        epoch_ns: int = 0,
    ) -> Self:
        """The images of a dwell, with their sensor, the track of base_link, and its pulses.

        Args:
            slc: the images.
            sensor: that they are of.
            track: of base_link.
            history: the pulses.
            settings: level of the ground, and the errors of an odometry that states none.
            step: size of the cells on the ground, m.
            epoch_ns: from which seconds count.

        Raises:
            Rejected: it is an image of a strip.
        """
        if slc.aperture.sliding:
            raise Rejected("strip", "Images of strips without heights cannot be adjusted; spotlight dwells can.")
        ground = GroundImage.of(slc, sensor, settings.ground_m, step)
        middle, nothing = np.array([[*ground.middle, settings.ground_m]]), np.zeros(1)
        sight = sphere_point(*middle[0]) - slc.aperture.position
        slant_range = float(np.linalg.norm(sight))
        across = sensor.range_resolution * slant_range / float(np.linalg.norm(sight[:2]))
        return cls(
            points=Points(middle, nothing, nothing, np.zeros(1, np.int64), CELLS_PER_PIXEL * step),
            aperture=slc.aperture,
            placement=slc.placement,
            stated=completed(Pulses(track, history.stamp_ns, history.pulse_times, epoch_ns).stated, settings),
            axis_middle=sensor.beams.axis_middle,
            look_side=sensor.look_side,
            ambiguity=sensor.wavelength * sensor.pulse_repetition_frequency / 2,
            ground=ground,
            ground_sigma=settings.ground_sigma_m,
            resolution=np.array([across, sensor.wavelength * slant_range / (2 * slc.aperture.length)]),
        )

    @cached_property
    def layover(self) -> F64:
        """By how much a surface a metre over the ground lies off in the image, east and north, shape (2,)."""
        return _layover(self.middle, self.aperture)

    @property
    def jacobian(self) -> F64:
        """How the image lies off on the ground, and the antenna in height, by the POSE numbers, shape (3, POSE)."""
        jacobian = np.zeros((3, POSE))
        jacobian[:, PLACE] = np.eye(3)
        jacobian[:2, PLACE.stop - 1] = self.layover
        return jacobian

    @property
    def by_edges(self) -> F64:
        """How far the image lies off by a metre of height of the ground, shape (3,)."""
        return np.append(self.layover, 0.0)

    @property
    def edges_sigma(self) -> float:
        """Standard deviation of that height, m."""
        return self.ground_sigma

    @property
    def across(self) -> F64:
        """Horizontal unit vector away from the antenna across the flight, shape (2,)."""
        east, north = self.aperture.direction[:2]
        outwards = np.array([north, -east]) / np.hypot(east, north)
        return np.asarray(outwards * np.sign(outwards @ self.sight[:2]))


def _layover(place: F64, aperture: ApertureState) -> F64:
    """By how much a surface a metre over a place (map, m, shape (3,)) lies off on the ground, east and north, (2,)."""
    circle = np.cross(place - aperture.position, aperture.direction)
    return np.asarray(-circle[:2] / circle[2])


def completed(stated: Stated, settings: ImageAdjustmentSettings) -> Stated:
    """What odometry states of its errors, or where it states none of position or of velocity what the settings do."""
    pose, velocity = stated.pose.copy(), stated.velocity
    if not pose[:3, :3].any():
        pose[:3, :3] = settings.position_sigma_m**2 * np.eye(3)
    if not velocity.any():
        velocity = settings.velocity_sigma_mps**2 * np.eye(3)
    return replace(stated, pose=pose, velocity=velocity)


def compared_images(
    dwells: dict[int, ObservedImage], network: Network, known: Solution, settings: ImageAdjustmentSettings
) -> Iterator[Comparison]:
    """Compare each image with the latest before it.

    Args:
        dwells: by number, in the order of time.
        network: of them.
        known: of their displacements.
        settings: how many they are compared with.
    """
    for number, dwell in dwells.items():
        earlier = [other for other in dwells if other < number][-settings.partners :]
        if not earlier:
            continue
        apart = [network.displacements[number].minus([(1.0, network.displacements[other])]) for other in earlier]
        reaches = search_reaches(known, apart, dwell.points.spacing, settings)
        found = []
        for other, form, reach in zip(earlier, apart, reaches, strict=True):
            told = shift_between(dwell.ground, dwells[other].ground, known.at(form)[:2], reach[:2])
            if told is not None:
                found.append((other, form, *told))
        for other, form, shift, covariance in found:
            seen = network.seen[number].minus([(1.0, network.seen[other])])
            # The noise of the dwell itself is in all its comparisons: half of the variance of each.
            equation = _on_ground(seen, shift, (len(found) + 1) / 2 * covariance)
            yield Comparison(({number: 1.0}, {other: 1.0}), equation, form)


def _on_ground(form: Form, shift: F64, covariance: F64) -> Equation:
    """The equation by which a form is a shift east and north (m, shape (2,)), and is not known upwards."""
    information = LEAST_INFORMATION * np.eye(3)
    information[:2, :2] += np.linalg.inv(covariance)
    return form.equals(np.append(shift, 0.0), information)


def targets_in_images(
    dwells: dict[int, ObservedImage], network: Network, known: Solution, targets: tuple[Target, ...]
) -> Iterator[Comparison]:
    """Find the reference targets in images.

    Args:
        dwells: by number.
        network: of them.
        known: of their displacements.
        targets: whose places are known.
    """
    for number, dwell in dwells.items():
        form = network.displacements[number]
        (reach,) = search_reaches(known, [form], dwell.points.spacing, network.settings)
        for target in targets:
            equation = _sighted(target, dwell, form, known.at(form), reach)
            if equation is not None:
                yield Comparison(({number: 1.0}, {REFERENCE: 1.0}), equation, form, is_target=True)


def _sighted(target: Target, dwell: ObservedImage, form: Form, expected: F64, reach: F64) -> Equation | None:
    """What a target tells of the displacement of an image; None: it is not in it, or does not stand out.

    Args:
        target: whose place is known.
        dwell: the image.
        form: its displacement.
        expected: that displacement as it is known beforehand, m, shape (3,).
        reach: how far from that it may be, m, shape (3,).
    """
    layover = _layover(sphere_point(*target.place), dwell.aperture)
    place = target.place[:2] + layover * (target.height - float(dwell.points.place[0, 2]))
    ground, axes = dwell.ground, np.stack([dwell.across, dwell.aperture.direction[:2]])
    wide = reach[:2] + AROUND * dwell.resolution.max()
    low, high = (np.rint((place + expected[:2] + side * wide) / ground.step) - ground.first for side in (-1, 1))
    low, high = np.maximum(low, 1).astype(int), np.minimum(high, np.array(ground.power.shape) - 2).astype(int)
    if np.any(high <= low):
        return None
    power = np.nan_to_num(ground.power[low[0] : high[0], low[1] : high[1]])
    cells = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1)
    off = ground.step * (ground.first + cells) - place - expected[:2]
    within = np.where(np.all(np.abs(off) <= reach[:2], axis=-1), power, 0.0)
    at = np.unravel_index(np.argmax(within), within.shape)
    others = np.linalg.norm((off - off[at]) @ axes.T / dwell.resolution, axis=-1) > EXTENT
    least = 10 ** (TARGET_DB / 10) * within[others].max(initial=0.0)
    if not (others.any() and within[at] > max(least, 10 ** (OVER_IMAGE_DB / 10) * float(np.nanmedian(ground.power)))):
        return None
    row, col = cells[at]
    peak = vertex_of(np.log(np.maximum(ground.power[row - 1 : row + 2, col - 1 : col + 2], 1e-300)))
    if not np.isfinite(peak).all():
        return None
    shift = ground.step * (ground.first + cells[at] + peak) - place
    clutter = float(power[others].mean() / within[at])
    along_axes = np.diag((DELTA * dwell.resolution) ** 2 * clutter + (SAMPLING * ground.step) ** 2)
    of_target = target.sigma**2 * (np.eye(2) + np.outer(layover, layover))
    return _on_ground(form, shift, np.linalg.inv(axes) @ along_axes @ np.linalg.inv(axes).T + of_target)
