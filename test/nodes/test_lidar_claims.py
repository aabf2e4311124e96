"""What the SAL paper says of bias, moving targets and turned detectors, through the nodes, against closed forms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from chain_fixture import START_NS, Chain
from helpers import flat_scene
from sal_height_msgs.msg import ComplexImage, DetectorFrame
from scipy.special import erf

from sal_height import messages
from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import column_squint
from sal_height.geometry.earth import sphere_coordinates
from sal_height.geometry.frames import look_direction
from sal_height.nodes.graph import Graph
from sal_height.nodes.stage import FRAMES_QOS
from sal_height.sensor.phase_history import PhaseHistory
from sal_height.sensor.sensor import Sensor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import Preset, load_preset
from sal_height.simulation.scene import PointTarget
from sal_height.simulation.truth import truth_image

Array = npt.NDArray[np.float64]

REACH, SPEED = 5000.0, 50.0
BEAMWIDTH = 1.55e-4
ACROSS = REACH * np.sin(np.pi / 4)
"""Change of height with elevation, m/rad."""


def small(cnr_db: float, **sensor: Any) -> Preset:
    """The small preset with another CNR and other keys of the sensor."""
    preset = load_preset("small")
    return replace(preset, cnr_db=cnr_db, sensor=replace(preset.sensor, **sensor))


class Recorded(SimulatedFlight):
    """A flight that is simulated once for all tests."""

    @cached_property
    def _histories(self) -> dict[int, PhaseHistory]:
        return {}

    def phase_history(self, dwell: int) -> PhaseHistory:
        if dwell not in self._histories:
            self._histories[dwell] = super().phase_history(dwell)
        return self._histories[dwell]


@dataclass(frozen=True)
class Heights:
    """A height image; arrays (rows, cols), NaN where not valid. `squint` is that of the columns."""

    height: Array
    sigma: Array
    cnr_db: Array
    east: Array
    squint: Array


class Claims(Chain):
    """A chain that is told of `described`, and gets the frames of the flight; keeps the images, too."""

    def __init__(self, graph: Graph, flight: SimulatedFlight, described: Sensor, **parameters: Any) -> None:
        super().__init__(graph, replace(flight, sensor=described), missing_after_s=20.0, **parameters)
        self.truth = flight
        self.images: dict[tuple[int, int], ComplexImage] = {}
        self._feeder.create_subscription(ComplexImage, "slc", self._keep_image, FRAMES_QOS)
        self.wait(lambda: self._feeder.count_publishers("slc") == 1, "the compression to connect")
        self.publish(self.sensor_info())

    def _keep_image(self, image: ComplexImage) -> None:
        self.images[image.dwell, image.detector] = image

    def complex_images(self) -> dict[tuple[int, int], npt.NDArray[np.complex64]]:
        """SLCs by dwell and detector."""
        return {
            key: messages.complex_view(image.samples, (image.grid.rows, image.grid.cols))
            for key, image in self.images.items()
        }

    def frames(self, dwell: int) -> list[DetectorFrame]:
        history = self.truth.phase_history(dwell)
        stamp = messages.to_stamp(START_NS + history.stamp_ns)
        return messages.history_to_messages(history, self.flight.sensor, dwell, stamp)

    def fly(self, dwell: int) -> None:
        """Have a dwell processed."""
        self.publish(*self.odometry(dwell), *self.frames(dwell))
        self.await_heights(dwell)

    def result(self, estimator: str, dwell: int) -> Heights:
        """What an estimator made of a dwell."""
        image = self.heights[estimator, dwell]
        grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
        squint = column_squint(grid, aperture, self.flight.sensor.beams, self.flight.sensor.look_side)
        fields = (messages.float_view(getattr(image, n), grid.shape) for n in ("height", "sigma", "cnr_db", "east"))
        height, sigma, cnr_db, east = (np.array(values, dtype=np.float64) for values in fields)
        return Heights(height, sigma, cnr_db, east + image.grid.origin.x, squint)


# (a) Bias against CNR. Two detectors a beamwidth apart behind a square aperture: mu = 2 t exactly, t in beamwidths.

BIAS_IMAGE = {"rows": 42, "cols": 16}  # elevations of +-0.3, squints of +-0.25 beamwidths
BIAS_LOOKS = {"range_looks": 2, "azimuth_looks": 8, "min_cnr_db": -60.0}
BIAS_DWELLS = 6


@cache
def bias_flight(cnr_db: float) -> SimulatedFlight:
    keys = {"detectors": 2, "pitch_beamwidths": 1.0, "pattern": "sinc", "pulse_count": 96}
    preset = small(cnr_db, bandwidth_hz=16e9, sample_count=128, **keys)
    return Recorded(preset, preset.make_sensor(), flat_scene(), BIAS_DWELLS, seed=round(cnr_db))


def pairs_of_discriminants(graph: Graph, discriminant: str, cnr_db: float) -> tuple[Array, Array, Array]:
    """True and estimated mu of level ground, and the CNR of Sigma, in the valid pixels of all dwells."""
    flight = bias_flight(cnr_db)
    chain = Claims(
        graph, flight, flight.sensor, image=BIAS_IMAGE, heights=BIAS_LOOKS, monopulse={"discriminant": discriminant}
    )
    true, found, cnr = [], [], []
    for dwell in range(BIAS_DWELLS):
        chain.fly(dwell)
        heights, image = chain.result("monopulse", dwell), chain.heights["monopulse", dwell]
        aperture = messages.aperture_from_message(image.aperture)
        grid = messages.grid_from_message(image.grid)
        truth = truth_image(flight.surface(dwell), aperture, grid, 1.0, flight.sensor.beams)
        t = (truth.elevation - np.pi / 4) / BEAMWIDTH
        columns = heights.squint[None, :] / BEAMWIDTH + (np.arange(8) - 3.5)[:, None] / 32
        passed = np.mean(np.sinc(columns) ** 2, axis=0)
        both = np.cos(np.pi * t) / (np.pi * (0.25 - t**2))  # Sigma of a point of amplitude 1
        valid = np.isfinite(heights.height)
        assert valid.mean() > 0.9
        true.append(2 * t[valid])
        found.append(2 * (t + heights.height / ACROSS / BEAMWIDTH)[valid])
        cnr.append((10 ** (cnr_db / 10) * passed * both**2 / 2)[valid])
    return np.concatenate(true), np.concatenate(found), np.concatenate(cnr)


@pytest.mark.parametrize("cnr_db", [6.0, 10.0, 16.0])
def test_ratio_is_drawn_to_the_middle_of_the_pair_by_its_cnr(graph: Graph, cnr_db: float) -> None:
    """E mu = kappa C / (C + 1) however many looks, with C the CNR of Sigma (SAL paper, section 3; Kanter 1977)."""
    true, found, cnr = pairs_of_discriminants(graph, "ratio", cnr_db)
    shrunk = true * cnr / (cnr + 1)
    slope = found @ true / (true @ true)
    expected = shrunk @ true / (true @ true)
    standard_error = np.std(found - shrunk) / np.sqrt(true @ true)
    assert standard_error < 0.02
    assert slope == pytest.approx(expected, abs=3.5 * standard_error)


@pytest.mark.parametrize("cnr_db", [6.0, 10.0, 16.0])
@pytest.mark.parametrize("discriminant", ["tls", "noise_subtraction"])
def test_estimates_that_know_of_the_noise_are_not(graph: Graph, discriminant: str, cnr_db: float) -> None:
    """Medians, as means do not exist; of n a standard error of 1.25 / sqrt(n), with half the width of 68 %."""
    true, found, cnr = pairs_of_discriminants(graph, discriminant, cnr_db)
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
MOVER_IMAGE = {"rows": 47, "cols": 13}  # with a pixel in the middle


@cache
def mover_flight() -> SimulatedFlight:
    """One dwell on a single target that appears in the middle of a pixel, and is RADIAL / SPEED of range ahead."""
    preset = small(75.0, pattern="gaussian", detector_rotation_rad=PSI)
    flight = Recorded(preset, preset.make_sensor(), flat_scene(), dwells=1, seed=22)
    ahead = SHOWN_AT + REACH * RADIAL / SPEED
    place = flight.aperture(0).position + REACH * look_direction(np.pi / 4 + OFFSET * BEAMWIDTH, ahead / REACH, 1)
    east, north, height = (float(value) for value in sphere_coordinates(place))
    target = PointTarget(east, north, height, 1.0, radial_velocity=RADIAL)
    dark = replace(flight.scene, brightness=np.zeros_like(flight.scene.brightness), points=(target,))
    return replace(flight, scene=dark)


def sinc_peak(profile: npt.NDArray[np.complexfloating]) -> float:
    """Place in pixels of the sinc, as wide as a pixel, that fits the moduli best."""
    pixels, places = np.arange(len(profile)), np.arange(0, len(profile) - 1, 1e-3)
    shapes = np.abs(np.sinc(pixels - places[:, None]))
    fit = (shapes @ np.abs(profile)) ** 2 / np.sum(shapes**2, axis=1)
    return float(places[np.argmax(fit)])


@pytest.mark.parametrize("estimator", ["ml", "monopulse"])
@pytest.mark.parametrize("known", [0.0, RADIAL], ids=["taken for still", "velocity known"])
def test_mover_appears_behind_its_place_and_with_turned_detectors_at_another_height(
    graph: Graph, estimator: str, known: float
) -> None:
    """Its squint is taken as smaller by v_r / v, so its elevation comes out higher by tan(psi) times that.

    For on the detector axis it is at x cos(psi) + y sin(psi), which is what the ratios tell.
    """
    flight = mover_flight()
    looks = {"range_looks": 1, "azimuth_looks": 1, "radial_velocity_mps": known}
    chain = Claims(graph, flight, flight.sensor, image=MOVER_IMAGE, heights=looks)
    chain.fly(0)
    target = flight.scene.points[0]

    slc = chain.complex_images()[0, 4]
    row, col = 23, 3
    assert np.unravel_index(np.argmax(np.abs(slc)), slc.shape) == (row, col)
    shown = (sinc_peak(slc[row]) - 6) * CELL
    assert shown - target.east == pytest.approx(-REACH * RADIAL / SPEED, abs=5e-5)

    heights = chain.result(estimator, 0)
    missing = (RADIAL - known) / SPEED
    error, expected = heights.height[row, col] - target.height, ACROSS * missing * np.tan(PSI)
    assert error == pytest.approx(expected, abs=3e-4)  # of 47 mm
    assert heights.east[row, col] - target.east == pytest.approx(-REACH * missing, abs=5e-5)


@cache
def strip_flight() -> SimulatedFlight:
    """A strip with a single target at the reference range, in the elevation of the one in `mover_flight`."""
    preset = small(75.0, pattern="gaussian", detector_rotation_rad=PSI, mode="stripmap", pulse_count=256)
    preset = replace(preset, flight=replace(preset.flight, dwell_spacing_m=None))
    flight = Recorded(preset, preset.make_sensor(), flat_scene(), dwells=5, seed=24)
    abeam = flight.aperture(2).position * np.array([0.0, 1.0, 1.0])
    place = abeam + REACH * look_direction(np.pi / 4 + OFFSET * BEAMWIDTH, 0.0, 1)
    east, north, height = (float(value) for value in sphere_coordinates(place))
    target = PointTarget(east, north, height, 1.0, radial_velocity=RADIAL)
    dark = replace(flight.scene, brightness=np.zeros_like(flight.scene.brightness), points=(target,))
    return replace(flight, scene=dark)


def gaussian_passage(offset: npt.ArrayLike, squint: float) -> Array:
    """Amplitudes, up to a factor, of eight turned Gaussian beams, averaged over a passage about a squint (beamwidths).

    Of squared widths the Gaussian has the sum: x - s cos(psi) across, and y - s sin(psi) along, for a detector at s.
    """
    steps, width = (np.arange(8) - 3.5) / 2, GAUSSIAN_WIDTH
    low, high = (erf((squint + end - steps * np.sin(PSI)) / (np.sqrt(2) * width)) for end in (-0.5, 0.5))
    across = np.exp(-((np.asarray(offset)[..., None] - steps * np.cos(PSI)) ** 2) / (2 * width**2))
    return np.asarray(across * (high - low))


@pytest.mark.parametrize("known", [0.0, RADIAL], ids=["taken for still", "velocity known"])
def test_mover_in_a_strip_is_elsewhere_and_higher_unless_its_velocity_is_known(graph: Graph, known: float) -> None:
    """In stripmap its passage is off the beams' middle by v_r / v, in every detector by another share."""
    flight = strip_flight()
    looks = {"range_looks": 1, "azimuth_looks": 1, "radial_velocity_mps": known}
    chain = Claims(graph, flight, flight.sensor, image={"rows": 47}, heights=looks)
    for dwell in range(flight.dwells):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
    chain.await_heights(flight.dwells - 1)
    moduli = {dwell: np.abs(slc) for (dwell, detector), slc in chain.complex_images().items() if detector == 4}
    brightest = max(moduli, key=lambda dwell: float(moduli[dwell].max()))
    row, col = np.unravel_index(np.argmax(moduli[brightest]), moduli[brightest].shape)
    assert row == 23
    heights = chain.result("ml", brightest)
    target, missing = flight.scene.points[0], (RADIAL - known) / SPEED
    assert heights.east[row, col] - target.east == pytest.approx(-REACH * missing, abs=8e-3)  # of pixels of 5 mm

    seen, others = gaussian_passage(OFFSET, RADIAL / SPEED / BEAMWIDTH), np.arange(-1.0, 1.5, 1e-4)
    trial = gaussian_passage(others, known / SPEED / BEAMWIDTH)
    taken = others[np.argmax((trial @ seen) ** 2 / np.sum(trial**2, axis=-1))]
    expected = ACROSS * (taken - OFFSET) * BEAMWIDTH
    assert expected == pytest.approx(0, abs=1e-9) if known else expected > 0.03
    error = heights.height[row, col] - target.height
    assert error == pytest.approx(expected, abs=3e-3)  # the pixel is up to 2.5 mm off the peak


# (c) Turned detectors over level ground.


@cache
def level_flight() -> SimulatedFlight:
    preset = small(25.0, pattern="gaussian", detector_rotation_rad=PSI)
    return Recorded(preset, preset.make_sensor(), flat_scene(1.0), dwells=4, seed=23)


@pytest.mark.parametrize("estimator", ["ml", "monopulse"])
@pytest.mark.parametrize("described", [PSI, 0.0], ids=["described", "unknown"])
def test_level_ground_tilts_when_the_rotation_of_the_detectors_is_not_known(
    graph: Graph, estimator: str, described: float
) -> None:
    """At squint y and elevation x it is taken to be at x cos(psi) + y sin(psi): along the flight it rises by
    sin(look angle) sin(psi).
    """
    flight = level_flight()
    sensor = replace(flight.sensor, detector_rotation=described, config_hash="")
    chain = Claims(graph, flight, sensor)
    errors, predictions, places = [], [], []
    for dwell in range(flight.dwells):
        chain.fly(dwell)
        heights, image = chain.result(estimator, dwell), chain.heights[estimator, dwell]
        grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
        truth = truth_image(flight.surface(dwell), aperture, grid, 1.0, flight.sensor.beams)
        x, y = truth.elevation - np.pi / 4, np.broadcast_to(heights.squint, grid.shape)
        valid = np.isfinite(heights.height) & (np.abs(x) < 1.2 * BEAMWIDTH)
        taken = x if described else x * np.cos(PSI) + y * np.sin(PSI)
        errors.append((heights.height - truth.height)[valid])
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
