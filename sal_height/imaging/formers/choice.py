"""The image formers behind one interface, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable

from sal_height.errors import UserError
from sal_height.geometry import Grid
from sal_height.imaging.formers import range_doppler, specan
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.formers.range_doppler import focus_stripmap, sidelobes_stray
from sal_height.imaging.formers.specan import ALLOWED_ERROR, focus_spotlight
from sal_height.imaging.weighting import Processing
from sal_height.numeric import C64, F64
from sal_height.sensor import PhaseHistory, Sensor

Former = Callable[[PhaseHistory, F64, Sensor, Processing, Grid], C64]
"""From phase history, antenna positions, sensor, weights and pixels to the images of all detectors."""

FORMERS: dict[str, Former] = {
    "backprojection": backproject,
    "specan": focus_spotlight,
    "range_doppler": focus_stripmap,
}
"""Image formers by name: the reference for any track, and a fast one for each mode on pixels in the slant plane."""

FAST = {"spotlight": "specan", "stripmap": "range_doppler"}
"""The fast former of each mode."""

EXPECTED_ERROR: dict[str, Callable[[F64, Sensor, Grid], float]] = {
    "spotlight": specan.expected_error,
    "stripmap": range_doppler.expected_error,
}
"""By how much the fast former of each mode errs, by geometry."""

FEW_PIXELS = 10_000
"""Images that backprojection forms in about the same time."""


def choose_former(name: str, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> Former:
    """The former of that name; for "auto", the fast one if it is as good as backprojection and worth it.

    Args:
        name: of FORMERS, or "auto".
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: its mode, and what the expected error of a fast former follows from.
        processing: the azimuth window and the processed angle.
        grid: pixels.

    Raises:
        UserError: there is no former of that name, or it is a fast one that is not for the sensor's mode.
    """
    if name != "auto" and name not in FORMERS:
        raise UserError(f"The former is {name!r}; allowed are auto, {', '.join(FORMERS)}.")
    if name in FAST.values() and name != FAST[sensor.mode]:
        raise UserError(
            f"The former {name} does not work in {sensor.mode}; allowed are {FAST[sensor.mode]} and backprojection."
        )
    if name == "auto":
        wide = grid.rows * grid.cols > FEW_PIXELS
        fits = wide and EXPECTED_ERROR[sensor.mode](antenna, sensor, grid) <= ALLOWED_ERROR
        fits = fits and not sidelobes_stray(antenna, sensor, processing, grid)
        name = FAST[sensor.mode] if fits else "backprojection"
    return FORMERS[name]
