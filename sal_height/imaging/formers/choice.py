"""The image formers behind one interface, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sal_height.errors import UserError
from sal_height.geometry import Grid
from sal_height.imaging.formers import range_doppler, row_sums, specan
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.pixels import Processing
from sal_height.numeric import C64, F64
from sal_height.sensor import MODES, PhaseHistory, Sensor

FormImages = Callable[[PhaseHistory, F64, Sensor, Processing, Grid], C64]
"""From phase history, antenna positions, sensor, weights and pixels to the images of all detectors."""

ALLOWED_ERROR = 1e-4
"""Greatest expected power of the difference to backprojection, over that of the image: -40 dB.

Noise and sidelobes of an image are stronger than that.
"""

FEW_PIXELS = 10_000  # of a dwell, that backprojection forms in about the same time as a fast former
FEW_OF_STRIP = 1_000  # of a strip, where backprojection tests every pulse for every pixel


@dataclass(frozen=True)
class Former:
    """An image former, and its conditions for the accuracy of backprojection.

    Attributes:
        form: function that makes the images.
        modes: modes of the sensor for which it works.
        worthwhile_above: number of pixels of an image above which it is faster than backprojection.
        expected_error: power of the difference to backprojection over that of the image, from antenna positions (m,
            shape (pulses, 3)), sensor and pixels alone.
        suits: test of its accuracy with the windows, from antenna positions, sensor, weights and pixels.
    """

    form: FormImages
    modes: tuple[str, ...]
    worthwhile_above: int = 0
    expected_error: Callable[[F64, Sensor, Grid], float] = lambda *_: 0.0
    suits: Callable[[F64, Sensor, Processing, Grid], bool] = lambda *_: True


FORMERS: dict[str, Former] = {
    "backprojection": Former(backproject, MODES),
    "row_sums": Former(row_sums.focus_rows, ("spotlight",), 0, row_sums.expected_error),
    "specan": Former(specan.focus_spotlight, ("spotlight",), FEW_PIXELS, specan.expected_error),
    "range_doppler": Former(
        range_doppler.focus_stripmap,
        ("stripmap",),
        FEW_OF_STRIP,
        range_doppler.expected_error,
        range_doppler.keeps_sidelobes,
    ),
}
"""Image formers by name, from the slowest to the fastest; a new one is a module and an entry here."""


def choose_former(name: str, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> FormImages:
    """The former of that name; for "auto", the fastest that is as good as backprojection and worth it.

    Args:
        name: name in FORMERS, or "auto".
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: sensor with its mode, and the data for the expected error of a fast former.
        processing: azimuth window and processed angle.
        grid: grid of the pixels.

    Raises:
        UserError: there is no former of that name, it does not work in the sensor's mode, or its image would differ
            from backprojection's by more than ALLOWED_ERROR.
    """
    allowed = {key: former for key, former in FORMERS.items() if sensor.mode in former.modes}
    if name == "auto":
        fitting = [
            former
            for former in allowed.values()
            if grid.rows * grid.cols > former.worthwhile_above
            and former.expected_error(antenna, sensor, grid) <= ALLOWED_ERROR
            and former.suits(antenna, sensor, processing, grid)
        ]
        return fitting[-1].form
    if name not in FORMERS:
        raise UserError(f"The former is {name!r}; allowed are auto, {', '.join(FORMERS)}.")
    if name not in allowed:
        raise UserError(f"The former {name} does not work in {sensor.mode}; allowed are {' and '.join(allowed)}.")
    error = allowed[name].expected_error(antenna, sensor, grid)
    if error > ALLOWED_ERROR:
        raise UserError(
            f"The former {name} would differ from backprojection by {10 * np.log10(error):.1f} dB here, because the "
            f"track is too uneven or the image too wide or not in the slant plane; at most "
            f"{10 * np.log10(ALLOWED_ERROR):.0f} dB are allowed, so use backprojection."
        )
    return allowed[name].form
