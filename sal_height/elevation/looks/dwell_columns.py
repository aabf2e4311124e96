"""Which columns of an image belong to which dwell, where several dwells are estimated side by side (`dwells`)."""

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
    """Dwells of equal width, side by side in one image: the pixels of one are no neighbours of those of another.

    Attributes:
        dwells: number of dwells.
        cols: number of columns of each.
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
            values: of all columns, which are the last axis, or the second one of (rows, cols, ...).
        """
        if self.dwells == 1:
            return [values]
        if values.ndim == 1:
            return [values[part] for part in self.slices]
        return [np.ascontiguousarray(values[:, part]) for part in self.slices]

    def each(self, function: Callable[..., Values], *values: Values) -> Values:
        """What a function makes of the values of each dwell alone, side by side.

        For what depends on the other pixels of a dwell, and for matrix products over pixels, which BLAS rounds as
        their number demands.

        Args:
            function: of arrays of one dwell, returns an array whose last axis is that of its columns.
            values: arrays as of `split`.
        """
        found = [function(*one) for one in zip(*map(self.split, values), strict=True)]
        return found[0] if self.dwells == 1 else np.concatenate(found, axis=-1)

    def mean_of_neighbours(self, values: F64, size: int) -> F64:
        """Mean over `size` x `size` pixels about each one; those at the border of a dwell stand for what is beyond.

        Args:
            values: shape (n, rows, cols): n images.
            size: in pixels, odd.
        """
        by_dwell = values.reshape(*values.shape[:2], self.dwells, self.cols)
        mean: F64 = uniform_filter(by_dwell, size, axes=(1, 3), mode="nearest")
        return mean.reshape(values.shape)
