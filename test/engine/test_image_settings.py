"""Settings of images, as the provenance of heights states them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import refused

from sal_height.engine.compression import CompressionSettings
from sal_height.engine.image_settings import pose_settings
from sal_height.engine.provenance import Provenance
from sal_height.errors import UserError
from sal_height.geometry import EXACT, NOT_STATED, Motion, OdometryAccuracy


def test_settings_are_those_that_the_provenance_states() -> None:
    stated = {"acceleration_noise": 0.3, "odometry_interval_s": 0.1, "odometry_heading_sigma_rad": 0.02, "air": "none"}
    settings = pose_settings(dict(CompressionSettings(**stated)))
    assert settings.motion == Motion(0.3, NOT_STATED, 0.1)
    assert settings.accuracy == OdometryAccuracy(heading_rad=0.02)
    assert (settings.air, settings.range_sigma_m) == ("none", -1.0)


def test_a_recording_without_parameters_of_errors_has_none() -> None:
    """It is of before there were such parameters."""
    settings = pose_settings({"rows": 20})
    assert settings.accuracy == EXACT
    assert not settings.motion.variances(1.0, 1.0).any()
    assert (settings.air, settings.range_sigma_m, settings.sample_clock_sigma) == ("none", 0.0, 0.0)


def test_air_that_messages_stated_is_measured_air() -> None:
    received = {"air_temperature_k": 285.0, "air_pressure_pa": 1e5}
    provenance = Provenance().derived("sar_compression", {"air": "topics", "heard_air": received})
    settings = pose_settings(provenance.compression)
    assert (settings.air, settings.air_temperature_k, settings.air_pressure_pa) == ("measured", 285.0, 1e5)


@pytest.mark.parametrize("wrong", ["unknown", np.nan, -2.0])
def test_a_value_that_is_not_allowed_is_refused(wrong: object) -> None:
    with refused(UserError, "turning_noise"):
        pose_settings({"turning_noise": wrong})
