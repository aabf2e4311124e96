"""The columns of each dwell in an image of several dwells, which are estimated side by side (`dwells`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

from sal_height.numeric import F64

Values = npt.NDArray[Any]


@dataclass(frozen=True)
class DwellColumns:
    """Dwells of equal width, side by side in one image; pixels of different dwells are not neighbours.

    Attributes:
        dwells: number of dwells.
        cols: number of columns of a dwell.
    """

    dwells: int
    cols: int

    @property
    def slices(self) -> list[slice]:
        """The columns of each dwell."""
        return [slice(dwell * self.cols, (dwell + 1) * self.cols) for dwell in range(self.dwells)]

    def split(self, values: Values) -> list[Values]:
        """The values of each dwell, contiguous.

        Args:
            values: array whose last axis is the columns, or the second one in (rows, cols, ...).
        """
        if self.dwells == 1:
            return [values]
        if values.ndim == 1:
            return [values[part] for part in self.slices]
        return [np.ascontiguousarray(values[:, part]) for part in self.slices]

    def each(self, function: Callable[..., Values], *values: Values) -> Values:
        """Apply a function to the values of each dwell alone, and put its results side by side.

        For results that depend on the other pixels of a dwell, and for matrix products over pixels, whose rounding in
        BLAS depends on their number.

        Args:
            function: function of arrays of one dwell that returns an array whose last axis is the columns.
            values: arrays as in `split`.
        """
        found = [function(*one) for one in zip(*map(self.split, values), strict=True)]
        return found[0] if self.dwells == 1 else np.concatenate(found, axis=-1)

    def mean_of_neighbours(self, values: F64, size: int) -> F64:
        """Mean over `size` x `size` pixels around each pixel; a dwell is continued beyond its border by its edge.

        Args:
            values: n images, shape (n, rows, cols).
            size: side of the square, odd, pixels.
        """
        by_dwell = values.reshape(*values.shape[:2], self.dwells, self.cols)
        mean: F64 = uniform_filter(by_dwell, size, axes=(1, 3), mode="nearest")
        return mean.reshape(values.shape)
