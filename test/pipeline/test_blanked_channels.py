"""Receivers that are blanked over part of the swath: every row of heights from the channels that receive it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import assert_one_sentence

from sal_height.elevation import ESTIMATORS, Validity
from sal_height.errors import Rejected, UserError
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, channel_sets, heights
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.preset import BlankedRange

BLANKED = ((2, 4999.0, 4999.6), (3, 4999.0, 4999.6), (6, 4999.5, 5000.4), *((m, 5000.9, 5001.3) for m in range(7)))
"""Of preset small: rows without channels 2 and 3, then without these and 6, without 6, and with channel 7 alone."""


@pytest.fixture(scope="module")
def blanked() -> tuple[Sensor, Slc]:
    """The sensor and the images of a dwell."""
    preset = load_preset("small")
    ranges = tuple(BlankedRange(*one) for one in BLANKED)
    preset = replace(preset, dwells=1, sensor=replace(preset.sensor, blanked_ranges=ranges))
    flight, size = flight_of(preset, seed=1), preset.image
    slc = Compressor().add(
        flight.phase_history(0),
        flight.track(0),
        flight.sensor,
        ImageSettings(air="none", rows=size.rows, cols=size.cols),
    )
    assert slc
    return flight.sensor, slc


def made(slc: Slc, sensor: Sensor, estimator: str) -> HeightField:
    entry = ESTIMATORS[estimator]
    return heights(slc, sensor, entry, entry.settings(range_looks=2, azimuth_looks=2))


def test_simulated_channels_receive_nothing_where_they_are_blanked(blanked: tuple[Sensor, Slc]) -> None:
    """Two cells inside the range what is left is the response of cells beside it: -20 dB of the mean."""
    sensor, slc = blanked
    slant_range = 5000.0 + (np.arange(slc.grid.rows) - (slc.grid.rows - 1) / 2) * slc.grid.row_spacing
    power = np.mean(np.abs(slc.images) ** 2, axis=-1)
    for channel, first, last in sensor.blanked_ranges:
        inside = (slant_range > first + 0.15) & (slant_range < last - 0.15)
        assert inside.any()
        assert power[channel, inside].max() < 0.01 * power[channel].mean()


@pytest.mark.parametrize("estimator", ["ml", "monopulse"])
def test_rows_are_those_of_their_channels_alone(blanked: tuple[Sensor, Slc], estimator: str) -> None:
    """Value for value, of images in which the others are dead."""
    sensor, slc = blanked
    field = made(slc, sensor, estimator)
    sets = channel_sets(slc, sensor, ESTIMATORS[estimator].settings(range_looks=2).windows[0])
    assert [channels.tolist() for channels, _ in sets] == [
        [0, 1, 4, 5, 7],
        [0, 1, 4, 5, 6, 7],
        [0, 1, 2, 3, 4, 5, 7],
        [0, 1, 2, 3, 4, 5, 6, 7],
    ]
    for channels, rows in sets:
        images = np.zeros_like(slc.images)
        images[channels] = slc.images[channels]
        alone = made(replace(slc, images=images), replace(sensor, blanked_ranges=()), estimator)
        np.testing.assert_array_equal(field.validity[rows], alone.validity[rows])
        for surface, expected in zip(field.surfaces, alone.surfaces, strict=True):
            np.testing.assert_array_equal(surface.height[rows], expected.height[rows])
            np.testing.assert_array_equal(surface.sigma[rows], expected.sigma[rows])
            np.testing.assert_array_equal(surface.positions[rows], expected.positions[rows])
        assert np.any(field.validity[rows] == Validity.OK)


def test_rows_of_a_single_channel_are_missing(blanked: tuple[Sensor, Slc]) -> None:
    sensor, slc = blanked
    field = made(slc, sensor, "ml")
    rows = ~np.any([rows for _, rows in channel_sets(slc, sensor, ESTIMATORS["ml"].settings().windows[0])], axis=0)
    assert 2 < np.count_nonzero(rows) < 8
    assert np.all(field.validity[rows] == Validity.MISSING_DATA)
    assert np.isnan(field.first.height[rows]).all()
    assert np.isnan(field.first.positions[rows]).all()


def test_a_sensor_blanked_everywhere_is_refused(blanked: tuple[Sensor, Slc]) -> None:
    sensor, slc = blanked
    nothing = replace(sensor, blanked_ranges=tuple((m, 0.0, 1e6) for m in range(1, 8)))
    with pytest.raises(Rejected, match="blanked_ranges") as refused:
        made(slc, nothing, "ml")
    assert_one_sentence(str(refused.value), "2 channels or more")


def test_the_channels_of_a_hybrid_are_needed_together(blanked: tuple[Sensor, Slc]) -> None:
    """Without channel 0 the detectors cannot be separated: its rows have no heights, the others do."""
    sensor, slc = blanked
    mixing = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 8)))[0].astype(np.complex128)
    mixed = replace(sensor, channel_matrix=tuple(map(tuple, mixing.tolist())), blanked_ranges=((0, 4999.0, 4999.6),))
    ((channels, rows),) = channel_sets(slc, mixed, ESTIMATORS["ml"].settings().windows[0])
    assert len(channels) == 8
    assert 0 < np.count_nonzero(~rows) < 10


@pytest.mark.parametrize("wrong", [(8, 0.0, 1.0), (-1, 0.0, 1.0), (0, 2.0, 1.0), (0, -1.0, 1.0), (0, 0.0, np.inf)])
def test_wrong_ranges_are_refused(blanked: tuple[Sensor, Slc], wrong: tuple[int, float, float]) -> None:
    with pytest.raises(UserError) as refused:
        replace(blanked[0], blanked_ranges=(wrong,))
    assert_one_sentence(str(refused.value), "blanked_ranges", "channels 0 to 7")
