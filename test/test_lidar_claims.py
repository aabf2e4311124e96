"""What the SAL paper says of bias, moving targets and turned detectors, against closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from chain_fixture import Chain
from helpers import flat_scene
from scipy.special import erf

from sal_height import messages
from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import column_squint
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import Trajectory
from sal_height.geometry.earth import sphere_coordinates
from sal_height.geometry.frames import look_direction
from sal_height.imaging import ImageSettings, Slc
from sal_height.nodes.transport.graph import Graph
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor.sensor import PhaseHistory, Sensor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.lit_surfaces import truth_image
from sal_height.simulation.preset import Preset, load_preset
from sal_height.simulation.receiver_noise import receiver_noise
from sal_height.simulation.scene import PointScatterer, VisibleSurface

Array = npt.NDArray[np.float64]

REACH, SPEED = 5000.0, 50.0
BEAMWIDTH = 1.55e-4
ACROSS = REACH * np.sin(np.pi / 4)
"""Change of height with elevation, m/rad."""


def small(cnr_db: float, **sensor: Any) -> Preset:
    """The small preset with another CNR and other keys of the sensor."""
    preset = load_preset("small")
    return replace(preset, cnr_db=cnr_db, sensor=replace(preset.sensor, **sensor))


class DarkFlight(SimulatedFlight):
    """A flight over dark ground with bright points; what is dark costs no time."""

    def _visible(self, *arguments: Any, **options: Any) -> VisibleSurface:
        surface = super()._visible(*arguments, **options)
        bright = surface.power > 0
        return VisibleSurface(*(getattr(surface, field.name)[bright] for field in fields(surface)))


def images_of(flight: SimulatedFlight, sensor: Sensor, settings: ImageSettings) -> Iterator[Slc]:
    """Images of all dwells of a flight, focused as those of the sensor as it is described."""
    compressor, states = Compressor(), []
    for dwell in range(flight.dwells):
        states += flight.platform_states(dwell)
        slc = compressor.add(flight.phase_history(dwell), Trajectory(states), sensor, settings)
        if slc:
            yield slc


def heights_of(slc: Slc, sensor: Sensor, estimator: str, **settings: Any) -> HeightField:
    one = ESTIMATORS[estimator]
    return heights(slc, sensor, one, one.settings(**settings))


# (a) Bias against CNR. Two detectors a beamwidth apart behind a square aperture: mu = 2 t exactly, t in beamwidths.

BIAS_IMAGE = ImageSettings(
    air="none", azimuth_window="rectangular", rows=42, cols=16
)  # elevations of +-0.3, squints of +-0.25 beamwidths
BIAS_LOOKS = {"range_looks": 2, "azimuth_looks": 8, "sidelobe_rate": 1.0}
BIAS_DWELLS = 6
CLEAR_DB = 100.0


@cache
def bias_flight() -> SimulatedFlight:
    """Dwells over level ground whose noise is CLEAR_DB below the echoes."""
    keys = {"detectors": 2, "pitch_beamwidths": 1.0, "pattern": "sinc", "pulse_count": 96}
    preset = small(CLEAR_DB, bandwidth_hz=16e9, sample_count=128, **keys)
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(), BIAS_DWELLS, seed=6)


@cache
def bias_dwell(dwell: int) -> tuple[PhaseHistory, Trajectory, Array]:
    """Echoes of a dwell, its track, and the true elevations (beamwidths) of its height pixels, whatever the CNR."""
    flight = bias_flight()
    history = flight.phase_history(dwell)
    track = Trajectory([state for number in range(dwell + 1) for state in flight.platform_states(number)])
    slc = Compressor().add(history, track, flight.sensor, BIAS_IMAGE)
    assert slc
    grid = heights_of(slc, flight.sensor, "monopulse", **BIAS_LOOKS).grid
    truth = truth_image(flight.surface(dwell), slc.aperture, grid, 1.0, flight.sensor.beams)
    return history, track, (truth.elevation - np.pi / 4) / BEAMWIDTH


@cache
def bias_images(cnr_db: float) -> list[Slc]:
    """Images of all dwells at a CNR."""
    rng, sensor = np.random.default_rng(round(cnr_db)), bias_flight().sensor
    images = []
    for history, track, _ in map(bias_dwell, range(BIAS_DWELLS)):
        noise = receiver_noise(sensor, sensor.pulse_count, rng)
        samples = (10 ** ((cnr_db - CLEAR_DB) / 20) * history.samples + noise).astype(np.complex64)
        images += [Compressor().add(replace(history, samples=samples), track, sensor, BIAS_IMAGE)]
    return images


def pairs_of_discriminants(discriminant: str, cnr_db: float) -> tuple[Array, Array, Array]:
    """True and estimated mu of level ground, and the CNR of Sigma, in the valid pixels of all dwells."""
    sensor = bias_flight().sensor
    true, found, cnr = [], [], []
    for dwell, slc in enumerate(bias_images(cnr_db)):
        t = bias_dwell(dwell)[2]
        field = heights_of(slc, sensor, "monopulse", discriminant=discriminant, **BIAS_LOOKS)
        squint = column_squint(field.grid, slc.aperture, sensor.beams, sensor.look_side)
        columns = squint[None, :] / BEAMWIDTH + (np.arange(8) - 3.5)[:, None] / 32
        passed = np.mean(np.sinc(columns) ** 2, axis=0)
        both = np.cos(np.pi * t) / (np.pi * (0.25 - t**2))  # Sigma of a point of amplitude 1
        valid = np.isfinite(field.first.height)
        assert valid.mean() > 0.9
        true.append(2 * t[valid])
        found.append(2 * (t + field.first.height / ACROSS / BEAMWIDTH)[valid])
        cnr.append((10 ** (cnr_db / 10) * passed * both**2 / 2)[valid])
    return np.concatenate(true), np.concatenate(found), np.concatenate(cnr)


@pytest.mark.parametrize("cnr_db", [6.0, 10.0, 16.0])
def test_ratio_is_drawn_to_the_middle_of_the_pair_by_its_cnr(cnr_db: float) -> None:
    """E mu = kappa C / (C + 1) however many looks, with C the CNR of Sigma (SAL paper, section 3; Kanter 1977)."""
    true, found, cnr = pairs_of_discriminants("ratio", cnr_db)
    shrunk = true * cnr / (cnr + 1)
    slope = found @ true / (true @ true)
    expected = shrunk @ true / (true @ true)
    standard_error = np.std(found - shrunk) / np.sqrt(true @ true)
    assert standard_error < 0.02
    assert slope == pytest.approx(expected, abs=3.5 * standard_error)


@pytest.mark.parametrize("cnr_db", [6.0, 10.0, 16.0])
@pytest.mark.parametrize("discriminant", ["tls", "noise_subtraction"])
def test_estimates_that_know_of_the_noise_are_not(discriminant: str, cnr_db: float) -> None:
    """Medians, as means do not exist; of n a standard error of 1.25 / sqrt(n), with half the width of 68 %."""
    true, found, cnr = pairs_of_discriminants(discriminant, cnr_db)
    outwards = (found - true) * np.sign(true)
    standard_error = 1.25 * np.ptp(np.percentile(outwards, [16, 84])) / 2 / np.sqrt(len(true))
    attenuated = np.median(np.abs(true) / (cnr + 1))
    assert abs(np.median(outwards)) < 3.5 * standard_error
    assert cnr_db > 10 or attenuated > 5 * standard_error


# (b) A mover, seen by Gaussian beams: their ratios depend on the place along the detector axis alone.

PSI = np.radians(15.0)
RADIAL = 2.5e-3
CELL = 1.55e-6 * REACH / (2 * 0.08)  # azimuth resolution, m
SHOWN_AT = -3 * CELL
OFFSET = 0.3  # beamwidths above the middle of the array
SINGLE_LOOKS = {"range_looks": 1, "azimuth_looks": 1}
MOVER_IMAGE = ImageSettings(air="none", azimuth_window="rectangular", rows=47, cols=13)  # with a pixel in the middle


@cache
def mover_flight() -> SimulatedFlight:
    """One dwell on a single target that appears in the middle of a pixel, and is RADIAL / SPEED of range ahead."""
    preset = small(75.0, pattern="gaussian", detector_rotation_rad=PSI)
    flight = DarkFlight(preset, preset.make_sensor(), flat_scene(), dwells=1, seed=22)
    ahead = SHOWN_AT + REACH * RADIAL / SPEED
    place = flight.aperture(0).position + REACH * look_direction(np.pi / 4 + OFFSET * BEAMWIDTH, ahead / REACH, 1)
    east, north, height = (float(value) for value in sphere_coordinates(place))
    target = PointScatterer(east, north, height, 1.0, radial_velocity=RADIAL)
    dark = replace(flight.scene, brightness=np.zeros_like(flight.scene.brightness), points=(target,))
    return replace(flight, scene=dark)


@cache
def mover_images() -> list[Slc]:
    return list(images_of(mover_flight(), mover_flight().sensor, MOVER_IMAGE))


def sinc_peak(profile: npt.NDArray[np.complexfloating]) -> float:
    """Place in pixels of the sinc, as wide as a pixel, that fits the moduli best."""
    pixels, places = np.arange(len(profile)), np.arange(0, len(profile) - 1, 1e-3)
    shapes = np.abs(np.sinc(pixels - places[:, None]))
    fit = (shapes @ np.abs(profile)) ** 2 / np.sum(shapes**2, axis=1)
    return float(places[np.argmax(fit)])


@pytest.mark.parametrize("estimator", ["ml", "monopulse"])
@pytest.mark.parametrize("known", [0.0, RADIAL], ids=["taken for still", "velocity known"])
def test_mover_appears_behind_its_place_and_with_turned_detectors_at_another_height(
    estimator: str, known: float
) -> None:
    """Its squint is taken as smaller by v_r / v, so its elevation comes out higher by tan(psi) times that.

    For on the detector axis it is at x cos(psi) + y sin(psi), which is what the ratios tell.
    """
    flight = mover_flight()
    target = flight.scene.points[0]
    (slc,) = mover_images()

    row, col = 23, 3
    image = slc.images[4]
    assert np.unravel_index(np.argmax(np.abs(image)), image.shape) == (row, col)
    shown = (sinc_peak(image[row]) - 6) * CELL
    assert shown - target.east == pytest.approx(-REACH * RADIAL / SPEED, abs=5e-5)

    surface = heights_of(slc, flight.sensor, estimator, **SINGLE_LOOKS, radial_velocity_mps=known).first
    missing = (RADIAL - known) / SPEED
    error, expected = surface.height[row, col] - target.height, ACROSS * missing * np.tan(PSI)
    assert error == pytest.approx(expected, abs=3e-4)  # of 47 mm
    assert surface.positions[row, col, 0] - target.east == pytest.approx(-REACH * missing, abs=5e-5)


STRIP_IMAGE = ImageSettings(air="none", azimuth_window="rectangular", rows=47)


@cache
def strip_flight() -> SimulatedFlight:
    """A strip with a single target at the reference range, in the elevation of the one in `mover_flight`."""
    preset = small(75.0, pattern="gaussian", detector_rotation_rad=PSI, mode="stripmap", pulse_count=256)
    preset = replace(preset, flight=replace(preset.flight, dwell_spacing_m=None))
    flight = DarkFlight(preset, preset.make_sensor(), flat_scene(), dwells=5, seed=24)
    abeam = flight.aperture(2).position * np.array([0.0, 1.0, 1.0])
    place = abeam + REACH * look_direction(np.pi / 4 + OFFSET * BEAMWIDTH, 0.0, 1)
    east, north, height = (float(value) for value in sphere_coordinates(place))
    target = PointScatterer(east, north, height, 1.0, radial_velocity=RADIAL)
    dark = replace(flight.scene, brightness=np.zeros_like(flight.scene.brightness), points=(target,))
    return replace(flight, scene=dark)


@cache
def strip_images() -> list[Slc]:
    return list(images_of(strip_flight(), strip_flight().sensor, STRIP_IMAGE))


def gaussian_passage(offset: npt.ArrayLike, squint: float) -> Array:
    """Amplitudes, up to a factor, of eight turned Gaussian beams, averaged over a passage about a squint (beamwidths).

    Of squared widths the Gaussian has the sum: x - s cos(psi) across, and y - s sin(psi) along, for a detector at s.
    """
    steps, width = (np.arange(8) - 3.5) / 2, GAUSSIAN_WIDTH
    low, high = (erf((squint + end - steps * np.sin(PSI)) / (np.sqrt(2) * width)) for end in (-0.5, 0.5))
    across = np.exp(-((np.asarray(offset)[..., None] - steps * np.cos(PSI)) ** 2) / (2 * width**2))
    return np.asarray(across * (high - low))


@pytest.mark.parametrize("known", [0.0, RADIAL], ids=["taken for still", "velocity known"])
def test_mover_in_a_strip_is_elsewhere_and_higher_unless_its_velocity_is_known(known: float) -> None:
    """In stripmap its passage is off the beams' middle by v_r / v, in every detector by another share."""
    flight = strip_flight()
    slc = max(strip_images(), key=lambda one: float(np.abs(one.images[4]).max()))
    row, col = np.unravel_index(np.argmax(np.abs(slc.images[4])), slc.images[4].shape)
    assert row == 23
    surface = heights_of(slc, flight.sensor, "ml", **SINGLE_LOOKS, radial_velocity_mps=known).first
    target, missing = flight.scene.points[0], (RADIAL - known) / SPEED
    east = surface.positions[row, col, 0]
    assert east - target.east == pytest.approx(-REACH * missing, abs=8e-3)  # of pixels of 5 mm

    seen, others = gaussian_passage(OFFSET, RADIAL / SPEED / BEAMWIDTH), np.arange(-1.0, 1.5, 1e-4)
    trial = gaussian_passage(others, known / SPEED / BEAMWIDTH)
    taken = others[np.argmax((trial @ seen) ** 2 / np.sum(trial**2, axis=-1))]
    expected = ACROSS * (taken - OFFSET) * BEAMWIDTH
    assert expected == pytest.approx(0, abs=1e-9) if known else expected > 0.03
    error = surface.height[row, col] - target.height
    assert error == pytest.approx(expected, abs=3e-3)  # the pixel is up to 2.5 mm off the peak


# (c) Turned detectors over level ground.


@cache
def level_flight() -> SimulatedFlight:
    preset = small(25.0, pattern="gaussian", detector_rotation_rad=PSI)
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(1.0), dwells=4, seed=23)


@cache
def level_images(described: float) -> list[Slc]:
    flight = level_flight()
    return list(images_of(flight, turned(flight.sensor, described), LEVEL_IMAGE))


def turned(sensor: Sensor, described: float) -> Sensor:
    """The sensor described with another rotation of its detectors."""
    return replace(sensor, detector_rotation=described, config_hash="")


LEVEL_IMAGE = ImageSettings(air="none", azimuth_window="rectangular", rows=46, cols=12)


@pytest.mark.parametrize("estimator", ["ml", "monopulse"])
@pytest.mark.parametrize("described", [PSI, 0.0], ids=["described", "unknown"])
def test_level_ground_tilts_when_the_rotation_of_the_detectors_is_not_known(estimator: str, described: float) -> None:
    """At squint y and elevation x it is taken to be at x cos(psi) + y sin(psi): along the flight it rises by
    sin(look angle) sin(psi).
    """
    flight = level_flight()
    sensor = turned(flight.sensor, described)
    errors, predictions, places = [], [], []
    for dwell, slc in enumerate(level_images(described)):
        field = heights_of(slc, sensor, estimator)
        grid, height = field.grid, field.first.height
        truth = truth_image(flight.surface(dwell), slc.aperture, grid, 1.0, flight.sensor.beams)
        squint = column_squint(grid, slc.aperture, sensor.beams, sensor.look_side)
        x, y = truth.elevation - np.pi / 4, np.broadcast_to(squint, grid.shape)
        valid = np.isfinite(height) & (np.abs(x) < 1.2 * BEAMWIDTH)
        taken = x if described else x * np.cos(PSI) + y * np.sin(PSI)
        errors.append((height - truth.height)[valid])
        predictions.append((ACROSS * (taken - x))[valid])
        places.append((y * REACH)[valid])
    error, prediction, place = (np.concatenate(values) for values in (errors, predictions, places))
    left = error - prediction
    standard_error = np.std(left) / np.sqrt(len(left))
    place -= place.mean()
    slope, slope_error = error @ place / (place @ place), np.std(left) / np.sqrt(place @ place)
    expected = 0.0 if described else np.sin(np.pi / 4) * np.sin(PSI)
    assert standard_error < 2e-3
    assert abs(left.mean()) < 3.5 * standard_error
    assert slope == pytest.approx(expected, abs=3.5 * slope_error)
    assert slope_error < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_the_nodes_make_the_same_heights(graph: Graph, mode: str) -> None:
    """So that the claims above hold for them, too."""
    spotlight = mode == "spotlight"
    flight, image = (mover_flight(), MOVER_IMAGE) if spotlight else (strip_flight(), STRIP_IMAGE)
    slc = (mover_images() if spotlight else strip_images())[-1]
    looks = {**SINGLE_LOOKS, "radial_velocity_mps": RADIAL}
    size = {"rows": image.rows, "cols": image.cols, "azimuth_window": image.azimuth_window}
    chain = Chain(graph, flight, missing_after_s=20.0, image=size, heights=looks)
    chain.publish(chain.sensor_info())
    for dwell in range(flight.dwells):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
    chain.await_heights(flight.dwells - 1)
    for estimator in ("ml", "monopulse"):
        ours = heights_of(slc, flight.sensor, estimator, **looks).first.height
        theirs = messages.float_view(chain.heights[estimator, flight.dwells - 1].surfaces[0].height, ours.shape)
        np.testing.assert_array_equal(theirs, ours.astype(np.float32))
        assert np.any(np.isfinite(ours))
