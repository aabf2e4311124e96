"""Models of a pixel side by side: how uncertain a height is that may be that of any of them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, circular, elevation_at

from sal_height.elevation.extended import ExtendedSurfaces, Surfaces, explained_by
from sal_height.elevation.likelihood import OBJECTIVES
from sal_height.elevation.models import MOST, Models
from sal_height.elevation.order import ONE, THREE, TWO
from sal_height.elevation.search import PeakSearch, PeakSearches
from sal_height.elevation.several import SeveralScatterers, search_several


def test_deviation_is_that_over_all_probable_models() -> None:
    """One scatterer at 0 or two at 1 and 3, of probabilities .6 and .2; what was not fitted does not count."""
    elevation, sigma, cnr, spread = np.full((4, 5, 1, MOST), np.nan)
    elevation[ONE, 0, 0], sigma[ONE, 0, 0] = 0.0, 0.5
    elevation[TWO, 0, :2], sigma[TWO, 0, :2] = (1.0, 3.0), (0.2, 0.1)
    rest = np.zeros((5, 1))
    models = Models(elevation, sigma, cnr, spread, rest, rest, rest)
    probability = np.zeros((1, 5))
    probability[0, [ONE, TWO, THREE]] = 0.6, 0.2, 0.2
    of_one = models.deviation(elevation[ONE], probability)
    assert of_one[0, 0] == pytest.approx(np.sqrt(0.75 * 0.5**2 + 0.25 * (0.2**2 + 1)))
    assert np.isnan(of_one[0, 1:]).all()
    of_two = models.deviation(elevation[TWO], probability)
    assert of_two[0, 0] == pytest.approx(np.sqrt(0.75 * (0.5**2 + 1) + 0.25 * 0.2**2))
    assert of_two[0, 1] == pytest.approx(np.sqrt(0.75 * (0.5**2 + 9) + 0.25 * 0.1**2))


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
