"""Height images of passes over the same ground, with the odometry and the sensor that they come with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from flown_passes import STREET

from sal_height import messages
from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings
from sal_height.messages.types import ComplexImage, HeightImage, Odometry, Provenance, SensorInfo
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import Passes

START_NS = 1_700_000_000_123_456_789
ERRORS = OdometryErrors(
    position_m=0.1,
    velocity_mps=0.003,
    attitude_rad=3e-5,
    undescribed_lever_arm_m=(0.008, -0.006, 0.01),
    undescribed_boresight_rad=(1.5e-5, -2e-5, 1e-5),
)
STATED = {"boresight_sigma_rad": 3e-5, "lever_arm_sigma_m": 0.01}


@dataclass(frozen=True, eq=False)
class FlownHeights:
    """A flight.

    Attributes:
        sensor: that flew.
        images: heights of each dwell.
        fields: the same as arrays.
        odometry: of each dwell.
        truth: heights of the ground at the places of each dwell's pixels, m, were these right; NaN without a height.
    """

    sensor: Sensor
    images: list[HeightImage]
    fields: list[HeightField]
    odometry: list[list[Odometry]]
    truth: list[F64]

    @property
    def sensor_info(self) -> SensorInfo:
        return messages.sensor_to_message(self.sensor, messages.to_stamp(START_NS))

    def errors(self, fields: list[HeightField]) -> F64:
        """Median error of the heights of each dwell, m."""
        return np.array([np.nanmedian(f.first.height - t) for f, t in zip(fields, self.truth, strict=True)])


@cache
def flown_heights() -> FlownHeights:
    """Four passes of three dwells over the street."""
    preset = replace(load_preset("sal_spotlight"), scene=STREET)
    flight = replace(preset.flight, passes=Passes(4, 120.0), odometry_rate_hz=1000.0)
    preset = replace(preset, dwells=12, flight=flight, impairments=Impairments(odometry=ERRORS))
    flown, exact = flight_of(preset, 1), flight_of(replace(preset, impairments=Impairments()), 1)
    ml = ESTIMATORS["ml"]
    image = ImageSettings(air="none", rows=184, cols=12, **STATED)
    looks = ml.settings(range_looks=2, azimuth_looks=2)
    images, fields, odometry, truth = [], [], [], []
    for number in range(preset.dwells):
        pair = []
        for one in (flown, exact):
            slc = Compressor().add(one.phase_history(number), one.track(number), one.sensor, image)
            assert slc
            pair.append((slc, heights(slc, one.sensor, ml, looks)))
        (slc, field), (_, right) = pair
        stamp = messages.to_stamp(START_NS + flown.dwell_start_ns(number))
        source = ComplexImage(dwell=number)
        source.header.frame_id, source.header.stamp = "map", stamp
        values = {**dict(image), **messages.autofocus_values(slc)}
        provenance = Provenance(
            config_hash=flown.sensor.config_hash, parameters=messages.with_stage([], "sar_compression", values)
        )
        images.append(messages.height_to_message(field, slc.aperture, (2, 2), "ml", source, provenance))
        fields.append(field)
        truth.append(right.first.height)
        odometry.append(
            [
                messages.state_to_message(state, messages.to_stamp(START_NS + state.stamp_ns))
                for state in flown.platform_states(number)
            ]
        )
    return FlownHeights(flown.sensor, images, fields, odometry, truth)
