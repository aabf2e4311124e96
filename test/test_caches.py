"""What is kept for its next use is bounded: a node that meets ever new sensors, patterns or files does not grow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import BEAMWIDTH, make_beams, make_sensor

from sal_height.beams.pattern import _averaged, pattern_named
from sal_height.elevation import OBJECTIVES, AxisResponse
from sal_height.elevation.array.response_spread import sidelobe_fractions, squared_pull
from sal_height.elevation.array.search import SEARCHES_KEPT, SQUINTS_AT_ONCE, PeakSearches, _searches
from sal_height.elevation.looks.look_windows import Window, axis_looks
from sal_height.elevation.looks.looks import _speckle_contrast
from sal_height.elevation.monopulse.inverse_table import inverse_table
from sal_height.elevation.monopulse.sum_difference import _slope_table
from sal_height.engine.frame_items import _fault_of_pulses
from sal_height.engine.provenance import Same
from sal_height.numeric.range_profiles import _deconvolution
from sal_height.numeric.windows import KEPT, _half_power_width, broadening, window
from sal_height.pipeline.channels import _channels_and_beams
from sal_height.sensor import KNOWN_BEAMS, whitened_channels
from sal_height.sensor.waveform import _waveform


def new_table(folder: Path, number: int) -> Any:
    path = folder / f"{number}.csv"
    path.write_text("angle_rad,gamma\n-0.5,-0.8\n0,0\n0.5,0.8\n")
    return _slope_table(str(path))


def new_beams(number: int) -> Any:
    sensor = replace(make_sensor(), name=str(number), config_hash="")
    return _channels_and_beams(sensor, whitened_channels, None, KNOWN_BEAMS, "rectangular", (0, 1), (1.0, 1.0))


def new_contrast(samples: int) -> Any:
    axis = axis_looks(Window(np.ones(2), 2), samples, None)
    return _speckle_contrast(axis, axis)


@pytest.mark.parametrize(
    ("cache", "use"),
    [
        (_waveform, lambda number, _: _waveform(replace(make_sensor(), name=str(number), config_hash=""))),
        (_averaged, lambda number, _: _averaged(pattern_named("gaussian"), (0.01 * (number + 1), 0.0))),
        (_slope_table, lambda number, folder: new_table(folder, number)),
        (_channels_and_beams, lambda number, _: new_beams(number)),
        (axis_looks, lambda number, _: axis_looks(Window(np.ones(2), 2), 10 + number, None)),
        (_speckle_contrast, lambda number, _: new_contrast(10 + number)),
        (inverse_table, lambda number, _: inverse_table(make_beams(count=2), number)),
        (squared_pull, lambda *_: squared_pull(make_beams(count=2))),
        (sidelobe_fractions, lambda number, _: sidelobe_fractions(AxisResponse("taylor", 1.3), 1 + number)),
        (_fault_of_pulses, lambda number, _: _fault_of_pulses(Same(np.arange(2.0)), Same(np.full(2, 1.0 + number)))),
        (_searches, lambda *_: PeakSearches.over(make_beams(), OBJECTIVES["normalised"], 0.0)),
    ],
    ids=[
        *("waveforms", "patterns", "slope tables", "beams of channels", "looks", "speckle", "inverse tables"),
        *("pulls", "shares", "pulse times", "searches"),
    ],
)
def test_caches_are_bounded(cache: Any, use: Callable[[int, Path], Any], tmp_path: Path) -> None:
    cache.cache_clear()
    for number in range(17):
        use(number, tmp_path)
    info = cache.cache_info()
    assert info.misses == 17
    assert info.currsize < 17


@pytest.mark.parametrize("columns", [SEARCHES_KEPT // 8, 2 * SEARCHES_KEPT])
def test_searches_at_the_squints_of_columns_are_bounded(columns: int) -> None:
    squint = np.linspace(-0.1, 0.1, columns) * BEAMWIDTH
    searches = PeakSearches.over(make_beams(), OBJECTIVES["normalised"], 0.0)
    for block in searches.blocks(squint, np.arange(columns), columns):
        assert len(searches.of(block).tables.grid) <= SQUINTS_AT_ONCE
    of_parts: Any = searches.of_parts
    info, blocks = of_parts.cache_info(), -(-columns // SQUINTS_AT_ONCE)
    assert (info.misses, info.currsize) == (blocks, min(blocks, SEARCHES_KEPT // SQUINTS_AT_ONCE))


def test_windows_and_what_follows_from_them_are_bounded() -> None:
    for cache in (window, _half_power_width, _deconvolution):
        cache.cache_clear()
    for count in range(16, 17 + KEPT):
        broadening(window("hamming", count))
        _deconvolution(count)
    assert window.cache_info().currsize == _half_power_width.cache_info().currsize == KEPT
    assert _deconvolution.cache_info().currsize == 8


def test_a_window_that_others_hold_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        window("taylor", 64)[0] = 2.0
