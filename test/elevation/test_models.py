"""Models of a pixel side by side: how uncertain a height is that may be that of any of them."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.elevation.models import MOST, Models
from sal_height.elevation.order import ONE, THREE, TWO


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
