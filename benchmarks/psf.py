"""The calibration of the point-spread function: time of its routes over that of an FFT and its inverse."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import scipy.fft

from benchmarks.row import Row, medians, sized
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, TapeTarget, make_tape
from sal_height.numeric import C64, WORKERS
from sal_height.response import (
    PointSpread,
    SpeckleSpectra,
    TransferFunction,
    estimate_point_spread,
    estimate_speckle_spectra,
    estimate_transfer_function,
    find_pure_speckle,
    find_targets,
)

SIDE = sized(2048, 512)
PLACES = [(row * SIDE / 2048, col * SIDE / 2048) for row in (300, 1600) for col in (500, 1300)]
TARGETS = tuple(TapeTarget(row + 0.3, col + 0.6, 40.0) for row, col in PLACES)


def target_route() -> Iterator[Row]:
    """Survey, transfer function and point-spread function of an image, with few targets and with many candidates."""
    rng = np.random.default_rng(1)
    crowd = tuple(TapeTarget(row, col, over) for row, col, over in rng.uniform((0, 0, 25), (SIDE, SIDE, 45), (300, 3)))
    for name, targets in (("4 targets", TARGETS), ("300 targets", crowd)):
        image = make_tape((SIDE, SIDE), rng, targets, RangeFault(), AzimuthFault())
        calibration, pair = medians(partial(_calibrate, image), partial(_there_and_back, image))
        yield Row(
            f"survey and calibrate, target route, {name}",
            calibration / pair,
            "1",
            "<= 1.5",
            f"{1e3 * calibration:.0f} ms over {1e3 * pair:.0f} ms of scipy's fft2 and ifft2 of {SIDE} × {SIDE}",
        )


def both_routes() -> Iterator[Row]:
    """Targets, transfer function, pure speckle and its spectra: all that an image tells."""
    image = make_tape((SIDE, SIDE), np.random.default_rng(1), TARGETS, RangeFault(), AzimuthFault(), noise=0.3)
    both, pair = medians(partial(_both, image), partial(_there_and_back, image))
    yield Row(
        "point-spread function, both routes together",
        both / pair,
        "1",
        "<= 4",
        f"{1e3 * both:.0f} ms over {1e3 * pair:.0f} ms of scipy's fft2 and ifft2 of {SIDE} × {SIDE}",
    )


def _both(image: C64) -> tuple[TransferFunction, SpeckleSpectra]:
    transfer = estimate_transfer_function(find_targets(image).require())
    return transfer, estimate_speckle_spectra(image, find_pure_speckle(image))


def _calibrate(image: C64) -> PointSpread:
    return estimate_point_spread(estimate_transfer_function(find_targets(image).require()))


def _there_and_back(image: C64) -> object:
    return scipy.fft.ifft2(scipy.fft.fft2(image, workers=WORKERS), workers=WORKERS)
