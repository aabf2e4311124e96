"""Several scatterers in a pixel: images with none, some or many such pixels, over what single scatterers take."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.row import Row, medians, sized
from sal_height.beams import Beams, pattern_named
from sal_height.elevation import Looks, MlSettings, ml_elevation
from sal_height.theory import TargetPixels

DETECTORS, PITCH, BEAMWIDTH, LOOKS = 16, 0.5, 1.55e-4, 4
SIDE = sized(256, 16)
CNR = 100.0
SHARES = {0.0: "<= 3", 0.05: "<= 6", 1.0: "<= 60"}
"""Shares of the pixels that hold two, and the target for each."""


def throughput() -> Iterator[Row]:
    """Images of which no, some and all pixels hold two scatterers 1 beamwidth apart."""
    steps = np.arange(DETECTORS, dtype=np.float64) - (DETECTORS - 1) / 2
    beams = Beams((pattern_named("sinc"),), np.pi / 4 + PITCH * BEAMWIDTH * steps, BEAMWIDTH)
    for share, target in SHARES.items():
        yield _throughput(beams, share, target)


def _throughput(beams: Beams, share: float, target: str) -> Row:
    looks, one, several = _image(beams, share), MlSettings(layover=False), MlSettings()
    alone, whole = medians(lambda: ml_elevation(looks, beams, one), lambda: ml_elevation(looks, beams, several))
    return Row(
        f"several scatterers over one, {100 * share:.0f} % of the pixels hold two",
        whole / alone,
        "1",
        target,
        f"{SIDE} × {SIDE} pixels, {DETECTORS} detectors; {whole / SIDE**2 * 1e6:.1f} s a megapixel",
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
