"""Doubts about narrow-band emitters in phase histories of the scenes of the group `fit`.

python -m benchmarks emitters   rows with targets, into bench.json
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from benchmarks.direct_images import direct_images, lidar, spectrum_of
from benchmarks.goodness_of_fit import CNR_DB, COLS, ROWS, SCENES_TRIED
from benchmarks.row import Row, sized
from sal_height.imaging import ImageSettings, Processing, narrow_band_doubts
from sal_height.numeric import C64
from sal_height.sensor import Sensor
from sal_height.simulation.spotlight import cell_power, draw_amplitudes

DWELLS = sized(6, 1)
"""Dwells of each scene."""

BRIGHT_DB = 40.0
"""Power of a bright point over the noise of a pixel."""


class Emitter(NamedTuple):
    """An emitter of one fast-time frequency, with another phase in every pulse.

    Attributes:
        power_db: mean power over samples, channels and pulses, over the noise of a sample, dB.
        frequency: number of the frequency.
        in_beams: True if it is in the beams, at .3 beam distances from the middle one; False: alike in all channels.
        pulsed: True if it is in a tenth of the pulses.
    """

    power_db: float
    frequency: int = 77
    in_beams: bool = True
    pulsed: bool = False


@lru_cache(maxsize=4)
def _parts_of(scene: str, seed: int) -> tuple[C64, C64, Sensor]:
    """Echoes at a CNR of 0 dB, noise of power 1 and the sensor: samples of shape (detectors, pulses, frequencies)."""
    rng, processing = np.random.default_rng(seed), Processing("taylor", ImageSettings().azimuth_window)
    images = direct_images(SCENES_TRIED[scene](), lidar(COLS), (ROWS, COLS), processing, rng)
    sensor, count = images.sensor, images.sensor.pulse_count
    amplitudes = draw_amplitudes(images.surface, cell_power(1.0, sensor, count), rng)
    echoes = spectrum_of(images.surface, amplitudes, sensor, images.aperture, images.grid).transpose(0, 2, 1)
    noise = np.sqrt(0.5) * rng.standard_normal((*echoes.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    known = replace(sensor, noise_power=(1.0,) * sensor.detector_count, config_hash="")
    return np.ascontiguousarray(echoes), noise.astype(np.complex64), known


def samples_of(scene: str, cnr_db: float, seed: int = 1, bright_points: int = 0) -> tuple[C64, Sensor]:
    """Phase history of a dwell and its sensor, with some bright points anywhere in the scene."""
    echoes, noise, sensor = _parts_of(scene, seed)
    rng, samples = np.random.default_rng(seed), 10 ** (cnr_db / 20) * echoes + noise
    _, pulses, frequencies = samples.shape
    for _ in range(bright_points):
        amplitude = np.sqrt(10 ** (BRIGHT_DB / 10) / (pulses * frequencies))
        beams = sensor.beams.response(rng.uniform(*sensor.beams.span), 0.0)
        doppler, delay = (
            np.exp(2j * np.pi * rng.uniform(-0.4, 0.4) * np.arange(count)) for count in (pulses, frequencies)
        )
        samples = samples + amplitude * beams[:, None, None] * doppler[:, None] * delay
    return samples.astype(np.complex64), sensor


def emitter_of(one: Emitter, shape: tuple[int, ...], sensor: Sensor, seed: int = 2) -> C64:
    """Samples of an emitter, of a shape (detectors, pulses, frequencies)."""
    rng, (channels, pulses, frequencies) = np.random.default_rng(seed), shape
    pulse = np.exp(2j * np.pi * rng.random(pulses))
    if one.pulsed:
        pulse *= np.sqrt(10) * (rng.random(pulses) < 0.1)
    beams, middle = sensor.beams.boresights, channels // 2
    at = beams[middle] + 0.3 * (beams[middle] - beams[middle - 1])
    response = sensor.beams.response(at, 0.0) if one.in_beams else np.ones(channels)
    response = response * np.sqrt(channels / np.sum(np.abs(response) ** 2))
    samples = np.zeros(shape, np.complex64)
    samples[:, :, one.frequency] = np.sqrt(frequencies * 10 ** (one.power_db / 10)) * response[:, None] * pulse
    return samples


FOUND = {
    # At 20 dB the clutter of its frequencies hides it in part of the dwells.
    "emitter in the beams -10 dB": (Emitter(-10.0), (90, 20)),
    "emitter in the beams 0 dB": (Emitter(0.0), (90, 90)),
    "emitter in the beams +10 dB": (Emitter(10.0), (90, 90)),
    # Eight pulses are tested; an emitter lasts for more than a dwell.
    "emitter in a tenth of the pulses 0 dB": (Emitter(0.0, pulsed=True), (20, 20)),
}
"""Emitters, and the least fraction of the dwells at 10 and at 20 dB that should have a doubt, %."""


def found() -> Iterator[Row]:
    """Rows: doubts about dwells without an emitter, and about dwells with one."""
    false, dwells = 0, 0
    for scene in SCENES_TRIED:
        for seed in range(DWELLS):
            for cnr_db in CNR_DB:
                for bright_points in (0, 1):
                    false += bool(narrow_band_doubts(*samples_of(scene, cnr_db, seed, bright_points)))
                    dwells += 1
    note = f"{len(SCENES_TRIED)} scenes, {CNR_DB} dB, with and without a point of {BRIGHT_DB:.0f} dB"
    yield Row("dwells with a false doubt about an emitter", false, f"of {dwells}", "<= 0", note)
    for name, (one, fractions) in FOUND.items():
        for scene in ("level", "street"):
            for cnr_db, least in zip((10, 20), fractions, strict=True):
                doubted = []
                for seed in range(DWELLS):
                    samples, sensor = samples_of(scene, cnr_db, seed)
                    seen = samples + emitter_of(one, samples.shape, sensor, seed)
                    doubted.append(bool(narrow_band_doubts(seen, sensor)))
                share = 100 * float(np.mean(doubted))
                yield Row(f"{name}: {scene} {cnr_db} dB", share, "%", f">= {least}", "dwells with a doubt")
