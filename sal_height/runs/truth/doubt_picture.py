"""The picture of the doubts of a run: their tests over its dwells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize

from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, Bool
from sal_height.picture import FAULT, SIGMAS, colour_bar, page, title_of

MOST_DECADES = 12.0
"""Greatest -log10 of a probability that is distinguished."""


def fit_over_dwells(images: Sequence[HeightImage]) -> tuple[list[str], F64, Bool]:
    """Names of what was tested or doubted, and both over the dwells.

    Args:
        images: height images of one estimator, in the order of the dwells.

    Returns:
        Names; -log10 of the least probability of the tests of each name, NaN where it was not tested, shape (names,
        dwells); True where there is a doubt of that name, same shape.
    """
    names = list(dict.fromkeys(one.name for image in images for one in (*image.fit, *image.doubts)))
    decades = np.full((len(names), len(images)), np.nan)
    doubted = np.zeros(decades.shape, np.bool_)
    for dwell, image in enumerate(images):
        for test in image.fit:
            here = names.index(test.name), dwell
            decades[here] = np.fmax(decades[here], -np.log10(max(test.p_value, 10**-MOST_DECADES)))
        for doubt in image.doubts:
            doubted[names.index(doubt.name), dwell] = True
    return names, decades, doubted


def draw_doubts(images: Mapping[str, Sequence[HeightImage]], path: Path) -> bool:
    """Write a PNG of every estimator that has doubts, its tests over its dwells; False: there are none, and no picture.

    Args:
        images: height images by estimator.
        path: PNG file to write.
    """
    doubted = {name: some for name, some in images.items() if any(image.doubts for image in some)}
    if not doubted:
        return False
    drawn = {name: fit_over_dwells(some) for name, some in doubted.items()}
    scale = Normalize(0.0, MOST_DECADES)
    with page(path, 1.4 + sum(0.5 + 0.25 * len(names) for names, *_ in drawn.values())) as figure:
        heights = [len(names) + 2 for names, *_ in drawn.values()]
        axes = figure.subplots(len(drawn), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axis, (estimator, (names, decades, doubts)) in zip(axes, drawn.items(), strict=True):
            shown = axis.imshow(decades, SIGMAS, scale, aspect="auto", interpolation="nearest")
            row, dwell = np.nonzero(doubts)
            axis.plot(dwell, row, "x", color=FAULT, ls="", label="doubt")
            axis.set(facecolor="0.85", title=title_of(estimator))
            axis.set_yticks(range(len(names)), names)
            axis.locator_params(axis="x", integer=True)
        axes[-1].set_xlabel("dwell")
        known = np.concatenate([decades.ravel() for _, decades, _ in drawn.values()])
        colour_bar(shown, list(axes), "-log10 of the probability if the dwell is as described", known)
        figure.suptitle("Tests of the dwells (grey: not tested), and doubts (crosses)")
    return True
