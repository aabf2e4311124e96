"""Which passes go together, and the sentence on each that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pass_scenes import SMALL, flown

from sal_height.errors import UserError
from sal_height.passes import Pass, together

ORIGIN = np.zeros(3)


@pytest.fixture(scope="module")
def passes() -> list[Pass]:
    return flown(np.random.default_rng(0), np.zeros((1, 3)))[:5]


def turned(one: Pass, degrees: float) -> Pass:
    """The pass flown farther along the circle."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(one, antenna=one.antenna @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]))


def test_passes_that_go_together_stay_whole(passes: list[Pass]) -> None:
    kept, refused = together(passes, ORIGIN)
    assert not refused
    assert [len(one.antenna) for one in kept] == [SMALL.pulses] * 5


def test_passes_are_cut_to_common_azimuths(passes: list[Pass]) -> None:
    kept, refused = together([turned(passes[0], 0.6), *passes[1:]], ORIGIN)
    assert not refused
    azimuths = np.array([Pass.bearing(ORIGIN, one.antenna[[0, -1]]) for one in kept])
    step = SMALL.arc / (SMALL.pulses - 1)
    assert np.ptp(azimuths, axis=0).max() < 1.01 * step
    assert [len(one.antenna) for one in kept] == pytest.approx([0.8 * SMALL.pulses] * 5, abs=1)
    assert all(one.history.samples.shape[1] == len(one.antenna) for one in kept)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda one: turned(one, 2.0), "all must have half of these in common"),
        (
            lambda one: replace(one, sensor=replace(one.sensor, wavelength=0.0306, config_hash="")),
            "wavelength is 0.0306",
        ),
        (lambda one: replace(one, sensor=replace(one.sensor, bandwidth=5e8, config_hash="")), "bandwidth 5e"),
        (lambda one: one.moved(np.array([30.0, 0.0, 0.0])), "off the range that it has recorded"),
        (lambda one: replace(one, sensor=replace(one.sensor, mode="stripmap", config_hash="")), "stripmap"),
    ],
    ids=["azimuth", "wavelength", "bandwidth", "ground", "strip"],
)
def test_a_pass_that_does_not_fit_is_left_out(passes: list[Pass], spoil: object, why: str) -> None:
    """Even if it is the first, which is no better than the others."""
    for number in (0, 3):
        given = list(passes)
        given[number] = spoil(given[number])  # type: ignore[operator]
        kept, (sentence,) = together(given, ORIGIN)
        assert len(kept) == 4
        assert sentence.startswith(f"Pass {passes[number].name} is left out: ")
        assert why in sentence


@pytest.mark.parametrize("share", [0.5, 0.45])
def test_passes_that_only_together_leave_too_little_are_thinned(passes: list[Pass], share: float) -> None:
    """One half of the arc ahead, one behind: each shares half with most passes, and hardly a pulse with the other."""
    degrees = share * np.degrees(SMALL.arc)
    kept, (sentence,) = together([turned(passes[0], degrees), turned(passes[1], -degrees), *passes[2:]], ORIGIN)
    assert len(kept) == 4
    assert "all must have half of these in common" in sentence
    assert min(len(one.antenna) for one in kept) >= 0.5 * SMALL.pulses - 1


def test_too_few_passes_are_refused(passes: list[Pass]) -> None:
    with pytest.raises(UserError, match=r"^1 pass was given; heights need 3 or more"):
        together(passes[:1], ORIGIN)
    with pytest.raises(UserError, match=r"Of 3 passes 2 can be used; 3 are needed. Pass pass_1 is left out"):
        together([turned(passes[0], 10.0), *passes[1:3]], ORIGIN)
