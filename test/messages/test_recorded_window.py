"""The azimuth window that images were made with, by their provenance: stripmap beams depend on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import elevation_at, make_sensor

from sal_height import messages
from sal_height.imaging.pixels import image_beams
from sal_height.messages.types import Parameter, Provenance

ELEVATION = elevation_at(np.linspace(-1, 1, 5))
STRIP = make_sensor(mode="stripmap", detector_rotation=0.26, pulse_repetition_frequency=20e3)


def made_with(window: object, stage: str = "sar_compression") -> list[Parameter]:
    return messages.with_stage([], stage, {"azimuth_window": window})


def test_spotlight_has_the_beams_of_the_sensor() -> None:
    sensor = replace(STRIP, mode="spotlight", config_hash="")
    assert image_beams(sensor, "hamming") is sensor.beams


@pytest.mark.parametrize(
    ("provenance", "window"),
    [
        (made_with("hamming"), "hamming"),
        (made_with("taylor"), "taylor"),
        (made_with("rectangular"), "rectangular"),
        (made_with("unheard of"), "rectangular"),
        (made_with(["hamming"]), "rectangular"),
        (made_with(7), "rectangular"),
        ([], "rectangular"),
        (made_with("hamming", stage="other"), "rectangular"),
    ],
)
def test_stripmap_averages_with_the_window_that_the_image_was_made_with(
    provenance: list[Parameter], window: str
) -> None:
    recorded = messages.recorded_window(Provenance(parameters=provenance), "azimuth")
    assert recorded == window
    seen = image_beams(STRIP, recorded).response(ELEVATION, 0.0)
    np.testing.assert_array_equal(seen, image_beams(STRIP, window).response(ELEVATION, 0.0))
    others = {"hamming", "taylor", "rectangular"} - {window}
    assert all(np.abs(seen - image_beams(STRIP, o).response(ELEVATION, 0.0)).max() > 1e-4 for o in others)
