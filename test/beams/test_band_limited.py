"""Interpolation of functions that an aperture limits in band."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sal_height.beams import band_limited
from sal_height.beams.band_limited import NODES, STEP, _nodes_around, interpolated

Array = npt.NDArray[np.float64]

BOUND = 3e-11
"""The error that the module states, of the greatest modulus."""


class Waves:
    """Plane waves of spatial frequencies up to 1/2 per axis, mostly the worst; of modulus 1 at most; counts samples."""

    def __init__(self, rng: np.random.Generator, *, real: bool) -> None:
        self.frequency = np.array([[0.5, 0.5], *rng.uniform(-0.5, 0.5, (7, 2))])
        self.amplitude = np.array([0.65, *rng.uniform(0, 0.05, 7)])
        self.real = real
        self.samples: list[int] = []

    def at(self, e: Array, a: Array) -> npt.NDArray:
        phase = 2 * np.pi * (np.multiply.outer(e, self.frequency[:, 0]) + np.multiply.outer(a, self.frequency[:, 1]))
        value = np.exp(1j * (phase + np.arange(8))) @ self.amplitude
        return value.real if self.real else value

    def __call__(self, x: Array, y: Array) -> npt.NDArray:
        self.samples.append(len(x) * len(y))
        return self.at(*np.meshgrid(x, y, indexing="ij"))

    @property
    def dtype(self) -> type:
        return np.float64 if self.real else np.complex128


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("reach", [0.3, 5.0, 20.0])
def test_band_limited_function_is_interpolated_within_the_bound(real: bool, reach: float) -> None:
    rng = np.random.default_rng(1)
    waves = Waves(rng, real=real)
    e, a = rng.uniform(-reach, reach, (2, 3000))
    values = interpolated(waves, waves.dtype, e, a)
    assert values.dtype == waves.dtype
    assert np.max(np.abs(values - waves.at(e, a))) < BOUND


@pytest.mark.parametrize("place", [0.0, 1 / 32, -1 / 32, 7.0, -1e-18, 1e-18, 0.03124999999999999])
def test_lone_value(place: float) -> None:
    waves = Waves(np.random.default_rng(2), real=True)
    value = interpolated(waves, np.float64, place, -place)
    assert value.shape == ()
    assert value == pytest.approx(waves.at(np.array(place), np.array(-place)), abs=BOUND)


def test_offsets_broadcast_and_those_that_are_not_finite_have_no_value() -> None:
    waves = Waves(np.random.default_rng(3), real=False)
    e, a = np.array([[0.1, np.nan, 3.0], [np.inf, 0.2, -1.0]]), np.array([[0.5], [-np.inf]])
    values = interpolated(waves, np.complex128, e, a)
    assert np.isnan(values).tolist() == [[False, True, False], [True, True, True]]
    np.testing.assert_allclose(values[0, [0, 2]], waves.at(e[0, [0, 2]], np.full(2, 0.5)), atol=BOUND)
    assert interpolated(waves, np.complex128, np.zeros((0, 3)), 0.0).shape == (0, 3)


def test_values_far_apart_need_few_samples() -> None:
    """Two clouds and two lone values thousands of beamwidths apart: a grid over all would have 1e11 samples."""
    rng = np.random.default_rng(4)
    waves = Waves(rng, real=True)
    e = np.concatenate([rng.uniform(-1, 1, 500), rng.uniform(4999, 5000, 500), [-9000.0, 123.4]])
    a = np.concatenate([rng.uniform(-1, 1, 500), rng.uniform(-8000, -7999, 500), [9000.0, 0.0]])
    values = interpolated(waves, np.float64, e, a)
    assert np.max(np.abs(values - waves.at(e, a))) < BOUND + 1e-10  # the phase itself is rounded to 1e-11
    assert sum(waves.samples) < band_limited.FEW_SAMPLES


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    waves = Waves(rng, real=True)
    e, a = rng.uniform(-2, 2, (2, 40, 25))
    whole = interpolated(waves, np.float64, e, a)
    monkeypatch.setattr(band_limited, "BLOCK", 77)
    monkeypatch.setattr(band_limited, "LEAST", 10)
    np.testing.assert_allclose(interpolated(waves, np.float64, e, a), whole, atol=2 * BOUND)


@pytest.mark.parametrize("node", range(-3, 4))
def test_an_offset_that_rounds_up_to_a_node_has_samples_all_around(node: int) -> None:
    """From another first node, the place of an offset just below a node may come out as the node itself."""
    x = np.array([-0.3, np.nextafter(node * STEP, -1)])
    nodes = _nodes_around(x)
    places = (x / STEP - nodes[0]).astype(int)
    assert places.min() - (NODES // 2 - 1) >= 0
    assert places.max() + NODES // 2 < nodes.size
