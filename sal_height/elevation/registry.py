"""The estimators of elevation by name: all that the pipeline, the nodes and the commands know of them.

To add one, write a module with a function from looks and beams to an `ElevationEstimate`, and add an entry to
ESTIMATORS. Its node, topics, console script, settings, and its place in reports and pictures follow from the entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import field_validator

from sal_height.beams import Beams
from sal_height.elevation.capon import LOADING, capon_elevation
from sal_height.elevation.estimate import ElevationEstimate
from sal_height.elevation.layover import FALSE_ALARM, resolve_layover
from sal_height.elevation.likelihood import OBJECTIVES, ArrayRules, ml_elevation
from sal_height.elevation.looks import Looks
from sal_height.elevation.monopulse.estimators import DISCRIMINANTS
from sal_height.elevation.monopulse.inversion import INVERSES
from sal_height.elevation.monopulse.pairs import monopulse_elevation
from sal_height.elevation.monopulse.slope_table import SlopeTable, read_slope_table
from sal_height.elevation.monopulse.sum_difference import Discriminator, sum_difference_elevation
from sal_height.elevation.music import music_elevation
from sal_height.elevation.settings import HeightSettings
from sal_height.elevation.spatial_prior import RECOMMENDED_STRENGTH, prior_elevation
from sal_height.errors import Rejected, UserError
from sal_height.numeric import C128, F64
from sal_height.sensor import MAX_DETECTORS, Channels, Sensor, sum_difference_channels, whitened_channels
from sal_height.settings import setting

MakeChannels = Callable[[C128, C128], Channels]
"""From the noise covariance of the sensor's channels and its channel matrix to the channels that an estimator takes."""

Estimate = Callable[[Looks, Beams, F64, F64, Any], ElevationEstimate]
"""From looks and beams of the estimator's channels, the squint of each column (rad), the noise power of each channel,
and the estimator's own settings to the elevation of every pixel."""


def has_several_detectors(sensor: Sensor) -> bool:
    """Whether elevation can be had at all: for estimators that take the whole array, whatever its channels are."""
    return sensor.detector_count > 1


def has_separate_detectors(sensor: Sensor) -> bool:
    """Whether whitening gives the detectors one by one, each with noise of its own: for estimators that take pairs."""
    if not sensor.is_mixed:
        return has_several_detectors(sensor)
    channels = whitened_channels(sensor.noise_covariance, sensor.mixing)
    return sensor.beams.combined(channels.matrix).matrix is None


def has_sum_and_difference(sensor: Sensor) -> bool:
    """Whether the channels are the sum and the difference of two beams."""
    try:
        sum_difference_channels(sensor.noise_covariance, sensor.mixing)
    except UserError:
        return False
    return True


@dataclass(frozen=True)
class ElevationEstimator:
    """An estimator of elevation.

    Attributes:
        name: in topics, `<name>/height`, in HeightImage.estimator, and on the command line.
        node: name of its ROS node and of the console script that starts it.
        title: what pictures and tables call it.
        settings: class of its settings.
        estimate: elevation of every pixel of a dwell.
        suits: whether a sensor has the channels that it needs.
        channels: that it takes, from those of the sensor; whitened ones unless stated otherwise.
        by_default: whether a run makes its heights without being asked to.
    """

    name: str
    node: str
    title: str
    settings: type[HeightSettings]
    estimate: Estimate
    suits: Callable[[Sensor], bool] = has_several_detectors
    channels: MakeChannels = whitened_channels
    by_default: bool = True


class MonopulseSettings(HeightSettings):
    """Settings of the estimator that takes the strongest pair of detectors."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (total least squares), ratio (as published; biased at low CNR) or "
        "noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )


def _estimate_by_pairs(
    looks: Looks, beams: Beams, squint: F64, noise_powers: F64, settings: MonopulseSettings
) -> ElevationEstimate:
    if beams.matrix is not None:
        raise Rejected(
            "mixed channels",
            "The channel matrix of SensorInfo is no lossless hybrid, so the detectors' noise is correlated and they "
            "form no pairs; use ml_height, or sum_difference_height for a sum and a difference.",
        )
    discriminant = DISCRIMINANTS[settings.discriminant]
    return monopulse_elevation(looks, beams, squint, float(noise_powers[0]), discriminant, settings.min_cnr, settings)


class MlSettings(HeightSettings, ArrayRules):
    """Settings of maximum likelihood over the whole array."""

    objective: str = setting(
        "normalised",
        "function that is maximised: normalised (exact) or numerator (as published; biased near the ends of the array)",
        choices=tuple(OBJECTIVES),
    )
    prior_strength: float = setting(
        0.0,
        f"weight of the spatial smoothness prior; 0: none; {RECOMMENDED_STRENGTH:g} is recommended at low CNR; "
        "small features may vanish",
        minimum=0.0,
        maximum=100.0,
    )
    layover: bool = setting(
        default=True, description="whether to search for two scatterers in pixels that a single one does not explain"
    )
    layover_false_alarm: float = setting(
        FALSE_ALARM,
        "share of single scatterers that may be taken for two, of those that do not pass for one",
        minimum=1e-9,
        maximum=0.1,
    )


def _estimate_by_likelihood(
    looks: Looks, beams: Beams, squint: F64, noise_powers: F64, settings: MlSettings
) -> ElevationEstimate:
    noise_power, strength, min_cnr = float(noise_powers[0]), settings.prior_strength, settings.min_cnr
    if strength:
        estimate = prior_elevation(looks, beams, squint, noise_power, strength, min_cnr, settings)
    else:
        estimate = ml_elevation(looks, beams, squint, noise_power, OBJECTIVES[settings.objective], min_cnr, settings)
    if not settings.layover:
        return estimate
    return resolve_layover(estimate, looks, beams, squint, noise_power, min_cnr, settings.layover_false_alarm)


class SumDifferenceSettings(HeightSettings):
    """Settings of the discriminator of a sensor that delivers sum and difference of two beams."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (exact maximum likelihood), ratio (as published; biased at low CNR) "
        "or noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )
    inverse: str = setting(
        "exact",
        "how elevation follows from Delta / Sigma: exact (from the beams) or linear (as published: from the slope in "
        "the equisignal direction)",
        choices=tuple(INVERSES),
    )
    slope_table: str = setting(
        "",
        "path of a CSV file with a measured characteristic, which replaces inverse; its columns are angle_rad (from "
        "the equisignal direction) and gamma; empty: none",
        read_only=True,
    )

    @field_validator("slope_table")
    @classmethod
    def _check_slope_table(cls, path: str) -> str:
        if path:
            _slope_table(path)
        return path


@lru_cache(maxsize=8)
def _slope_table(path: str) -> SlopeTable:
    return read_slope_table(Path(path))


def _sum_and_difference(noise_covariance: C128, channel_matrix: C128) -> Channels:
    """Sigma and Delta with equal gains, each with its own noise."""
    try:
        return sum_difference_channels(noise_covariance, channel_matrix)
    except UserError as error:
        raise Rejected("no sum and difference", str(error)) from error


def _estimate_by_sum_and_difference(
    looks: Looks, beams: Beams, squint: F64, noise_powers: F64, settings: SumDifferenceSettings
) -> ElevationEstimate:
    inverse = _slope_table(settings.slope_table).invert if settings.slope_table else INVERSES[settings.inverse]
    discriminator = Discriminator(DISCRIMINANTS[settings.discriminant], inverse)
    powers = float(noise_powers[0]), float(noise_powers[1])
    return sum_difference_elevation(looks, beams, squint, powers, discriminator, settings.min_cnr, settings)


class CaponSettings(HeightSettings, ArrayRules):
    """Settings of Capon's method."""

    loading: float = setting(
        LOADING,
        "power added to the diagonal of the mean covariance before it is inverted; more of it lowers the noise of the "
        "estimate, less of it separates scatterers better",
        unit="noise powers",
        minimum=1e-3,
        maximum=1e3,
    )


def _estimate_by_capon(
    looks: Looks, beams: Beams, squint: F64, noise_powers: F64, settings: CaponSettings
) -> ElevationEstimate:
    return capon_elevation(looks, beams, squint, float(noise_powers[0]), settings.min_cnr, settings.loading, settings)


class MusicSettings(HeightSettings, ArrayRules):
    """Settings of MUSIC."""

    order: int = setting(
        1, "dimensions of the signal subspace; fewer than there are detectors", minimum=1, maximum=MAX_DETECTORS - 1
    )


def _estimate_by_music(
    looks: Looks, beams: Beams, squint: F64, noise_powers: F64, settings: MusicSettings
) -> ElevationEstimate:
    return music_elevation(looks, beams, squint, float(noise_powers[0]), settings.min_cnr, settings.order, settings)


_ENTRIES = (
    ElevationEstimator(
        name="monopulse",
        node="monopulse",
        title="monopulse",
        settings=MonopulseSettings,
        estimate=_estimate_by_pairs,
        suits=has_separate_detectors,
    ),
    ElevationEstimator(
        name="ml",
        node="ml_height",
        title="array maximum likelihood",
        settings=MlSettings,
        estimate=_estimate_by_likelihood,
    ),
    ElevationEstimator(
        name="sum_difference",
        node="sum_difference_height",
        title="sum and difference",
        settings=SumDifferenceSettings,
        estimate=_estimate_by_sum_and_difference,
        suits=has_sum_and_difference,
        channels=_sum_and_difference,
    ),
    ElevationEstimator(
        name="capon",
        node="capon_height",
        title="Capon",
        settings=CaponSettings,
        estimate=_estimate_by_capon,
        by_default=False,
    ),
    ElevationEstimator(
        name="music",
        node="music_height",
        title="MUSIC",
        settings=MusicSettings,
        estimate=_estimate_by_music,
        by_default=False,
    ),
)

ESTIMATORS = {entry.name: entry for entry in _ENTRIES}
"""The estimators by name, in the order in which runs and pictures list them."""
