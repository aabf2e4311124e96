"""Movers in simulated strips: found without being told their velocity, with place, height and sigmas that are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.errors import UserError
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.movers import Looked, Mover, MoverSettings
from sal_height.pipeline import Compressor, movers
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import PointScatterer

EAST, NORTH, HEIGHT = 0.05, 1.0, 1.0


def strip(seed: int, *points: PointScatterer, dwells: int = 4) -> tuple[SimulatedFlight, list[Slc]]:
    """The street of sal_stripmap with other targets, and its images."""
    preset = replace(load_preset("sal_stripmap"), dwells=dwells)
    flight = flight_of(preset, seed)
    flight = replace(flight, scene=replace(flight.scene, points=points))
    settings = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
    compressor, states, images = Compressor(), [], []
    for dwell in range(dwells):
        states += flight.platform_states(dwell)
        slc = compressor.add(flight.phase_history(dwell), Trajectory(states), flight.sensor, settings)
        images += [slc] if slc else []
    return flight, images


def looked(seed: int, *points: PointScatterer, rate: float = 1e-2) -> list[Looked]:
    flight, images = strip(seed, *points)
    return [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=rate)) for slc in images]


def mover(radial: float, power_db: float, east: float = EAST) -> PointScatterer:
    return PointScatterer(east, NORTH, HEIGHT, 10 ** (power_db / 10), radial_velocity=radial)


@pytest.mark.parametrize("radial", [-7e-3, -5e-3, 4e-3, 6e-3])
def test_a_mover_gets_place_height_and_velocity(radial: float) -> None:
    """Ten times as bright as the ground: its image lies up to .7 m from it, which half of the beam's footprint is."""
    east = EAST + 100 * radial  # so that its image is in the middle of the strip
    errors = []
    for seed in range(3):
        found = [one for seen in looked(seed, mover(radial, 30.0, east)) for one in seen.movers]
        assert len(found) == 1
        (one,) = found
        truth = np.array([east, NORTH, HEIGHT, radial])
        sigmas = np.sqrt([*np.diag(one.covariance), one.velocity_sigma**2])
        errors.append(np.array([*one.position, one.radial_velocity]) - truth)
        assert np.all(np.abs(errors[-1]) < 4 * sigmas)
        assert one.height == pytest.approx(HEIGHT, abs=0.02)
        assert one.ambiguity == pytest.approx(15.5e-3)
        assert abs(one.position[0] - (east - 100 * radial)) > 0.35
    assert np.sqrt(np.mean(np.square(errors), axis=0))[0] < 0.02


def test_what_stands_still_is_none() -> None:
    """A street with a bright point; at a rate of 5 % of what is looked at, the measured one has a standard error."""
    flight, images = strip(1, PointScatterer(EAST, NORTH, HEIGHT, 1e3), dwells=5)
    seen = [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=0.05, prominence_db=8.0)) for slc in images]
    candidates = sum(one.candidates for one in seen)
    assert candidates > 20
    assert sum(len(one.movers) for one in seen) <= 0.05 * candidates + 3 * np.sqrt(0.05 * candidates)


def test_slow_ones_are_not_told() -> None:
    """A fifth of a beamwidth cannot be told from two scatterers in a cell."""
    assert not [one for seen in looked(2, mover(1e-3, 30.0), rate=1e-3) for one in seen.movers]


def yawed(slc: Slc, stated: float) -> Slc:
    """The image by odometry that states an error of the yaw, rad."""
    return replace(slc, aperture=replace(slc.aperture, covariance=np.diag([0.0, 0, 0, 0, 0, stated**2])))


def test_the_ground_tells_where_the_beam_is() -> None:
    """Odometry that may be off by a beamwidth: velocity is that over the ground's, whose lag is known to a tenth."""
    flight, images = strip(0, mover(5e-3, 30.0, EAST + 0.5))
    width = flight.sensor.beams.track_beamwidth
    found: list[Mover] = []
    for slc in images:
        seen = movers(yawed(slc, width), flight.sensor, MoverSettings(false_alarm_rate=1e-2))
        lag, sigma = seen.ground_lag
        assert abs(lag) < 4 * sigma
        assert 0 < sigma < 0.1 * width
        found += seen.movers
    (one,) = found
    assert one.radial_velocity == pytest.approx(5e-3, abs=4 * one.velocity_sigma)
    assert 1e-4 < one.velocity_sigma < 9e-4


def test_power_over_the_ground_is_told_however_bright() -> None:
    """Ten dB more are 10 dB more, within 1 dB of the ground that adds to it."""
    low, high = (
        max(one.cnr_db for seen in looked(0, mover(6e-3, power, EAST + 0.6)) for one in seen.movers)
        for power in (30.0, 40.0)
    )
    assert high - low == pytest.approx(10, abs=1)


def test_what_an_outer_beam_sees_has_no_height_and_is_not_told() -> None:
    """A mover 3 m above the highest that the beams see."""
    outside = replace(mover(6e-3, 40.0, EAST + 0.6), height=4.5)
    assert not [one for seen in looked(0, outside) for one in seen.movers if one.height > 2]


def test_pixels_without_data_do_no_harm() -> None:
    """The rows behind the mover are not there."""
    flight, images = strip(0, mover(5e-3, 30.0, EAST + 0.5))
    settings = MoverSettings(false_alarm_rate=1e-2)
    found = []
    for slc in images:
        cut = slc.images.copy()
        cut[:, 30:] = np.nan
        seen = movers(yawed(replace(slc, images=cut), 1e-5), flight.sensor, settings)
        found += seen.movers
    (one,) = found
    assert one.radial_velocity == pytest.approx(5e-3, abs=4 * one.velocity_sigma)


def test_what_cannot_be_used_is_refused() -> None:
    flight, (slc, *_) = strip(1)
    spotlight = load_preset("sal_spotlight").make_sensor()
    blanked = replace(flight.sensor, blanked_ranges=((0, 4990.0, 4999.0),))
    clipped = replace(slc, saturated_share=np.full(8, 0.01))
    narrow = replace(slc, images=slc.images[..., :15], grid=replace(slc.grid, cols=15))
    for image, sensor, said in (
        (slc, spotlight, "stripmap only"),
        (slc, blanked, "do not receive"),
        (clipped, flight.sensor, "0.01 of its samples clipped"),
        (narrow, flight.sensor, "15 columns; 16"),
    ):
        with pytest.raises(UserError, match=said):
            movers(image, sensor, MoverSettings())
