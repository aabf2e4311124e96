"""Heights of a dwell are the same to the last bit: alone and among up to seven others, with one BLAS thread and two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from sal_height.elevation import ESTIMATORS, MEASURED
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, heights, heights_of_dwells
from sal_height.sensor import Sensor
from sal_height.simulation import Preset, flight_of, load_preset
from sal_height.simulation.preset import BlankedRange

DWELLS, THREADS, SIZES = 8, (1, 2), (1, 2, 5, 8)

BLANKED = ((2, 4999.0, 4999.6), (6, 4999.5, 5000.4), *((m, 5000.9, 5001.3) for m in range(7)))


class Case(NamedTuple):
    """A sensor and the size of its images; the preset is the one of that name, or `small`."""

    preset: str = "small"
    rows: int = 46
    cols: int = 12
    estimators: tuple[str, ...] = tuple(ESTIMATORS.keys() - {"canopy_ground"})
    adapt: Callable[[Sensor], Sensor] = lambda sensor: sensor
    describe: Callable[[Preset], Preset] = lambda preset: preset


def changed(preset: Preset, **changes: Any) -> Preset:
    return replace(preset, sensor=replace(preset.sensor, **changes))


def mixed(sensor: Sensor, imaginary: float = 0.0) -> Sensor:
    """The sensor with channels that are mixtures of all detectors."""
    rng, shape = np.random.default_rng(1), (sensor.detector_count, sensor.detector_count)
    mixing = np.linalg.qr(rng.standard_normal(shape) + 1j * imaginary * rng.standard_normal(shape))[0]
    return replace(sensor, channel_matrix=tuple(map(tuple, mixing.tolist())), config_hash="")


PAIR_AND_ARRAY = ("monopulse", "ml")

CASES = {
    "sal_spotlight": Case("sal_spotlight"),
    "xband_relief": Case("xband_relief", cols=14, estimators=PAIR_AND_ARRAY),
    "xband_sumdiff": Case("xband_sumdiff", cols=14),
    "canopy": Case("woods", 4, 40, ("canopy_ground",)),
    "mixed channels": Case(estimators=("ml", "capon"), adapt=mixed),
    "many mixed channels": Case("sal_spotlight", 184, 12, ("ml",), partial(mixed, imaginary=1.0)),
    "blanked ranges": Case(
        estimators=PAIR_AND_ARRAY,
        describe=partial(changed, blanked_ranges=tuple(BlankedRange(*one) for one in BLANKED)),
    ),
    "turned detectors": Case(
        estimators=PAIR_AND_ARRAY,
        describe=partial(changed, detector_rotation_rad=0.3, pulse_repetition_frequency_hz=40_000.0),
    ),
    "finite detectors": Case(estimators=PAIR_AND_ARRAY, describe=partial(changed, detector_size_beamwidths=(0.5, 0.5))),
    "two detectors": Case(describe=partial(changed, detectors=2)),
}

CHANGES: dict[tuple[str, str], list[dict[str, Any]]] = {
    ("sal_spotlight", "ml"): [{}, {"objective": "numerator"}],
    ("xband_sumdiff", "sum_difference"): [{}, {"inverse": "linear"}],
}
"""Settings that are tried; elsewhere the defaults are."""

FEW = {"canopy": 2}
"""Dwells of what takes long."""


@cache
def dwells_of(name: str) -> tuple[Sensor, tuple[Slc, ...]]:
    """Images of DWELLS dwells that differ in their scene, geometry and noise; of the second some pixels are missing.

    One dwell is simulated: the others are the same with its rows turned round, and seen from elsewhere.
    """
    case = CASES[name]
    preset = case.describe(replace(load_preset(case.preset), dwells=1))
    flight = flight_of(preset, seed=7)
    sensor, image = case.adapt(flight.sensor), ImageSettings(air="none", rows=case.rows, cols=case.cols)
    slc = Compressor().add(replace(flight, sensor=sensor).phase_history(0), flight.track(0), sensor, image)
    assert slc
    made = []
    for number in range(DWELLS):
        position = slc.aperture.position + number * np.array([0.02, -1.0, 0.2])
        made.append(
            replace(
                slc,
                images=np.roll(slc.images, 5 * number, axis=1),
                aperture=replace(slc.aperture, position=position),
                noise_power=slc.noise_power * (1.3 if number == 2 else 1.0),
            )
        )
    made[1].images[:, : case.rows // 4, -1] = np.nan
    return sensor, tuple(made)


def arrays_of(value: Any) -> list[np.ndarray]:
    """All arrays of some heights."""
    if is_dataclass(value):
        return [array for f in fields(value) for array in arrays_of(getattr(value, f.name))]
    if isinstance(value, tuple):
        return [array for one in value for array in arrays_of(one)]
    return [value] if isinstance(value, np.ndarray) else []


@pytest.mark.parametrize(
    ("name", "estimator", "changes"),
    [
        (name, estimator, changes)
        for name, case in CASES.items()
        for estimator in ESTIMATORS
        if estimator in case.estimators
        for changes in CHANGES.get((name, estimator), [{}])
    ],
)
def test_heights_of_a_dwell_do_not_depend_on_its_group(name: str, estimator: str, changes: dict[str, Any]) -> None:
    """In every array of the heights, for groups of one to eight dwells: the first ones, or the last ones."""
    entry, (sensor, slcs) = ESTIMATORS[estimator], dwells_of(name)
    if not entry.suits(sensor):
        pytest.skip("the sensor has not the channels")
    looks = {"range_looks": 1, "azimuth_looks": 20} if name == "canopy" else {"range_looks": 2, "azimuth_looks": 2}
    settings = entry.settings(**looks, **changes)
    slcs = slcs[: FEW.get(name, DWELLS)]
    with threadpool_limits(1, user_api="blas"):
        alone = [heights(slc, sensor, entry, settings) for slc in slcs]
    assert any(np.isin(field.validity, MEASURED).any() for field in alone)
    for threads, group in product(THREADS, sorted({min(size, len(slcs)) for size in SIZES})):
        part = slice(group) if threads == 1 else slice(len(slcs) - group, None)
        with threadpool_limits(threads, user_api="blas"):
            together = heights_of_dwells(slcs[part], sensor, entry, settings)
        for one, expected in zip(together, alone[part], strict=True):
            for mine, theirs in zip(arrays_of(one), arrays_of(expected), strict=True):
                assert mine.dtype == theirs.dtype
                assert mine.tobytes() == theirs.tobytes()


def test_images_that_autofocus_has_made_do_not_depend_on_the_number_of_threads() -> None:
    """It solves for the phases of all pulses, by matrices that BLAS would divide among its threads."""
    preset = load_preset("sal_realistic")
    flight, made = flight_of(replace(preset, dwells=1), seed=7), []
    image = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols, autofocus="always")
    for threads in THREADS:
        with threadpool_limits(threads, user_api="blas"):
            slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, image)
        assert slc
        assert slc.autofocus_phase.size
        made.append((slc.images.tobytes(), slc.autofocus_phase.tobytes()))
    assert made[0] == made[1]
