"""What speaks against a dwell is in all that is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driven import accept, drive
from flown_items import SMALL, flight_items, heights_in, made, ml_stage, small_flight

from sal_height.adjustment import References
from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.chain import Chain
from sal_height.engine.compression import Compression, CompressionSettings
from sal_height.engine.flight_adjuster import FlightAdjuster
from sal_height.engine.frame_items import Frame
from sal_height.engine.height_items import Heights
from sal_height.engine.results import Notice, Product
from sal_height.pipeline.beam_errors import BEAMS
from sal_height.pipeline.instrument import INSTRUMENT
from sal_height.sensor import NOTHING_STATED
from sal_height.topics import ODOMETRY, PHASE_HISTORY, SENSOR_INFO


def test_heights_have_the_doubts_about_their_images() -> None:
    flight, settings = small_flight(), CompressionSettings(**{**SMALL, "odometry_velocity_sigma_mps": -1.0})
    absurd = {"velocity_covariance": np.full((3, 3), np.nan)}
    items = flight_items(flight, dwells=[0])
    items = [(port, replace(item, **absurd) if port == ODOMETRY else item) for port, item in items]
    ml = ml_stage()
    found = made([Compression(settings), ml], [settings, type(ml).settings()], items, "ml/height")
    heights: Heights = found[0]
    assert [doubt.name for doubt in heights.doubts] == ["odometry of unknown accuracy"]
    assert "standard deviations of velocity 0.05 m/s." in heights.doubts[0].sentence


def test_odometry_that_states_nothing_is_warned_of_in_every_dwell() -> None:
    """And in none if parameters say that it is exact."""
    flight = small_flight()
    items = [accept(*item) for item in flight_items(flight, dwells=[0, 1])]
    warned = drive(Compression(CompressionSettings(rows=20, cols=8)), items)
    assert warned.warned() == {"odometry of unknown accuracy": 2}
    assert warned.notices[0].sentence.startswith("Dwell 0: The odometry does not state how well")
    assert drive(Compression(CompressionSettings(**SMALL)), items).warned() == {}


def test_the_adjustment_counts_what_is_assumed_as_stated() -> None:
    """And odometry as exact if the provenance of heights states no accuracy, as before it could."""
    flight = small_flight()
    states = [state for port, state in flight_items(flight, dwells=[0, 1]) if port == ODOMETRY]
    sigmas = []
    for stated in (CompressionSettings(rows=20, cols=8), CompressionSettings(**SMALL), {}):
        heights = heights_in(flight, **SMALL)[0]
        heights = replace(heights, provenance=heights.provenance.derived("sar_compression", stated))
        adjusted = FlightAdjuster(References()).adjust(heights, flight.sensor, states, HeightAdjuster.settings())
        sigmas.append(np.sqrt(adjusted.off.covariance.diagonal()[:6]))
    # The velocity moves images by 5 m along the flight; the mounting turns by 1 mrad, as the settings have it.
    expected = np.hypot([2.0, 2.0, 2.0, 2e-3, 2e-3, 1e-2], [5.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3])
    np.testing.assert_allclose(sigmas[0], expected, rtol=0.02)
    assert np.all(sigmas[1] < 0.1)
    np.testing.assert_array_equal(sigmas[1], sigmas[2])


def test_data_that_contradict_the_description_are_a_doubt_and_a_warning() -> None:
    """Samples ten times as large as those that the description states the noise power of."""
    items = flight_items(small_flight(), dwells=[0])
    items = [(port, louder(item) if port == PHASE_HISTORY else item) for port, item in items]
    settings, ml = CompressionSettings(**{**SMALL, "rows": 46, "cols": 12}), ml_stage()
    chain = Chain([Compression(settings), ml], [settings, type(ml).settings()])
    steps = (chain.start(), *(chain.feed(*item) for item in items), chain.finish())
    results = [one.result for step in steps for one in step]
    notices = [result for result in results if isinstance(result, Notice)]
    heights = next(result.item for result in results if isinstance(result, Product) and result.port == "ml/height")
    (doubt,) = heights.doubts
    assert doubt.name == "noise level"
    assert abs(doubt.size - 20) < 1
    of_dwell = ["noise over range", "interference", "correlated noise", "beam stretch"]
    names = ["noise level", *["channel gain"] * 8, *of_dwell, *["noise of channel"] * 8]
    assert [test.name for test in heights.fit] == names
    assert [(notice.kind, notice.sentence) for notice in notices] == [("noise level", f"Dwell 0: {doubt.sentence}")]


def test_images_and_heights_have_the_doubt_about_an_emitter() -> None:
    """Its frequency is in all pulses and channels, as strong as the noise of all frequencies."""
    flight = small_flight()
    noise = float(np.mean(flight.sensor.noise_power))
    items = [
        (port, disturbed(item, 10 * noise) if port == PHASE_HISTORY else item)
        for port, item in flight_items(flight, dwells=[0])
    ]
    ml, settings = ml_stage(), CompressionSettings(**SMALL)
    chosen = [settings, type(ml).settings()]
    found = made([Compression(settings), ml], chosen, items, "ml/height")
    heights: Heights = found[0]
    assert "narrow-band interference" in [doubt.name for doubt in heights.doubts]
    drawn = drive(Compression(settings), [accept(*item) for item in items])
    assert drawn.warned() == {"narrow-band interference": 1}


def disturbed(frame: Frame, power: float) -> Frame:
    """The frame with an emitter of that mean power over its samples in frequency 20."""
    samples = frame.samples.view(np.complex64).copy()
    count = samples.shape[-1]
    samples[..., 20] += np.float32(np.sqrt(power * count))
    return frame._replace(samples=samples.view(np.uint8).reshape(frame.samples.shape))


def louder(frame: Frame) -> Frame:
    """The frame with samples of ten times the amplitude."""
    return frame._replace(samples=(np.float32(10) * frame.samples.view(np.float32)).view(np.uint8))


def test_heights_say_what_is_assumed_of_their_instrument_and_beams() -> None:
    """Images have the one, heights both; the description of the preset is exact, and has neither."""
    flight, settings = small_flight(), CompressionSettings(**SMALL)
    sensor = replace(flight.sensor, uncertainty=NOTHING_STATED)
    items = [(port, sensor if port == SENSOR_INFO else item) for port, item in flight_items(flight, dwells=[0])]
    ml = ml_stage()
    chosen = [settings, type(ml).settings()]
    found = made([Compression(settings), ml], chosen, items, "ml/height")
    heights: Heights = found[0]
    assert [doubt.name for doubt in heights.doubts] == [INSTRUMENT, BEAMS]
    assert "boresight" not in heights.doubts[0].sentence  # the mounting is that of the preset
    known = made([Compression(settings), ml_stage()], chosen, flight_items(flight, dwells=[0]), "ml/height")
    assert known[0].doubts == ()


def test_adjusted_heights_keep_what_is_not_known_of_range_and_air() -> None:
    """No comparison of dwells shows it; parameters of before there were such errors say that it is exact."""
    flight = small_flight()
    states = [state for port, state in flight_items(flight, dwells=[0, 1]) if port == ODOMETRY]
    heights = heights_in(flight, **SMALL)[0]
    found = []
    received = {"air_temperature_k": 285.0, "air_pressure_pa": 1e5, "air_height_m": 100.0}
    measured = {"air": "topics", "heard_air": received}
    for changed in ({}, {"range_sigma_m": 0.3}, {"air": "standard"}, {"air": "measured"}, measured):
        stated = {**dict(CompressionSettings(**SMALL)), **changed}
        told = replace(heights, provenance=heights.provenance.derived("sar_compression", stated))
        adjusted = FlightAdjuster(References()).adjust(told, flight.sensor, states, HeightAdjuster.settings())
        pixels = adjusted.field.first.common_covariance
        assert pixels is not None
        found.append((adjusted.aperture.covariance, pixels, adjusted.field.first.sigma))
    (exact, of_exact, sigma), (late, of_late, greater), *airs = found
    slant_range = flight.preset.flight.slant_range_m
    assert np.trace(late - exact) == pytest.approx(0.3**2, rel=1e-6)
    up = of_late[..., 2, 2] - of_exact[..., 2, 2]
    seen = np.isfinite(up)
    look = np.cos(flight.preset.flight.look_angle_rad)
    np.testing.assert_allclose(up[seen], (0.3 * look) ** 2, rtol=0.02)
    np.testing.assert_allclose(greater[seen] ** 2 - sigma[seen] ** 2, up[seen], rtol=1e-3)
    for aperture, *_ in airs:
        # 10 K of 1.3 m of delay; the map's height may be off by 100 m.
        assert 1e-6 * slant_range < np.sqrt(np.trace((aperture - exact)[:3, :3])) < 1e-4 * slant_range
