"""The cut through vegetation that `sal-height tomogram` draws from the images of a bag."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from helpers import assert_one_sentence
from rewritten_bag import rewritten

from sal_height.errors import UserError
from sal_height.runs.products.tomogram import TomogramCut, _sides_of, tomogram

LOOKS = (12, 12)


def test_cut_is_drawn_over_street_without_canopy(with_images: Path, tmp_path: Path) -> None:
    """No ground is told where there is no canopy, or too few pixels to say; the colours show something."""
    told = tomogram(with_images, tmp_path / "out", LOOKS, None)
    assert 0 <= told <= 2
    picture = matplotlib.image.imread(tmp_path / "out" / "tomogram.png")
    assert np.ptp(picture[..., :3]) == pytest.approx(1.0, abs=0.01)


def test_row_beyond_the_image_is_refused(with_images: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError) as refusal:
        tomogram(with_images, tmp_path / "out", LOOKS, 4)
    assert_one_sentence(str(refusal.value), "--row is 4", "rows 0 to 3")
    assert not (tmp_path / "out").exists()


def test_bag_without_images_and_without_phase_history_is_refused(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(recorded / "bag", tmp_path / "bag", lambda one, _: None if one.topic == "/phase_history" else one)
    with pytest.raises(UserError) as refusal:
        tomogram(bag, tmp_path / "out", LOOKS, None)
    assert_one_sentence(str(refusal.value), "no images of all channels", "no phase history")


def test_columns_next_to_each_other_meet_and_far_ones_do_not() -> None:
    """Three dwells of one column: the first two are 10.4 m apart, and the third is a gap away."""
    nodes = np.zeros((1, 2, 3))
    cuts = [
        TomogramCut(np.array([along]), 10.0, nodes, {}, np.array([np.nan]), np.array([np.nan]))
        for along in (10.4, 0.0, 50.0)
    ]
    sides = _sides_of(cuts)
    np.testing.assert_allclose(np.concatenate(sides), [[5.2, 15.4], [-5.0, 5.2], [45.0, 55.0]])
