"""Two scatterers in a pixel: images with none, some or many such pixels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.row import Row, medians, sized
from sal_height.beams import Beams, pattern_named
from sal_height.elevation import OBJECTIVES, Looks, peak_elevation, search_guard, two_scatterers
from sal_height.theory import TargetPixels

DETECTORS, PITCH, BEAMWIDTH, LOOKS = 16, 0.5, 1.55e-4, 4
SIDE = sized(256, 16)
CNR = 100.0
FALSE_ALARM = 0.01
SHARE = 0.1
"""Of the pixels that hold two."""


def throughput() -> Iterator[Row]:
    """Images of which no, some and all pixels hold two scatterers 1 beamwidth apart."""
    steps = np.arange(DETECTORS, dtype=np.float64) - (DETECTORS - 1) / 2
    beams = Beams((pattern_named("sinc"),), np.pi / 4 + PITCH * BEAMWIDTH * steps, BEAMWIDTH)
    for share in (0.0, SHARE, 1.0):
        yield _throughput(beams, share)


def _throughput(beams: Beams, share: float) -> Row:
    looks = _image(beams, share)
    single, everywhere = peak_elevation(looks, beams, OBJECTIVES["normalised"], search_guard(beams)), looks.power >= 0
    (seconds,) = medians(lambda: two_scatterers(looks, beams, single, everywhere, FALSE_ALARM))
    return Row(
        f"layover, {100 * share:.0f} % of the pixels hold two",
        seconds,
        "s",
        "<= 5",
        f"{SIDE} × {SIDE} pixels, {DETECTORS} detectors; {seconds / SIDE**2 * 1e6:.1f} s a megapixel",
    )


def _image(beams: Beams, share: float) -> Looks:
    """Looks of SIDE x SIDE pixels in unit noise."""
    rng, count = np.random.default_rng(3), SIDE**2
    upper, lower = (float(np.pi / 4 + offset * BEAMWIDTH) for offset in (0.5, -0.5))
    samples = TargetPixels(beams, upper, CNR, LOOKS).draw(rng, count)
    both = rng.uniform(size=count) < share
    second = np.sqrt(CNR / 2) * (rng.standard_normal((count, LOOKS)) + 1j * rng.standard_normal((count, LOOKS)))
    samples = samples + (both[:, None] * second)[..., None] * beams.response(lower, 0.0)
    covariance = np.asarray(np.einsum("pkm,pkn->pmn", samples, samples.conj()).real, np.float32)
    return Looks.of(covariance.reshape(SIDE, SIDE, DETECTORS, DETECTORS), LOOKS)
