"""A dwell becomes images: planes and sizes, formers, and autofocus, which must leave amplitude ratios alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import direct_history, refused
from phase_errors import ATMOSPHERE, power_law_phase, residual_phase, white_phase
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry.frames import angles_of
from sal_height.geometry.trajectory import Trajectory
from sal_height.graph.catalogue import check_parameters
from sal_height.imaging.autofocus.gradient import AutofocusSettings, apply_phase, autofocus, patch_centres
from sal_height.imaging.focus import ImageSettings, Slc, cell_response, focus_dwell
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.formers.choice import FEW_PIXELS, FORMERS
from sal_height.imaging.pixels import Processing, slc_noise_power
from sal_height.numeric.windows import broadening, window
from sal_height.renamed import with_new_names
from sal_height.sensor.sensor import PhaseHistory
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import PointScatterer
from sal_height.simulation.scenes import load_scene

REACH = 5000.0
SPOTLIGHT_FORMERS = ("backprojection", "row_sums", "specan")


@cache
def flight_of(name: str) -> SimulatedFlight:
    preset = replace(load_preset(name), dwells=1)
    return SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), 1, seed=90)


@cache
def dwell_of(name: str) -> PhaseHistory:
    return flight_of(name).phase_history(0)


def track_of(flight: SimulatedFlight) -> Trajectory:
    return Trajectory(flight.platform_states(0))


def focused(name: str, history: PhaseHistory | None = None, track: Trajectory | None = None, **settings: object) -> Slc:
    flight = flight_of(name)
    track = track or track_of(flight)
    return focus_dwell(history or dwell_of(name), track, flight.spectrum, ImageSettings(air="none", **settings))


def looking_as(slc: Slc) -> Trajectory:
    """The track of `small` with the attitude under which autofocus has found the beams."""
    attitude = Rotation.from_matrix(slc.aperture.rotation).as_quat()
    return Trajectory([replace(state, orientation=attitude) for state in track_of(flight_of("small")).states])


def power(values: np.ndarray) -> float:
    return float(np.mean(np.abs(values) ** 2))


def test_slant_image_of_size_zero_fills_range_window_and_beam() -> None:
    """64 cells in Taylor cells; a beam of 0.775 m in cells of wavelength * range / (2 * 8 cm)."""
    slc, sensor = focused("small", former="backprojection"), flight_of("small").spectrum
    cell = 1.55e-6 * REACH / (2 * 48 / 30e3 * 50)
    wide = broadening(window("taylor", 64))
    assert slc.grid.shape == (int(64 / wide), int(0.775 / cell)) == (47, 16)
    assert slc.images.shape == (8, 47, 16)
    assert slc.grid.col_spacing == pytest.approx(cell, rel=1e-6)
    assert slc.grid.row_spacing == pytest.approx(wide * sensor.range_resolution, rel=1e-9)
    assert np.isfinite(slc.images).all()
    assert not slc.aperture.sliding
    assert slc.focus is None
    assert slc.autofocus_phase.size == 0
    assert focused("small", former="backprojection", rows=5).grid.shape == (5, 16)
    assert focused("small", former="backprojection", cols=7).grid.shape == (47, 7)
    np.testing.assert_array_equal(slc.noise_power, slc_noise_power(sensor, Processing("taylor", "taylor"), 48))


@pytest.mark.parametrize("former", SPOTLIGHT_FORMERS)
@pytest.mark.parametrize("plane", ["slant", "ground"])
def test_image_is_that_of_backprojection_with_odometry_at_the_stated_pixels(former: str, plane: str) -> None:
    """In the plane asked for, its middle in the middle of the beams at the reference range."""
    flight, history = flight_of("small"), dwell_of("small")
    slc = focused(
        "small", former=former, image_plane=plane, rows=9, cols=8, ground_spacing_m=0.06, range_window="hamming"
    )
    antenna = flight.position(flight.pulse_times)
    expected = backproject(history, antenna, flight.spectrum, Processing("hamming", "taylor"), slc.grid)
    assert power(slc.images - expected) < 1e-4 * power(expected)
    slant_range, elevation, squint = angles_of(slc.grid.points(4, 3.5), flight.aperture(0), 1)
    assert slant_range == pytest.approx(REACH, abs=1e-6)
    assert elevation == pytest.approx(np.pi / 4, abs=1e-9)
    assert squint == pytest.approx(0, abs=1e-9)
    up = np.cross(slc.grid.row_direction, slc.grid.col_direction)
    across = np.array([0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)])
    if plane == "ground":
        np.testing.assert_allclose(np.abs(up), [0, 0, 1], atol=1e-9)
        assert (slc.grid.row_spacing, slc.grid.col_spacing) == (0.06, 0.06)
    else:
        np.testing.assert_allclose(slc.grid.row_direction, across, atol=1e-9)


def test_point_comes_to_lie_in_its_pixel_with_its_amplitudes() -> None:
    """Between the pixels (10, 4) and (11, 4), nearer the first, seen by detectors half a beam apart."""
    flight = flight_of("small")
    sensor, aperture, antenna = flight.spectrum, flight.aperture(0), flight.position(flight.pulse_times)
    grid = focused("small", former="backprojection", rows=20, cols=8).grid
    point = grid.points(10.3, 4.0)
    _, elevation, squint = angles_of(point, aperture, 1)
    gains = sensor.beams.response(elevation, squint)
    reference = np.full(48, REACH)
    samples = gains[:, None, None] * direct_history(sensor, point[None], [2.0], antenna, reference)
    history = PhaseHistory(0, flight.pulse_times, reference, samples.astype(np.complex64))
    for former in SPOTLIGHT_FORMERS:
        slc = focused("small", history, former=former, rows=20, cols=8)
        total = np.sum(np.abs(slc.images) ** 2, axis=0)
        assert np.unravel_index(np.argmax(total), total.shape) == (10, 4)
        peak = slc.images[:, 10, 4]
        np.testing.assert_allclose(np.abs(peak) / np.abs(peak).max(), np.abs(gains) / gains.max(), atol=1e-5)


def test_ground_plane_needs_a_size() -> None:
    for size in ({"rows": 0, "cols": 8}, {"rows": 8, "cols": 0}):
        with refused(UserError, "rows", "cols", "ground"):
            focused("small", image_plane="ground", **size)


def test_auto_takes_the_fast_former_where_it_pays_and_is_as_good(monkeypatch: pytest.MonkeyPatch) -> None:
    used = []

    def spy(name: str) -> None:
        former = FORMERS[name]
        spied = replace(former, form=lambda *given: used.append(name) or former.form(*given))
        monkeypatch.setitem(FORMERS, name, spied)

    for name in SPOTLIGHT_FORMERS:
        spy(name)
    focused("small", rows=10, cols=8)
    assert FEW_PIXELS < 640 * 16
    focused("small", rows=640, cols=16)
    # Columns of a ground plane that reaches over half a kilometre bow by many wavelengths.
    focused("small", image_plane="ground", rows=11, cols=1000, ground_spacing_m=0.5)
    assert used == ["row_sums", "specan", "backprojection"]


def test_former_of_the_other_mode_is_refused() -> None:
    with refused(UserError, "range_doppler", "spotlight", "specan", "backprojection"):
        focused("small", former="range_doppler", rows=8, cols=8)


@pytest.mark.parametrize("former", SPOTLIGHT_FORMERS)
@pytest.mark.parametrize("plane", ["slant", "ground"])
def test_autofocus_takes_off_what_an_atmosphere_has_put_on(former: str, plane: str) -> None:
    """2 rad rms over the pulses: what is left is that of speckle alone, and the image as sharp as without an error."""
    name, size = "sal_spotlight", {"rows": 184, "cols": 12, "ground_spacing_m": 0.04}
    error = power_law_phase(64, 2.0, ATMOSPHERE, np.random.default_rng(91))
    blurred = apply_phase(dwell_of(name), -error)
    settings = {"former": former, "image_plane": plane, **size}
    if (former, plane) == ("specan", "ground"):
        settings["rows"] = 40  # beyond, range bends over the ground
    clean, off, on = (
        focused(name, dwell_of(name), **settings),
        focused(name, blurred, **settings),
        focused(name, blurred, **settings, autofocus="always"),
    )
    assert on.focus
    assert on.focus.trusted
    left = float(np.sqrt(np.mean(residual_phase(on.autofocus_phase, error) ** 2)))
    assert left < 0.12
    assert off.autofocus_phase.size == 0

    def unlike(slc: Slc) -> float:
        return 1 - np.abs(np.vdot(slc.images, clean.images)) / np.sqrt(
            np.vdot(slc.images, slc.images).real * np.vdot(clean.images, clean.images).real
        )

    # The error's trend, which is a shift, stays on the image: it was made without one.
    assert unlike(on) < 0.12**2
    assert unlike(off) > 0.3


def test_phase_that_was_taken_off_is_what_autofocus_says_of_the_slant_plane_grid() -> None:
    flight, history = flight_of("small"), dwell_of("small")
    slc = focused("small", autofocus="always", rows=46, cols=12)
    antenna = flight.position(flight.pulse_times)
    patches = patch_centres(flight.spectrum, slc.aperture, slc.grid)
    expected = autofocus(history, antenna, flight.spectrum, patches, AutofocusSettings())
    np.testing.assert_allclose(slc.autofocus_phase, expected.phase, atol=1e-3)
    again = focused("small", apply_phase(history, slc.autofocus_phase), looking_as(slc), rows=46, cols=12)
    np.testing.assert_allclose(slc.images, again.images, atol=1e-5 * np.abs(slc.images).max())


def test_a_wider_image_lies_where_a_narrow_one_does() -> None:
    """With a column for each Doppler frequency it is wider than what stays in a range cell, and has two patches."""
    flight = flight_of("sal_spotlight")
    settings = {"rows": 60, "autofocus": "always"}
    narrow, wide = (focused("sal_spotlight", cols=cols, **settings) for cols in (12, 64))
    patches = patch_centres(flight.spectrum, wide.aperture, wide.grid)
    assert patches.shape[1] == 2
    beside = (64 - 12) // 2
    middle = np.abs(wide.images[..., beside : beside + 12])
    assert np.max(np.abs(middle - np.abs(narrow.images))) < 1e-2 * np.sqrt(power(narrow.images))


@pytest.mark.parametrize("radial_mps", [0.0, 8e-3, -11.37])
def test_a_bright_car_takes_nothing_from_autofocus(radial_mps: float) -> None:
    """Of 30 dB over the cells around it, at rest or driving: the phase is that of the street without it, to .1 rad.

    And the image lies where it does without it.
    """
    flight, settings = flight_of("sal_spotlight"), {"rows": 60, "cols": 12, "autofocus": "always"}
    alone = focused("sal_spotlight", **settings)
    car = PointScatterer(-0.3, 1.0, 1.0, 1e3, radial_mps, 0.0)
    history = replace(flight, scene=replace(flight.scene, points=(car,))).phase_history(0)
    beside = focused("sal_spotlight", history, **settings)
    assert beside.focus
    assert alone.focus
    assert beside.focus.trusted
    assert np.std(beside.focus.phase - alone.focus.phase) < 0.1
    assert abs(beside.focus.trend - alone.focus.trend) < 2 * beside.focus.trend_error


def test_autofocus_of_noise_is_not_trusted_and_leaves_the_image() -> None:
    flight, history = flight_of("small"), dwell_of("small")
    rng = np.random.default_rng(92)
    noise = (rng.standard_normal((2, *history.samples.shape)) / np.sqrt(2)).astype(np.float32)
    empty = replace(history, samples=(noise[0] + 1j * noise[1]).astype(np.complex64))
    on, off = (
        focused("small", empty, autofocus="always" if wanted else "never", rows=20, cols=8) for wanted in (True, False)
    )
    assert on.focus
    assert not on.focus.trusted
    assert on.autofocus_phase.size == 0
    np.testing.assert_array_equal(on.images, off.images)
    assert flight.sensor.pulse_count == len(on.focus.phase)


def test_phases_that_err_from_pulse_to_pulse_spread_energy_along_azimuth_as_the_response_says() -> None:
    """400 draws of .3 rad: a pixel 3 to 4 cells beside a point holds what is said within 5 %, standard error 2 %."""
    flight, deviation = flight_of("small"), 0.3
    sensor, antenna = flight.spectrum, flight.position(flight.pulse_times)
    size = {"former": "specan", "rows": 20, "cols": 8, "autofocus": "never", "azimuth_window": "rectangular"}
    exact = focused("small", **size)
    point = exact.grid.points(10.0, 4.0)
    reference = np.full(48, REACH)
    samples = direct_history(sensor, point[None], [1.0], antenna, reference)
    history = PhaseHistory(0, flight.pulse_times, reference, np.broadcast_to(samples, (2, *samples.shape)))
    rng = np.random.default_rng(5)

    def energy(phase: np.ndarray) -> np.ndarray:
        slc = focused("small", apply_phase(history, phase), **size)
        return np.asarray(np.abs(slc.images[0, 10]) ** 2)

    left = [energy(deviation * rng.standard_normal(48)) for _ in range(400)]
    sharp = energy(np.zeros(48))
    response = cell_response(replace(exact, residual_phase=deviation), sensor)
    # The response keeps exp(-s^2) of its energy, and all its sidelobes with it.
    spread = np.mean(left, axis=0) - np.exp(-(deviation**2)) * sharp
    whole = sharp[4] / response.across.spacing  # of all pixels of the row, by Parseval
    assert spread[[0, 1, 7]] / whole == pytest.approx(response.pedestal, rel=0.05)
    assert cell_response(exact, sensor).pedestal == 0.0


@pytest.mark.parametrize("applied", [True, False])
def test_only_a_trusted_phase_is_taken_off(applied: bool) -> None:
    """An error of more than the speckle allows is asked for, or of 3 rad."""
    error = white_phase(48, 1.0, np.random.default_rng(96))
    bad = apply_phase(dwell_of("small"), -error)
    size = {"rows": 20, "cols": 8}
    slc = focused("small", bad, autofocus="always", autofocus_max_error_rad=3.0 if applied else 0.01, **size)
    assert slc.focus
    assert slc.focus.trusted == applied
    expected = focused("small", apply_phase(bad, slc.focus.phase) if applied else bad, looking_as(slc), **size)
    np.testing.assert_allclose(slc.images, expected.images, atol=1e-5 * np.abs(slc.images).max())
    np.testing.assert_array_equal(slc.autofocus_phase, slc.focus.phase if applied else np.zeros(0))
    assert slc.residual_phase == (slc.focus.standard_error if applied else 0.0)


@pytest.mark.parametrize("former", [*SPOTLIGHT_FORMERS, "auto"])
@pytest.mark.parametrize("wanted", [False, True], ids=["navigation", "autofocus"])
@pytest.mark.parametrize("plane", ["slant", "ground"])
def test_detectors_that_see_the_same_in_proportion_are_imaged_in_proportion(
    former: str, wanted: bool, plane: str
) -> None:
    """Every detector has the speckle of the first, times its own real weight: the beams' response in one direction."""
    flight, first = flight_of("small"), dwell_of("small").samples[3]
    weights = np.linspace(-0.9, 1.3, 8).astype(np.float32)
    error = white_phase(48, 1.0, np.random.default_rng(93))
    history = apply_phase(replace(dwell_of("small"), samples=weights[:, None, None] * first), -error)
    slc = focus_dwell(
        history,
        track_of(flight),
        flight.spectrum,
        ImageSettings(
            air="none",
            former=former,
            autofocus="always" if wanted else "never",
            rows=30,
            cols=12,
            image_plane=plane,
            ground_spacing_m=0.05,
        ),
    )
    assert bool(slc.autofocus_phase.size) == wanted
    expected = weights[:, None, None] * (slc.images[-1] / weights[-1])
    np.testing.assert_allclose(slc.images, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(("recorded", "today"), [(True, "always"), (False, "never"), ("auto", "auto")])
def test_bags_of_before_autofocus_chose_by_itself_are_understood(recorded: object, today: str) -> None:
    assert ImageSettings(air="none", **with_new_names({"autofocus": recorded})).autofocus == today
    assert check_parameters({"sar_compression": {"autofocus": recorded}}) == {"sar_compression": {"autofocus": today}}
