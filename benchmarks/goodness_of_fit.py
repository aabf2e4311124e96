"""Doubts about dwells that are as described, and about dwells that are not.

Scenes of the group `honest` and a street, at the geometry of preset sal_spotlight, cut into dwells of its size.

    python -m benchmarks fit                             rows with targets, into bench.json
    python -m benchmarks.goodness_of_fit                 noise levels and gains that are found where nothing is wrong
    python -m benchmarks.goodness_of_fit 8 1 12 street   with 8 detectors, 1 x 12 looks; some scenes
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from time import process_time, thread_time
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks import honest_scenes as scenes
from benchmarks.direct_images import DirectImages, direct_images, lidar
from benchmarks.row import Row, sized
from sal_height.elevation import ESTIMATORS, HeightSettings
from sal_height.elevation.fit.channel_gains import CHANNEL_GAIN
from sal_height.elevation.fit.noise_level import NOISE_LEVEL
from sal_height.imaging import ImageSettings, Processing, Slc
from sal_height.numeric import C64, F64
from sal_height.pipeline import dwell, heights_of_dwells
from sal_height.pipeline.fit import DwellFit, fit_of
from sal_height.relief import HeightField
from sal_height.simulation import Scene
from sal_height.simulation.scenes import SCENES

ROWS, COLS = 184, 12
"""Of the images of a dwell, as in preset sal_spotlight."""

DWELLS = sized(16, 2)
"""Dwells of each scene, side by side in a wide image."""

CNR_DB = (3, 5, 10, 20, 30, 40)

SCENES_TRIED: dict[str, Callable[[], Scene]] = {
    "level": scenes.level,
    "street": SCENES["street"],
    "forest": scenes.forest,
    "canopy": scenes.canopy,
    "roofs": scenes.roofs,
    "fence": scenes.fence,
    "rubble": scenes.rubble,
    "slope +40 deg": partial(scenes.slope, np.radians(40)),
    "slope -40 deg": partial(scenes.slope, np.radians(-40)),
    **{f"step {size:+.1f}": partial(scenes.step, size) for size in (0.3, 0.5, 1.0, 3.0, -0.5, -1.0)},
}

SEED = 6


class Fault(NamedTuple):
    """A departure from the description.

    Attributes:
        noise_db: noise power over the stated one, dB.
        channel_noise_db: noise power of each channel over that, dB; one for all.
        gain_db: gain of each channel, dB; one for all.
        alike_db: power of interference that is alike in all channels, over the stated noise, dB.
        correlation: that of the noise of neighbouring channels.
        over_range_db: gain of signal and noise at the last range, and its inverse at the first, dB; the mean power of
            the noise is the stated one.
        pitch: distance between the beams over the described one.
        found: least fraction of the dwells at 10 and at 20 dB that should have a doubt, %.
    """

    noise_db: float = 0.0
    channel_noise_db: tuple[float, ...] = (0.0,)
    gain_db: tuple[float, ...] = (0.0,)
    alike_db: float = -np.inf
    correlation: float = 0.0
    over_range_db: float = 0.0
    pitch: float = 1.0
    found: tuple[float, float] = (90.0, 90.0)

    def of(self, images: DirectImages) -> DirectImages:
        """Images of a sensor that departs so, but for its pitch."""
        gain, level = (
            np.broadcast_to(10 ** (np.array(one) / 20), len(images.echoes)).astype(np.float32)[:, None, None]
            for one in (self.gain_db, self.channel_noise_db)
        )
        # Noise of the same spectrum: that of a channel, shifted.
        alike = 10 ** (self.alike_db / 20) * np.roll(images.noise[0], (ROWS // 5, COLS // 2), axis=(0, 1))
        # n_m + c n_(m+1) has the correlation c / (1 + c^2).
        c = 2 * self.correlation / (1 + np.sqrt(1 - 4 * self.correlation**2))
        noise = (images.noise + c * np.roll(images.noise, 1, axis=0)) / np.sqrt(1 + c * c)
        ramp = 10 ** (np.linspace(-self.over_range_db, self.over_range_db, images.noise.shape[1]) / 20)
        ramp = (ramp / np.sqrt(np.mean(ramp**2)))[:, None]
        noise = ramp * (10 ** (self.noise_db / 20) * level * noise + alike)
        echoes = gain * ramp * images.echoes
        return replace(images, echoes=echoes.astype(np.complex64), noise=noise.astype(np.complex64))


def _only(channel: int, size_db: float, channels: int = 16) -> tuple[float, ...]:
    return tuple(size_db if m == channel else 0.0 for m in range(channels))


NONE = Fault()
FAULTS: dict[str, Fault] = {
    "noise +1 dB": Fault(1.0),
    "noise +3 dB": Fault(3.0),
    "noise +26 dB": Fault(26.0),
    "noise -6 dB": Fault(-6.0),
    # +3 dB leave .3 % of the heights beyond 5 sigma at 5 dB, and +6 dB 2 % at 10 dB.
    "noise of channel 5 +3 dB": Fault(channel_noise_db=_only(5, 3.0), found=(50, 50)),
    "noise of channel 5 +6 dB": Fault(channel_noise_db=_only(5, 6.0)),
    "noise of channel 5 +10 dB": Fault(channel_noise_db=_only(5, 10.0)),
    # A wrong gain or pitch is the same in all dwells of a flight, so that a few with a doubt are enough.
    "channel 5 noise only": Fault(gain_db=_only(5, -200.0), found=(10, 90)),
    "channel 5 +3 dB": Fault(gain_db=_only(5, 3.0), found=(10, 90)),
    "gains 2 dB rms": Fault(gain_db=tuple(2.0 * np.random.default_rng(5).standard_normal(16)), found=(10, 90)),
    "interference -10 dB": Fault(alike_db=-10.0),
    "interference 0 dB": Fault(alike_db=0.0),
    "interference +10 dB": Fault(alike_db=10.0),
    "correlation .3": Fault(correlation=0.3),
    "gain over range 3 dB": Fault(over_range_db=3.0),
    "pitch +3 %": Fault(pitch=1.03, found=(0, 25)),
}


def dwells_of(
    scene: str,
    fault: Fault,
    cnr_db: float,
    settings: HeightSettings | None = None,
    detectors: int = 16,
    dwells: int = DWELLS,
) -> list[HeightField]:
    """Heights of dwells of a scene; the fault's noise is in addition to that of the CNR."""
    images = fault.of(images_of(scene, detectors, dwells, fault.pitch))
    slc, sensor = images.slc(cnr_db), images.sensor
    parts = parts_of(slc)
    entry = ESTIMATORS["ml"]
    return heights_of_dwells(parts, sensor, entry, settings or entry.settings())


@lru_cache(maxsize=8)
def images_of(scene: str, detectors: int, dwells: int, pitch: float = 1.0) -> DirectImages:
    """Images of several dwells side by side; the pitch of the beams is over the described one."""
    sensor, processing = lidar(dwells * COLS, detectors=detectors), Processing("taylor", ImageSettings().azimuth_window)
    boresights = np.array(sensor.elevation_boresights)
    middle = boresights.mean()
    stretched = replace(
        sensor, elevation_boresights=tuple((middle + pitch * (boresights - middle)).tolist()), config_hash=""
    )
    rng = np.random.default_rng(SEED)
    images = direct_images(SCENES_TRIED[scene](), stretched, (ROWS, dwells * COLS), processing, rng)
    return replace(images, sensor=sensor)


def parts_of(slc: Slc) -> list[Slc]:
    """Images of the dwells that are side by side in wide ones."""
    return [_columns(slc, first) for first in range(0, slc.images.shape[2], COLS)]


def _columns(slc: Slc, first: int) -> Slc:
    images: C64 = np.ascontiguousarray(slc.images[:, :, first : first + COLS])
    origin: F64 = slc.grid.points(0, first)
    return replace(slc, images=images, grid=replace(slc.grid, origin=origin, cols=COLS))


def found() -> Iterator[Row]:
    """Rows of the group: doubts about dwells that are as described, and doubts about those that are not."""
    false, dwells = 0, 0
    for scene in SCENES_TRIED:
        for cnr_db in CNR_DB:
            fields = dwells_of(scene, NONE, cnr_db)
            false += sum(bool(field.doubts) for field in fields)
            dwells += len(fields)
    yield Row("dwells with a false doubt", false, f"of {dwells}", "<= 0", f"{len(SCENES_TRIED)} scenes, {CNR_DB} dB")
    for name, fault in FAULTS.items():
        for scene in ("level", "street"):
            for cnr_db, least in zip((10, 20), fault.found, strict=True):
                fields = dwells_of(scene, fault, cnr_db + max(fault.noise_db, 0.0))
                share = 100 * float(np.mean([bool(field.doubts) for field in fields]))
                yield Row(f"{name}: {scene} {cnr_db} dB", share, "%", f">= {least:.0f}", "dwells with a doubt")
    yield cost()


def cost() -> Row:
    """The time of the tests over that of the heights."""
    images = images_of("street", 16, DWELLS)
    entry, sensor, slc = ESTIMATORS["ml"], images.sensor, images.slc(20.0)
    parts = parts_of(slc)
    spent, ratios = [0.0], []

    def timed(*arguments: Any) -> DwellFit:
        start = thread_time()
        made = fit_of(*arguments)
        spent[0] = thread_time() - start
        return made

    with patch.object(dwell, "fit_of", timed):
        for part in parts * sized(8, 2):
            start = process_time()
            heights_of_dwells([part], sensor, entry, entry.settings())
            ratios.append(spent[0] / (process_time() - start - spent[0]))
    # The first dwells make tables.
    return Row(
        "time of the tests over that of ml",
        100 * float(np.median(ratios)),
        "%",
        "<= 3",
        "median of dwells, street, 20 dB",
    )


def table(names: Sequence[str], detectors: int, looks: tuple[int, int]) -> None:
    """Print level and gains of the null for every scene and CNR."""
    for scene in names or SCENES_TRIED:
        for cnr_db in CNR_DB:
            settings = ESTIMATORS["ml"].settings(range_looks=looks[0], azimuth_looks=looks[1])
            fields = dwells_of(scene, NONE, cnr_db, settings, detectors)
            levels = np.array([test.size for field in fields for test in field.fit if test.name == NOISE_LEVEL])
            gains = np.array([test.size for field in fields for test in field.fit if test.name == CHANNEL_GAIN])
            doubts = [doubt for field in fields for doubt in field.doubts]
            known = levels[np.isfinite(levels)]
            text = f"{known.min():+.2f} to {known.max():+.2f} dB" if len(known) else "not tested"
            decibels = 20 * np.log10(gains[np.isfinite(gains) & (gains > 0)])
            of_gain = f"{decibels.min():+.2f} to {decibels.max():+.2f} dB" if len(decibels) else "not tested"
            sys.stdout.write(
                f"{scene:14} {cnr_db:3} dB: level {text:20} ({len(known)}), gains {of_gain}, {len(doubts)} doubts\n"
            )


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:4]]
    table(sys.argv[4:], numbers[0] if numbers else 16, (numbers[1], numbers[2]) if len(numbers) == 3 else (2, 2))
