"""Vertices of parabolas through three values."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.numeric import vertex


def test_vertex_and_bend_are_those_of_the_parabola() -> None:
    """9 - 2 (x - x_0)^2 has the bend 4 and its vertex at x_0; beyond one step that is where it is cut off."""
    place = np.array([-1.5, -0.3, 0.0, 0.49, 2.0])
    off, bend = vertex(*(9 - 2 * (x - place) ** 2 for x in (-1.0, 0.0, 1.0)))
    np.testing.assert_allclose(off, [-1.0, -0.3, 0.0, 0.49, 1.0], atol=1e-12)
    np.testing.assert_allclose(bend, 4.0)


@pytest.mark.parametrize("values", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0)])
def test_equal_values_have_their_peak_in_the_middle(values: tuple[float, float, float]) -> None:
    off, bend = vertex(*map(np.float64, values))
    assert off == 0.0
    assert 0.0 < bend < 1e-9
