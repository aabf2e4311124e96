"""Which image former is chosen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from former_scenes import EAST, SAL, XBAND, Case, chosen, difference_db, dwell, on_the_ground, strip
from helpers import refused

from sal_height.errors import UserError
from sal_height.geometry.frames import ApertureState
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.formers.choice import FEW_OF_STRIP, FEW_PIXELS, FORMERS, Former, choose_former
from sal_height.imaging.formers.range_doppler import focus_stripmap
from sal_height.imaging.formers.row_sums import focus_rows
from sal_height.imaging.formers.specan import focus_spotlight
from sal_height.imaging.pixels import Processing, ground_plane_grid
from sal_height.sensor.sensor import MODES

FORMERS_OF = {"spotlight": "specan", "stripmap": "range_doppler"}


@pytest.fixture(scope="module")
def lidar() -> Case:
    return dwell(np.random.default_rng(80), rows=400, cols=26, bandwidth=5e9, sample_count=512)


@pytest.fixture(scope="module")
def lidar_strip() -> Case:
    return strip(np.random.default_rng(81), **SAL, targets=1, fold=0.5)


def test_a_wide_dwell_of_a_lidar_is_formed_fast_and_a_small_one_row_by_row(lidar: Case) -> None:
    assert lidar.grid.rows * lidar.grid.cols > FEW_PIXELS
    assert chosen(lidar) is focus_spotlight
    assert chosen(lidar, cols=25) is focus_rows
    image, reference = lidar.image(focus_spotlight), lidar.image(backproject)
    assert np.nanmax(np.abs(image - reference)) < 1e-2 * np.nanmax(np.abs(reference))


def test_a_dwell_on_which_specan_errs_is_formed_row_by_row_or_by_backprojection(lidar: Case) -> None:
    """Too wide for both; on a track that is bent, where phases must be exact; on the ground, too wide again."""
    assert chosen(lidar, rows=2000, cols=400) is backproject
    bent = lidar.antenna + 1e-3 * np.cos(np.linspace(0, 9, len(lidar.antenna)))[:, None] * EAST
    assert choose_former("auto", bent, lidar.sensor, lidar.processing, lidar.grid) is focus_rows
    aperture = ApertureState(lidar.antenna.mean(axis=0), 50 * EAST, np.eye(3), 0.08, np.zeros((6, 6)))
    ground = ground_plane_grid(lidar.sensor, aperture, 5000.0, 500, 200, 0.04)
    assert choose_former("auto", lidar.antenna, lidar.sensor, lidar.processing, ground) is backproject


def test_strips_are_formed_by_range_doppler(lidar_strip: Case) -> None:
    cols = lidar_strip.grid.cols
    assert cols < FEW_OF_STRIP < 2 * cols
    assert chosen(lidar_strip) is focus_stripmap
    assert chosen(lidar_strip, rows=2) is focus_stripmap
    assert chosen(lidar_strip, rows=1) is backproject


def test_strong_sidelobes_that_migrate_are_left_to_backprojection() -> None:
    """Migration of 1.4 cells in a radar's strip: with a rectangular azimuth window only, and not in a lidar's."""
    rng = np.random.default_rng(82)
    radar = strip(rng, **XBAND, pulses=1000, rows=100, frequencies=160, targets=1)
    sharp = replace(radar, processing=replace(radar.processing, azimuth_window="rectangular"))
    assert radar.grid.rows * radar.grid.cols > FEW_PIXELS
    assert chosen(radar) is focus_stripmap
    assert chosen(sharp) is backproject
    assert chosen(sharp, "range_doppler") is focus_stripmap
    lidar = strip(rng, **SAL, targets=1, fold=0.5, processing=Processing("taylor", "rectangular"))
    assert chosen(lidar) is focus_stripmap


def test_a_band_wide_for_its_carrier_is_left_to_backprojection() -> None:
    """At 10 % the azimuth windows at the band's ends are off that in the middle by 5 %: images differ by -35 dB."""
    radar = {**XBAND, "pulses": 1000, "rows": 100, "frequencies": 160, "targets": 20}
    narrow, wide = (strip(np.random.default_rng(83), **{**radar, "bandwidth": width}) for width in (3e8, 1e9))
    assert chosen(narrow) is focus_stripmap
    assert chosen(wide) is backproject
    assert difference_db(wide.image(focus_stripmap), wide.image()) > -40


def test_a_strip_on_which_range_doppler_errs_is_formed_by_backprojection() -> None:
    """Of a radar in gusts that move it by metres; of any on the ground, where rows are at uneven steps of range."""
    rng = np.random.default_rng(82)
    radar = {**XBAND, "pulses": 1000, "targets": 1, "rows": 50, "fold": 0.5, "gains": (1.0,)}
    calm, rough = strip(rng, **radar), strip(rng, **radar, gust=10.0)
    assert min(case.grid.rows * case.grid.cols for case in (calm, rough)) > FEW_PIXELS
    assert chosen(calm) is focus_stripmap
    assert chosen(rough) is backproject
    assert chosen(on_the_ground(calm, rng)) is backproject


def test_a_former_is_given_by_its_name(lidar: Case, lidar_strip: Case) -> None:
    for case in (lidar, lidar_strip):
        names = [name for name, former in FORMERS.items() if case.sensor.mode in former.modes]
        assert len(names) == (3 if case is lidar else 2)
        for name in names:
            assert chosen(case, name, rows=2, cols=2) is FORMERS[name].form
    assert FORMERS["backprojection"].modes == MODES


def test_a_new_former_is_an_entry(lidar: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is taken where it is the fastest that is accurate, and not where it errs."""
    made = FORMERS["specan"].form
    new = Former(partial(made), ("spotlight",), FEW_PIXELS, lambda *_: 1e-5)
    monkeypatch.setitem(FORMERS, "new", new)
    assert chosen(lidar) is new.form
    assert chosen(lidar, "new", rows=2) is new.form
    monkeypatch.setitem(FORMERS, "new", replace(new, expected_error=lambda *_: 2e-4))
    assert chosen(lidar) is made


def test_a_former_for_the_other_mode_or_an_unknown_one_is_refused_in_a_sentence(lidar: Case, lidar_strip: Case) -> None:
    for case, name in ((lidar, "range_doppler"), (lidar_strip, "specan")):
        with refused(UserError, name, case.sensor.mode, "backprojection", FORMERS_OF[case.sensor.mode]):
            chosen(case, name)
    for name in ("omega-k", ""):
        with refused(UserError, repr(name), "auto", *FORMERS):
            chosen(lidar, name)
