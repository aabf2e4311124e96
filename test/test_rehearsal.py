"""Made-up dwells: every sensor can be rehearsed, and what is rehearsed is what flies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.beams import Beams
from sal_height.elevation import ESTIMATORS, ElevationEstimate, ElevationEstimator, HeightSettings, Looks, Validity
from sal_height.engine.registry import STAGES
from sal_height.imaging import ImageSettings
from sal_height.pipeline import Compressor, heights
from sal_height.rehearsal import (
    MOST_REMEMBERED,
    made_up_heights,
    once,
    rehearse_adjustment,
    rehearse_heights,
    rehearsed_slc,
    with_scatterers,
)
from sal_height.relief import PriorEstimate, track
from sal_height.simulation import load_preset

LOWEST = {"ml": 6.0, "monopulse": 9.0}
"""CNR that estimators ask for, dB."""


@pytest.mark.parametrize("name", ["small", "sal_stripmap", "xband_sumdiff"])
def test_every_sensor_has_a_made_up_dwell(name: str) -> None:
    """Images of unit noise, and heights of scatterers of 30 dB in some of them."""
    preset = load_preset(name)
    sensor, rng = preset.make_sensor(), np.random.default_rng(0)
    slc = rehearsed_slc(sensor, ImageSettings(air="none", rows=24, cols=16), Compressor(), rng)
    assert slc is not None
    assert np.mean(np.abs(slc.images) ** 2, axis=(1, 2)) == pytest.approx(slc.noise_power, rel=0.2)
    lit = with_scatterers(slc, sensor, rng)
    ml = ESTIMATORS["ml"]
    validity = heights(lit, sensor, ml, ml.settings(range_looks=2, azimuth_looks=2)).validity
    assert np.mean(~np.isin(validity, (Validity.NO_SIGNAL, Validity.LOW_CNR))) > 0.05
    # Around lonely scatterers two channels see layover.
    assert np.any(validity == Validity.OK) == (sensor.detector_count > 2)


@pytest.mark.parametrize(("autofocus", "linked"), [("auto", 1), ("never", 0)])
def test_autofocus_is_rehearsed_where_it_may_be_requested(
    autofocus: str, linked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made-up odometry is exact, and needs none; the phases of made-up speckle are linked nevertheless."""
    from sal_height.imaging.autofocus import gradient

    found, focus_speckle = [], gradient.focus_speckle
    monkeypatch.setattr(gradient, "focus_speckle", lambda *given: found.append(focus_speckle(*given)) or found[-1])
    sensor, settings = (
        load_preset("small").make_sensor(),
        ImageSettings(air="none", rows=24, cols=16, autofocus=autofocus),
    )
    assert rehearsed_slc(sensor, settings, Compressor(), np.random.default_rng(0)) is not None
    assert [bool(np.isfinite(one.standard_error)) for one in found] == [True] * linked


def test_an_adjustment_is_rehearsed_with_all_that_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two passes are compared, and the heights corrected."""
    from sal_height.adjustment import comparing
    from sal_height.adjustment.matching import match

    found = []
    monkeypatch.setattr(comparing, "match", lambda *given: found.append(match(*given)) or found[-1])
    rehearse_adjustment(load_preset("sal_spotlight").make_sensor(), np.random.default_rng(0))
    assert len([one for one in found if one]) == 2


def test_all_estimators_are_rehearsed_with_their_settings() -> None:
    seen: list[tuple[str, float]] = []

    def noting(estimator: ElevationEstimator) -> ElevationEstimator:
        def estimate(looks: Looks, beams: Beams, settings: HeightSettings) -> ElevationEstimate:
            made = estimator.estimate(looks, beams, settings)
            seen.append((estimator.name, settings.min_cnr_db))
            assert np.any(made.validity == Validity.OK)
            return made

        return replace(estimator, estimate=estimate)

    chosen = [(noting(ESTIMATORS[name]), ESTIMATORS[name].settings(min_cnr_db=cnr)) for name, cnr in LOWEST.items()]
    rng = np.random.default_rng(0)
    rehearse_heights(load_preset("small").make_sensor(), ImageSettings(air="none", rows=24, cols=16), chosen, rng)
    assert dict(seen) == LOWEST


def test_made_up_heights_can_be_tracked() -> None:
    field, aperture = made_up_heights(np.random.default_rng(0))
    tracked, prior, _ = track(field, aperture, PriorEstimate())
    assert np.all(tracked.validity == Validity.OK)
    assert np.std(tracked.first.height) < np.std(field.first.height)
    assert prior.sigma > 0


def test_what_was_rehearsed_lately_is_not_again() -> None:
    done: list[str] = []

    def rehearse(name: str) -> None:
        done.append(name)
        if name == "fails":
            raise ValueError(name)

    for name in ("a", "b", "a", "b"):
        once(("test", name), lambda name=name: rehearse(name))
    for _ in range(2):
        with pytest.raises(ValueError, match="fails"):
            once(("test", "fails"), lambda: rehearse("fails"))
    assert done == ["a", "b", "fails", "fails"]
    for number in range(MOST_REMEMBERED):
        once(("test", number), lambda: None)
    once(("test", "a"), lambda: rehearse("a"))
    assert done[4:] == ["a"]


@pytest.mark.parametrize(
    ("name", "work", "changed"),
    [
        ("sar_compression", "sal_height.engine.compression.rehearsed_slc", "max_odometry_gap_s"),
        ("ml_height", "sal_height.engine.heights.rehearse_heights", "min_cnr_db"),
    ],
)
def test_stages_rehearse_once_for_a_sensor_and_their_settings(
    name: str, work: str, changed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(work, lambda *_: done.append("rehearsed"))
    preset = load_preset("small")
    sensors = [replace(preset, sensor=replace(preset.sensor, pulse_count=n)).make_sensor() for n in (33, 35)]
    settings = STAGES[name].settings()
    stages = [STAGES[name](settings) for _ in range(2)]
    for sensor in sensors:
        for one in stages:
            one.rehearse_for(sensor, settings)
    stages[0].rehearse_for(sensors[0], settings.changed(latency_budget_s=7.0))  # processing stays as it is
    assert len(done) == len(sensors)
    stages[0].rehearse_for(sensors[0], settings.changed(**{changed: 7.0}))
    assert len(done) == len(sensors) + 1
