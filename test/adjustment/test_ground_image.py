"""How far two images of the same ground lie apart, against shifts that were put in."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.adjustment.ground_image import GroundImage, shift_between, vertex_of
from sal_height.numeric import F64

STEP, CELLS, BORDER = 0.1, 256, 16
RESOLUTION = np.array([0.34, 1.1])


def ground(
    points: F64, amplitudes: F64, shift: F64, rng: np.random.Generator, *, all_moves: bool = False
) -> GroundImage:
    """Bright points in speckle that no two images share, nor the phases and half of the power of the points.

    The speckle stays where it is, unless `all_moves`.
    """
    frequency = np.fft.fftfreq(CELLS, STEP)
    band = np.abs(frequency[:, None]) < 0.5 / RESOLUTION[0], np.abs(frequency) < 0.5 / RESOLUTION[1]
    spectrum = np.fft.fft2(rng.standard_normal((CELLS, CELLS, 2)) @ [1, 1j])
    if all_moves:
        spectrum *= np.exp(-2j * np.pi * (frequency[:, None] * shift[0] + frequency * shift[1]))
    phase = rng.uniform(0, 2 * np.pi, len(points))
    each = amplitudes * np.exp(rng.normal(0, 0.5, len(points)) + 1j * phase)
    east, north = (np.exp(-2j * np.pi * np.outer(frequency, place)) for place in (points + shift).T)
    image = np.fft.ifft2((spectrum + (east * each) @ north.T) * band[0] * band[1])
    power = np.abs(image[BORDER:-BORDER, BORDER:-BORDER]) ** 2
    return GroundImage(np.array([BORDER, BORDER]), STEP, power)


def trial(rng: np.random.Generator, shift: F64) -> tuple[F64, F64]:
    """Error of a shift, and its stated covariance."""
    points = rng.uniform(0, CELLS * STEP, (150, 2))
    amplitudes = 60 * rng.exponential(1.0, len(points))
    one, other = (ground(points, amplitudes, by, rng) for by in (shift, np.zeros(2)))
    found = shift_between(one, other, np.zeros(2), np.full(2, 3.0))
    assert found
    return found[0] - shift, found[1]


def test_errors_of_the_shift_are_as_stated() -> None:
    """Of 40 shifts; the jackknife states more than there is, by 0.1 to 0.6, as it does on the average (Efron, Stein).

    The root mean square of 40 errors is known to 11 %.
    """
    rng = np.random.default_rng(5)
    errors, covariances = map(np.array, zip(*(trial(rng, rng.uniform(-2, 2, 2)) for _ in range(40)), strict=True))
    rms = np.sqrt(np.mean(errors**2, axis=0))
    stated = np.sqrt(np.mean(covariances, axis=0).diagonal())
    assert np.all(rms < [0.012, 0.035]), "a tenth of the resolution"
    assert np.all((rms / stated > 0.5) & (rms / stated < 1.1)), rms / stated
    assert np.all(np.abs(errors.mean(axis=0)) < 3 * rms / np.sqrt(40))


@pytest.mark.parametrize("cells", [0.0, 0.25, 0.5, 0.75])
def test_a_part_of_a_cell_is_found(cells: float) -> None:
    """To 0.03 of a cell where nothing else differs: what SAMPLING states."""
    rng = np.random.default_rng(6)
    points, amplitudes = rng.uniform(0, CELLS * STEP, (150, 2)), 60 * rng.exponential(1.0, 150)
    shift = cells * STEP * np.ones(2)
    one, other = (ground(points, amplitudes, by, np.random.default_rng(7), all_moves=True) for by in (shift, 0 * shift))
    found = shift_between(one, other, np.zeros(2), np.full(2, 1.0))
    assert found
    np.testing.assert_allclose(found[0], shift, atol=0.03 * STEP)


def test_other_ground_is_not_taken_for_the_same() -> None:
    rng = np.random.default_rng(8)
    for _ in range(6):
        one, other = (ground(rng.uniform(0, 30, (150, 2)), np.full(150, 60.0), np.zeros(2), rng) for _ in range(2))
        assert shift_between(one, other, np.zeros(2), np.full(2, 10.0)) is None


def test_a_shift_out_of_reach_and_a_narrow_overlap_tell_nothing() -> None:
    rng = np.random.default_rng(9)
    points = rng.uniform(0, 30, (150, 2))
    one, other = (ground(points, np.full(150, 60.0), by, rng) for by in (np.array([2.0, 0.0]), np.zeros(2)))
    assert shift_between(one, other, np.zeros(2), np.full(2, 1.0)) is None
    strip = GroundImage(other.first, STEP, other.power[:60])
    assert shift_between(one, strip, np.array([2.0, 0.0]), np.full(2, 1.0)) is None


def test_an_image_without_power_has_no_contrast() -> None:
    for power in (np.full((30, 30), np.nan), np.zeros((30, 30))):
        assert not GroundImage(np.zeros(2, np.int64), STEP, power).contrast.any()


def test_vertex_of_a_paraboloid_is_exact() -> None:
    east, north = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij")
    off = np.stack([east - 0.3, north + 0.2])
    np.testing.assert_allclose(vertex_of(-2 * off[0] ** 2 - off[1] ** 2 + 0.7 * off[0] * off[1]), [0.3, -0.2])
    assert np.isnan(vertex_of(off[0] ** 2 - off[1] ** 2)).all()
