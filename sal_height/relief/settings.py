"""Settings of the tracking of height images."""

from __future__ import annotations

import math

from sal_height.settings import Settings, setting


class TrackingSettings(Settings):
    """Settings of the tracking of the heights of an image, and of how much of the prior is estimated from them."""

    correlation_length_m: float = setting(
        0.0,
        "correlation length of the relief on the ground; 0: estimated",
        unit="m",
        minimum=0.0,
        maximum=1e6,
    )
    relief_sigma_m: float = setting(
        0.0, "standard deviation of the relief; 0: estimated", unit="m", minimum=0.0, maximum=1e5
    )
    along_track: bool = setting(
        default=True, description="whether heights are smoothed along track as well as along range"
    )
    gate: float = setting(
        4.0,
        "heights farther than this from their prediction are outliers",
        unit="standard deviations",
        minimum=1.0,
        maximum=1000.0,
    )
    outlier_fraction: float = setting(
        0.02,
        "expected fraction of outliers among the heights from which the prior of the relief is estimated",
        minimum=1e-6,
        maximum=0.5,
    )
    prior_dwells: int = setting(
        16,
        "dwells from which the prior of the relief is estimated: the weight of older ones falls to 1 / "
        "e at this age; 1: each dwell by itself",
        minimum=1,
        maximum=1_000_000,
    )
    prior_columns: int = setting(
        64,
        "columns of a dwell from which the prior of the relief is estimated; more take longer and hardly improve it",
        minimum=1,
        maximum=65536,
    )
    window_columns: int = setting(
        32,
        "columns that are smoothed together along track; farther ones do not affect a height; the time per height "
        "grows as the square",
        minimum=4,
        maximum=512,
    )
    interpolation_limit: float = setting(
        math.sqrt(0.5),
        "highest standard deviation of an interpolated height, over that of the relief; 0: nothing is interpolated",
        minimum=0.0,
        maximum=1.0,
    )


DEFAULT_TRACKING = TrackingSettings()


class GroundSettings(Settings):
    """Settings of the estimate of the ground from the surfaces of all pixels."""

    gate: float = setting(
        3.0,
        "heights that differ by more are not those of the same piece of ground",
        unit="standard deviations",
        minimum=1.0,
        maximum=1000.0,
    )
    least_pixels: int = setting(
        4,
        "pixels that must hang together to be a surface, where others are around them; fewer are ghosts",
        minimum=1,
        maximum=1000,
    )
    reach_pixels: float = setting(
        1.6, "distance up to which pixels hang together", unit="pixels", minimum=1.0, maximum=100.0
    )
    interpolation_pixels: float = setting(
        4.0,
        "distance from measured ground on both sides up to which a gap is interpolated; 0: nothing is interpolated",
        unit="pixels",
        minimum=0.0,
        maximum=100.0,
    )


DEFAULT_GROUND = GroundSettings()
