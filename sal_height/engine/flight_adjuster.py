"""The adjustment of one flight: heights of each dwell, moved to where earlier dwells saw the same ground."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height.adjustment import (
    MOST_POINTS,
    AdjustmentSettings,
    AdjustmentWindow,
    ObservedDwell,
    PoseError,
    PulseTrack,
    References,
    corrected_aperture,
    corrected_heights,
    corrected_mounting,
    corrected_states,
    describe_ground,
    mounting_covariance,
    placement_in_strip,
)
from sal_height.elevation import BEAM_PITCH, ESTIMATORS
from sal_height.engine.height_items import Heights
from sal_height.engine.image_settings import pose_settings
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Mounting, PlatformState
from sal_height.numeric import F64
from sal_height.pipeline import range_covariance
from sal_height.relief import HeightField
from sal_height.sensor import AS_DESCRIBED, Sensor, deviation_of
from sal_height.settings import setting, settings_of

KNOWN = "boresight_sigma_rad", "lever_arm_sigma_m", "odometry_delay_sigma_s"
"""Settings that the compression has as well, whose values there count unless they are SAYS_NOTHING."""

SAYS_NOTHING = None, 0.0, AS_DESCRIBED
"""Values of standard deviations of the compression that state nothing for the adjustment."""


class WindowSettings(AdjustmentSettings):
    """Settings of the adjustment of a flight."""

    window_dwells: int = setting(
        200,
        "latest dwells that are kept for comparison; the information of earlier ones on navigation and mounting stays",
        minimum=1,
        maximum=10_000,
    )
    window_points: int = setting(
        MOST_POINTS,
        "most heights of all dwells that are kept; each takes 200 bytes",
        minimum=1000,
        maximum=1_000_000_000,
    )


@dataclass(frozen=True, eq=False)
class AdjustedDwell:
    """Adjustment of a dwell.

    Attributes:
        field: adjusted heights.
        aperture: adjusted aperture from which they are seen.
        off: error of the pose that was removed.
        states: adjusted odometry during the dwell.
        mounting: adjusted mounting of the sensor.
        mounting_covariance: covariance of lever arm (m^2) and rotation (rad^2) in the axes of the platform.
        is_compared: True if the dwell shows ground that others show, or that is known.
        is_first: True if the flight, or its adjustment, starts again with this dwell.
    """

    field: HeightField
    aperture: ApertureState
    off: PoseError
    states: list[PlatformState]
    mounting: Mounting
    mounting_covariance: F64
    is_compared: bool
    is_first: bool


class FlightAdjuster:
    """Adjusts the heights of one dwell of a sensor after the other.

    Attributes:
        published_ns: stamp of the latest odometry that was published, ns.
    """

    def __init__(self, references: References) -> None:
        """Start without dwells."""
        self.published_ns = 0
        self._references = references
        self._window: AdjustmentWindow | None = None
        self._made_for: Hashable = None
        self._epoch_ns = self._latest_ns = 0

    def adjust(
        self, heights: Heights, sensor: Sensor, states: list[PlatformState], settings: WindowSettings
    ) -> AdjustedDwell:
        """Adjust the heights of a dwell, which is later than all before, to those of earlier ones.

        Another description of the sensor, or other settings, start again.

        Args:
            heights: heights of the dwell.
            sensor: sensor that recorded it.
            states: odometry around it, without the delay of its stamps.
            settings: prior knowledge, and limits of what is kept.

        Raises:
            UserError: they cannot be adjusted.
        """
        stage, stamp_ns = heights.provenance.compression, heights.key.stamp_ns
        known = _known(settings, stage).described(sensor)
        _check_mounting(stage)
        limits = settings.window_dwells, settings.window_points
        made_for = sensor.digest, known, limits
        if made_for != self._made_for:
            self._window = None
        is_first = self._window is None
        if self._window is None:
            self._window = AdjustmentWindow(sensor.mounting, known, *limits, self._references)
            self._made_for, self._epoch_ns, self._latest_ns = made_for, stamp_ns, stamp_ns
        if stamp_ns < self._latest_ns:
            late_s = (self._latest_ns - stamp_ns) * 1e-9
            raise Rejected(
                "out of order",
                f"Dwell {heights.key.number} is {late_s:.3g} s older than one before it; dwells must be in order.",
            )
        self._latest_ns = stamp_ns
        image = pose_settings(stage)
        pulses = PulseTrack(
            image.assumed_track(states), stamp_ns, np.array([0.0, length_s(heights, sensor)]), self._epoch_ns
        )
        dwell = _observed(heights, pulses, sensor)
        try:
            off = self._window.add(dwell)
        except Exception:
            self._window = None  # start again rather than go on with a part
            raise
        adjustment = self._window.adjustment
        if adjustment.contradicts_ground:
            self._references, self._window = self._references.without_terrain(), None
            raise Rejected(
                "known ground",
                f"{describe_ground(adjustment.ground_off[0])}; it counts no more after dwell {heights.key.number}, and "
                "the next dwell is adjusted as the first one.",
            )
        seconds = [(state.stamp_ns - self._epoch_ns) * 1e-9 for state in states]
        off = off.uncertain_by(range_covariance(dwell.aperture, heights.field.grid.middle, sensor, image))
        return AdjustedDwell(
            corrected_heights(heights.field, dwell, off, pitch_in_heights(heights, sensor)),
            corrected_aperture(dwell, off),
            off,
            corrected_states(states, seconds, adjustment, sensor.mounting, known),
            corrected_mounting(sensor.mounting, adjustment),
            mounting_covariance(sensor.mounting, adjustment),
            self._window.latest_is_compared,
            is_first,
        )


def length_s(heights: Heights, sensor: Sensor) -> float:
    """Time from the first pulse of a dwell to one pulse spacing past its last, s; of a strip that of a block."""
    if sensor.mode == "stripmap":
        return sensor.pulse_count / sensor.pulse_repetition_frequency
    return heights.aperture.length / float(np.linalg.norm(heights.aperture.velocity))


def pitch_in_heights(heights: Heights, sensor: Sensor) -> float:
    """Relative standard deviation of the angles between the beams that the covariances of heights contain."""
    entry = ESTIMATORS.get(heights.estimator)
    stated = heights.provenance.stages.get(entry.node, {}).get("beam_pitch_sigma") if entry else None
    if not isinstance(stated, float):
        return 0.0
    return deviation_of(stated, sensor.uncertainty.beam_pitch, BEAM_PITCH).sigma


def _known(settings: WindowSettings, stage: Mapping[str, Any]) -> AdjustmentSettings:
    """Prior knowledge: values of mounting and delay that the compression states, and otherwise the settings.

    Raises:
        UserError: a value that it states is not allowed.
    """
    values = {name: getattr(settings, name) for name in settings_of(AdjustmentSettings)}
    return AdjustmentSettings(
        **{**values, **{name: stage[name] for name in KNOWN if stage.get(name) not in SAYS_NOTHING}}
    )


def _check_mounting(stage: Mapping[str, Any]) -> None:
    """Make sure that images were made with the mounting of the sensor's description.

    Raises:
        Rejected: they were not.
    """
    if stage.get("mounting_from_tf"):
        raise Rejected(
            "mounting from tf",
            "The mounting of the sensor is that on /tf_static (sar_compression.mounting_from_tf); heights are adjusted "
            "with that in sensor_info only.",
        )


def _observed(heights: Heights, pulses: PulseTrack, sensor: Sensor) -> ObservedDwell:
    """The heights of a dwell, or of an image of a strip, as an adjustment reads them.

    Args:
        heights: heights of the dwell.
        pulses: pulses of the dwell, or of the block that completed the image.
        sensor: sensor that recorded them.

    Raises:
        Rejected: there are too few, or their positions are not known.
    """
    aperture, placement = heights.aperture.state, heights.provenance.placement
    if not aperture.sliding:
        return ObservedDwell.seen_from(aperture, heights.field, placement, pulses.stated, sensor)
    placement = placement_in_strip(placement, phase_removed=len(heights.provenance.autofocus_phase) > 0)
    stated = pulses.stated_abeam(aperture, sensor.mounting)
    return ObservedDwell.seen_from(aperture, heights.field, placement, stated, sensor)
