"""The estimators of elevation by name, for the pipeline, the nodes and the commands.

To add one, write a module with a function from looks, beams and settings to an `ElevationEstimate`, and add an entry to
ESTIMATORS. Its node, topics, console script, settings, reports and pictures follow from the entry.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Residue, Scatterer
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.estimators.spectra import CaponSettings, MusicSettings, capon_elevation, music_elevation
from sal_height.elevation.looks.looks import DwellColumns, Looks
from sal_height.elevation.monopulse.pairs import MonopulseSettings, monopulse_elevation
from sal_height.elevation.monopulse.sum_difference import SumDifferenceSettings, sum_difference_elevation
from sal_height.elevation.vegetation.canopy_ground import CanopyGroundSettings, canopy_ground_elevation
from sal_height.errors import Rejected, UserError
from sal_height.numeric import C128
from sal_height.sensor import Channels, Sensor, sum_difference_channels, whitened_channels

Estimate = Callable[[Looks, Beams, Any], ElevationEstimate]
"""From looks and beams of the estimator's channels, and its own settings, to the elevation of every pixel."""

MakeChannels = Callable[[C128, C128], Channels]
"""Function of noise covariance and channel matrix of a sensor that returns the channels of an estimator."""


def estimate_dwells(
    estimate: Estimate, observed: Sequence[tuple[Looks, Beams]], settings: Any
) -> list[ElevationEstimate]:
    """The estimate of each of several dwells, as of each alone; those of one kind are estimated at once.

    Args:
        estimate: function of an estimator.
        observed: looks and beams of each dwell. Dwells with the same channels have the same object as beams.
        settings: settings of the estimator.
    """
    kinds: dict[Hashable, list[int]] = {}
    for number, (looks, beams) in enumerate(observed):
        # A covariance that is too large to be kept would have to be computed to be joined with others.
        kind = _kind(looks, beams) if isinstance(looks.covariance, np.ndarray) else number
        kinds.setdefault(kind, []).append(number)
    found: dict[int, ElevationEstimate] = {}
    for numbers in kinds.values():
        looks = side_by_side([observed[number][0] for number in numbers])
        beams = observed[numbers[0]][1]
        found |= dict(zip(numbers, _apart(estimate(looks, beams, settings), looks.columns), strict=True))
    return [found[number] for number in range(len(observed))]


def _kind(looks: Looks, beams: Beams) -> Hashable:
    """Looks of one kind can be put side by side."""
    return id(beams), looks.covariance.shape, tuple(looks.noise_powers.tolist())


def side_by_side(several: Sequence[Looks]) -> Looks:
    """The looks of several dwells of one kind as one image, in the order of their columns."""
    first = several[0]
    if len(several) == 1:
        return first
    each = {f.name: [getattr(looks, f.name) for looks in several] for f in fields(Looks)}
    by_pixel = {name: np.concatenate(values, axis=1) for name, values in each.items() if np.ndim(values[0]) > 1}
    by_dwell = {name: np.repeat(each[name], len(first.squint)) for name in ("level_spread", "unplaced")}
    return replace(first, **by_pixel, **by_dwell, squint=np.concatenate(each["squint"]), dwells=len(several))


def _apart(estimate: ElevationEstimate, columns: DwellColumns) -> list[ElevationEstimate]:
    """The estimates of dwells whose pixels are side by side."""
    if columns.dwells == 1:
        return [estimate]
    parts = [[columns.split(getattr(one, f.name)) for f in fields(one)] for one in estimate.scatterers]
    validity, chances = columns.split(estimate.validity), estimate.order_probability
    of_orders = None if chances is None else columns.split(chances)
    residue = estimate.residue
    residues = [columns.split(getattr(residue, f.name)) for f in fields(residue)] if residue else []
    return [
        ElevationEstimate(
            tuple(Scatterer(*(values[dwell] for values in of_one)) for of_one in parts),
            validity[dwell],
            None if of_orders is None else of_orders[dwell],
            Residue(*(values[dwell] for values in residues)) if residues else None,
        )
        for dwell in range(columns.dwells)
    ]


def has_several_detectors(sensor: Sensor) -> bool:
    """True if elevation can be estimated: for estimators that use the whole array, with any channels."""
    return sensor.detector_count > 1


def has_separate_detectors(sensor: Sensor) -> bool:
    """True if whitening gives single detectors, each with independent noise: for estimators that use pairs."""
    if not sensor.is_mixed:
        return has_several_detectors(sensor)
    channels = whitened_channels(sensor.noise_covariance, sensor.mixing)
    return sensor.beams.combined(channels.matrix).matrix is None


def has_sum_and_difference(sensor: Sensor) -> bool:
    """True if the channels are the sum and the difference of two beams."""
    try:
        sum_difference_channels(sensor.noise_covariance, sensor.mixing)
    except UserError:
        return False
    return True


@dataclass(frozen=True)
class ElevationEstimator:
    """An estimator of elevation.

    Attributes:
        name: name in topics, `<name>/height`, in HeightImage.estimator, and on the command line.
        node: name of its ROS node; the console script that starts it is `sal-height-` and this name.
        title: title in pictures and tables.
        settings: class of its settings.
        estimate: function that returns the elevation of every pixel of a dwell.
        suits: function that is true for a sensor with the channels that it needs.
        channels: function that returns its channels from those of the sensor; whitened ones by default.
        by_default: True if a run makes its heights by default.
    """

    name: str
    node: str
    title: str
    settings: type[HeightSettings]
    estimate: Estimate
    suits: Callable[[Sensor], bool] = has_several_detectors
    channels: MakeChannels = whitened_channels
    by_default: bool = False

    def estimate_dwells(
        self, observed: Sequence[tuple[Looks, Beams]], settings: HeightSettings
    ) -> list[ElevationEstimate]:
        """The `estimate` of each of several dwells, from their looks and beams, in less time than one by one."""
        return estimate_dwells(self.estimate, observed, settings)


def _sum_and_difference(noise_covariance: C128, channel_matrix: C128) -> Channels:
    """Sigma and Delta with equal gains, each with its own noise."""
    try:
        return sum_difference_channels(noise_covariance, channel_matrix)
    except UserError as error:
        raise Rejected("no sum and difference", str(error)) from error


_ENTRIES = (
    ElevationEstimator(
        name="monopulse",
        node="monopulse",
        title="monopulse",
        settings=MonopulseSettings,
        estimate=monopulse_elevation,
        suits=has_separate_detectors,
        by_default=True,
    ),
    ElevationEstimator(
        name="ml",
        node="ml_height",
        title="array maximum likelihood",
        settings=MlSettings,
        estimate=ml_elevation,
        by_default=True,
    ),
    ElevationEstimator(
        name="sum_difference",
        node="sum_difference_height",
        title="sum and difference",
        settings=SumDifferenceSettings,
        estimate=sum_difference_elevation,
        suits=has_sum_and_difference,
        channels=_sum_and_difference,
        by_default=True,
    ),
    ElevationEstimator(
        name="capon",
        node="capon_height",
        title="Capon",
        settings=CaponSettings,
        estimate=capon_elevation,
    ),
    ElevationEstimator(
        name="music",
        node="music_height",
        title="MUSIC",
        settings=MusicSettings,
        estimate=music_elevation,
    ),
    ElevationEstimator(
        name="canopy_ground",
        node="canopy_ground_height",
        title="ground under canopy",
        settings=CanopyGroundSettings,
        estimate=canopy_ground_elevation,
    ),
)

ESTIMATORS = {entry.name: entry for entry in _ENTRIES}
"""The estimators by name, in the order in which runs and pictures list them."""
