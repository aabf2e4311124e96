"""Models of a pixel side by side: how uncertain a height is that may be that of any of them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, circular, elevation_at

from sal_height.elevation.array.likelihood import OBJECTIVES
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.layover._layover_kernels import deviation_over_models
from sal_height.elevation.layover.extended import ExtendedSurfaces, Surfaces, explained_by
from sal_height.elevation.layover.models import MOST, Models
from sal_height.elevation.layover.order import ONE, THREE, TWO
from sal_height.elevation.layover.several import SeveralScatterers, search_several
from sal_height.numeric import F64, Index


def test_deviation_is_that_over_all_probable_models() -> None:
    """One scatterer at 0 or two at 1 and 3, of probabilities .6 and .2; what was not fitted does not count."""
    elevation, sigma = np.full((2, 5, MOST), np.nan)
    elevation[ONE, 0], sigma[ONE, 0] = 0.0, 0.5
    elevation[TWO, :2], sigma[TWO, :2] = (1.0, 3.0), (0.2, 0.1)
    probability = np.zeros(5)
    probability[[ONE, TWO, THREE]] = 0.6, 0.2, 0.2
    found = [deviation_over_models(place, elevation, sigma, probability) for place in (0.0, 1.0, 3.0)]
    variance = 0.75 * 0.5**2 + 0.25 * (0.2**2 + 1), 0.75 * (0.5**2 + 1) + 0.25 * 0.2**2
    np.testing.assert_allclose(found, np.sqrt([*variance, 0.75 * (0.5**2 + 9) + 0.25 * 0.1**2]))
    assert np.isnan(deviation_over_models(0.0, elevation, sigma, np.eye(5)[THREE]))


def chosen_in_numpy(models: Models, taken: Index, probability: F64, limits: tuple[float, ...]) -> F64:
    """Twin of `choose_scatterers`."""
    first, last, least, greatest = limits
    found = np.stack([models.elevation, models.sigma, models.cnr, models.spread])[:, taken, np.arange(len(taken))]
    distance = np.abs(models.elevation[:, :, None] - found[0][:, :, None])  # models, pixels, chosen, scatterers
    nearest = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=-1)
    sigma = np.take_along_axis(models.sigma, nearest, axis=-1)
    square = sigma**2 + np.take_along_axis(distance, nearest[..., None], axis=-1)[..., 0] ** 2
    weight = np.where(np.isfinite(square), probability.T[:, :, None], 0.0)
    with np.errstate(invalid="ignore"):
        found[1] = np.sqrt(np.sum(weight * np.where(weight > 0, square, 0.0), axis=0) / weight.sum(axis=0))
    inside = (found[0] >= first) & (found[0] <= last) & (found[2] >= least) & (found[2] > 0)
    usable = inside & np.all((found[1] < greatest) | ~inside, axis=1, keepdims=True)
    order = np.argsort(np.where(usable, -found[2], np.inf), axis=1)
    return np.take_along_axis(np.where(usable, found, np.nan), order[None], axis=2)


def test_scatterers_are_chosen_as_in_numpy() -> None:
    """Models of 300 pixels with up to three scatterers, some outside, weak, undetermined or of infinite sigma."""
    rng, pixels = np.random.default_rng(91), 300
    elevation, sigma, cnr, spread = rng.uniform(0, 1, (4, 5, pixels, MOST))
    sigma[rng.random(sigma.shape) < 0.1] = np.inf
    fewer = np.arange(MOST) >= np.array([0, 1, 2, 3, 1])[:, None, None]
    for part in (elevation, sigma, cnr, spread):
        part[np.broadcast_to(fewer, part.shape)] = np.nan
    rest = np.zeros((5, pixels))
    models = Models(elevation, sigma, cnr, spread, rest, rest, rest, np.zeros((2, 5, pixels)))
    taken, probability = rng.integers(0, 5, pixels), rng.dirichlet(np.ones(5), pixels)
    found, inside, count = models.scatterers(taken, probability, (0.1, 0.9), 0.1, 0.8)
    expected = chosen_in_numpy(models, taken, probability, (0.1, 0.9, 0.1, 0.8))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_array_equal(count, np.isfinite(expected[0]).sum(axis=1))
    assert np.all(inside >= count)
    assert {0, 1, 2, 3} == set(count.tolist())
    assert np.any(inside > count)


@pytest.mark.parametrize("name", ["jinc", "complex"])
def test_pixels_of_several_squints_are_fitted_as_if_alone(name: str) -> None:
    """Two scatterers, and a surface, in each of twelve pixels at four squints, mixed; value for value."""
    rng, beams = np.random.default_rng(90), beams_named(name)
    squint = np.array([-0.3, 0.0, 0.1, 0.4])[rng.integers(0, 4, 12)] * BEAMWIDTH
    samples = circular(rng, (12, 4, beams.count))
    for offset in (-0.4, 0.5):
        samples += 3 * beams.response(elevation_at(np.full(12, offset)), squint)[:, None] * circular(rng, (12, 4, 1))
    covariance = np.einsum("pkm,pkn->pmn", samples, samples.conj())
    covariance = covariance if beams.is_complex else np.ascontiguousarray(covariance.real)
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], BEAMWIDTH)

    def fitted(search: PeakSearch, some: slice) -> list[np.ndarray]:
        pixels, looks = covariance[some], np.full(len(covariance[some]), 4.0)
        values, first = search.on_grid(pixels), search.peaks(pixels).elevation[:, None]
        elevation, explained, gain = search_several(search, pixels, values, first, np.zeros(len(pixels)))
        several = SeveralScatterers.at(search, pixels, looks, elevation)
        start = Surfaces(first[:, 0], np.full(len(pixels), 0.3 * BEAMWIDTH), np.full(len(pixels), 10.0))
        least = np.full(len(pixels), -np.inf)
        surfaces = ExtendedSurfaces.fit(search, pixels, looks, start, least, 8 * BEAMWIDTH, BEAMWIDTH)
        power, directions = explained_by(search, pixels, surfaces.found, BEAMWIDTH)
        return [elevation, explained, gain, several.sigma, several.power, *surfaces.found, power, directions]

    together = fitted(searches.at(squint), slice(None))
    for pixel in range(12):
        alone = fitted(searches.at(float(squint[pixel])), slice(pixel, pixel + 1))
        for all_of_them, one in zip(together, alone, strict=True):
            np.testing.assert_array_equal(all_of_them[pixel], one[0])
