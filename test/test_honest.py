"""The images of the benchmark `honest` are those of the whole chain, and its cases can be asked for by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.direct_images import image_of, spectrum_of
from benchmarks.honest import CASES, LitScatterers, Summary, case_named, compared, measured
from sal_height.imaging.focus import ImageSettings, focus_dwell
from sal_height.imaging.pixels import Processing
from sal_height.sensor.sensor import PhaseHistory
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.spotlight import draw_amplitudes, simulate_dwell


@pytest.mark.parametrize("windows", [("taylor", "rectangular"), ("rectangular", "taylor")])
def test_direct_images_are_those_of_phase_history_and_image_former(windows: tuple[str, str]) -> None:
    """But for a phase that all channels share; curvature of range over the short aperture is all that differs."""
    flight = flight_of(load_preset("sal_spotlight"), seed=1)
    sensor, surface, dwell = flight.sensor, flight.surface(0), 0
    rng = np.random.default_rng(2)
    surface = surface.where(rng.uniform(size=len(surface.power)) < 0.05)
    amplitudes = draw_amplitudes(surface, 1.0, rng)
    antenna = flight.position(flight.dwell_start_ns(dwell) * 1e-9 + flight.pulse_times)
    reference = np.full(sensor.pulse_count, flight.preset.flight.slant_range_m)
    samples = simulate_dwell(sensor, surface, amplitudes, antenna, reference).astype(np.complex64)
    history = PhaseHistory(flight.dwell_start_ns(dwell), flight.pulse_times, reference, samples)
    settings = ImageSettings(
        air="none", rows=100, cols=12, range_window=windows[0], azimuth_window=windows[1], former="backprojection"
    )
    slc = focus_dwell(history, flight.track(dwell), sensor, settings)
    processing = Processing(*windows)
    # Direct images leave out the phase of the way to the scatterer, which in the chain is that of the mid frequency.
    way = np.linalg.norm(surface.positions - antenna[sensor.pulse_count // 2 - 1], axis=-1) - reference[0]
    turned = amplitudes * np.exp(-1j * sensor.centre_wavenumber * way)
    spectrum = spectrum_of(surface, turned, sensor, slc.aperture, slc.grid)
    direct = image_of(spectrum, sensor, slc.aperture, slc.grid, processing)
    phase = np.exp(1j * np.angle(np.sum(slc.images * direct.conj(), axis=0)))
    error = np.linalg.norm(slc.images - phase * direct) / np.linalg.norm(slc.images)
    assert error < 0.01


def test_level_ground_keeps_its_promise_and_a_case_is_found_by_the_beginning_of_its_name() -> None:
    result = Summary.of(compared(case_named("level 20 dB K 4"), pixels=2000))
    error = np.sqrt(0.68 * 0.32 / result.published)
    assert result.within_1 == pytest.approx(0.68, abs=0.02 + 3 * error)
    assert result.beyond_5 == 0
    assert result.right_order > 0.99
    assert case_named("fence 40").cnr_db == 40
    assert len({case.name for case in CASES}) == len(CASES)


def test_heights_in_a_forest_are_those_of_lit_scatterers_and_random_ones_are_not() -> None:
    field, truth, images = measured(case_named("forest"), pixels=2000)
    found = LitScatterers.of(field, truth, images.sensor.beams)
    assert found.beyond_5 < 0.005
    assert found.by_chance > 0.8
    first = field.first
    raised = replace(field, surfaces=(replace(first, height=first.height + 100.0),))
    assert LitScatterers.of(raised, truth, images.sensor.beams).beyond_5 == 1


def test_cases_of_other_presets_and_look_angles_have_their_own_geometry() -> None:
    """The pixels of the stripmap preset are 8 cm long, from 16 looks; 20 degrees from nadir the array looks down."""
    strip, steep = (measured(case_named(name), pixels=600) for name in ("street stripmap 20", "level look angle 20"))
    assert strip[0].grid.col_spacing == pytest.approx(16 * 0.005 * 1.0, rel=0.3)
    assert strip[2].sensor.detector_count == 8
    assert np.mean(steep[2].sensor.beams.span) == pytest.approx(np.radians(20), abs=1e-3)
    assert np.nanmedian(np.abs(steep[0].first.height)) < 0.05
