"""The settings on which the error of the pose of images rests, as the provenance of heights states them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sal_height.engine.air import USED_AIR
from sal_height.engine.track import ACCURACY, OdometrySettings
from sal_height.imaging import MEASURED_AIR, VACUUM, CorrectionSettings
from sal_height.settings import settings_of


class PoseSettings(OdometrySettings, CorrectionSettings):
    """Settings of the compression that state errors of the pose."""


def pose_settings(stated: Mapping[str, Any]) -> PoseSettings:
    """The settings of the compression that made images, with the air of messages if it used that.

    Odometry, its gaps, ranges and clocks are exact in recordings of before there were parameters for their errors.

    Args:
        stated: values of the compression in a provenance, by name.

    Raises:
        UserError: a value is not allowed.
    """
    exact = *ACCURACY, "acceleration_noise", "turning_noise", "range_sigma_m", "sample_clock_sigma"
    prefix = f"{USED_AIR}."
    air = {name.removeprefix(prefix): value for name, value in stated.items() if name.startswith(prefix)}
    values = {"air": VACUUM, **dict.fromkeys(exact, 0.0), **stated, **({"air": MEASURED_AIR, **air} if air else {})}
    return PoseSettings(**{name: values[name] for name in settings_of(PoseSettings) if name in values})
