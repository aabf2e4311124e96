"""Multi-looking: the channels' covariance in each height pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Looks:
    """Sum over looks of the outer product of the channels; rows and cols are those of the height image.

    Attributes:
        covariance: Re sum_k g_k g_k^H, shape (rows, cols, channels, channels). The imaginary part plays no role,
            because the beams are real (physics: Q(theta) = a^T Re(R) a).
        count: number of looks K.
        row: power-weighted mean row of the looks, in SLC pixels, shape (rows, cols); the middle where there is none.
        col: power-weighted mean column.
        finite: False where a sample was NaN or infinite (covariance is 0 there), shape (rows, cols).
    """

    covariance: Array
    count: int
    row: Array
    col: Array
    finite: npt.NDArray[np.bool_]


def multilook(slc: npt.NDArray[np.complex64], range_looks: int, azimuth_looks: int) -> Looks:
    """Average blocks of `range_looks` x `azimuth_looks` pixels; remainders at the far edges are left out.

    On sloping ground the looks of a block come from different ranges and elevations; the power-weighted centre tells
    which range the angle estimate, itself weighted by power, belongs to.

    Args:
        slc: images of all channels, shape (channels, rows, cols).
        range_looks: block height, pixels.
        azimuth_looks: block width, pixels.

    Raises:
        UserError: a look count below 1 or larger than the image.
    """
    channels, rows, cols = slc.shape
    if not (1 <= range_looks <= rows and 1 <= azimuth_looks <= cols):
        raise UserError(
            f"Looks are {range_looks} x {azimuth_looks} in an image of {rows} x {cols} pixels; "
            "each must be 1 or more and fit in the image."
        )
    high, wide = rows // range_looks, cols // azimuth_looks
    blocks = slc[:, : high * range_looks, : wide * azimuth_looks].reshape(
        channels, high, range_looks, wide, azimuth_looks
    )
    looks = blocks.transpose(1, 3, 0, 2, 4).reshape(high, wide, channels, -1).astype(np.complex128)
    finite = np.asarray(np.isfinite(looks).all(axis=(-2, -1)))
    looks[~finite] = 0
    parts = np.concatenate([looks.real, looks.imag], axis=-1)
    power = np.sum(np.abs(looks) ** 2, axis=2)
    power[power.sum(axis=-1) == 0] = 1
    weight = power / power.sum(axis=-1, keepdims=True)
    down, across = np.divmod(np.arange(range_looks * azimuth_looks), azimuth_looks)
    return Looks(
        covariance=parts @ np.swapaxes(parts, -1, -2),
        count=range_looks * azimuth_looks,
        row=np.arange(high)[:, None] * range_looks + weight @ down,
        col=np.arange(wide)[None, :] * azimuth_looks + weight @ across,
        finite=finite,
    )
