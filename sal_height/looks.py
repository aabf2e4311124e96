"""Multi-looking: the channels' covariance in each height pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sal_height.compiled import compiled, in_parallel
from sal_height.errors import Rejected, UserError

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]
Covariance: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.complex64]

SAMPLES_AT_ONCE = 2**16
"""Samples that a thread brings together at a time: what fits into a processor's cache."""


@dataclass(frozen=True)
class Looks:
    """Sum over looks of the outer product of the channels; rows and cols are those of the height image.

    Attributes:
        covariance: sum_k g_k g_k^H, shape (rows, cols, channels, channels): complex64, or its real part as float32.
            Real beams need no more (a^T R a = a^T Re(R) a for any real a).
        count: number of looks K.
        row: power-weighted mean row of the looks, in SLC pixels, shape (rows, cols); the middle where there is none.
        col: power-weighted mean column.
        finite: False where a sample was NaN or infinite (covariance is 0 there), shape (rows, cols).
    """

    covariance: Covariance
    count: int
    row: Array
    col: Array
    finite: npt.NDArray[np.bool_]


def covariance(samples: ComplexArray, hermitian: bool) -> Covariance:
    """Sum over looks of g g^H, summed in single precision: the error grows as 6e-8 times the number of looks.

    Runs in the calling thread alone.

    Args:
        samples: g, shape (pixels, looks, channels), C-contiguous; finite.
        hermitian: all of it, as complex beams need (`Beams.is_complex`), or the real part only.

    Returns:
        Shape (pixels, channels, channels), complex64 if `hermitian`, otherwise float32.
    """
    pixels, _, channels = samples.shape
    numbers = samples.view(np.float32)
    zero, one = np.float32(0), np.float32(1)
    real = np.empty((pixels, channels, channels), dtype=np.float32)
    _real_parts(numbers, one, zero, real)
    if not hermitian:
        return real
    imaginary = np.empty_like(real)
    _real_parts(numbers, zero, one, imaginary)
    return real + np.complex64(1j) * imaginary


def live_detectors(slc: ComplexArray) -> npt.NDArray[np.intp]:
    """Numbers of the channels of `slc` (channels, rows, cols) with a finite sample other than 0 anywhere.

    Raises:
        Rejected: there are fewer than two.
    """
    live = [m for m, image in enumerate(slc) if any(np.any(np.isfinite(row) & (row != 0)) for row in image)]
    if len(live) < 2:
        raise Rejected(
            "dead detectors",
            f"Of {len(slc)} detectors {len(live)} have a finite sample other than 0 in the images; elevation needs 2 "
            "or more.",
        )
    return np.array(live)


def multilook(
    slc: ComplexArray,
    range_looks: int,
    azimuth_looks: int,
    hermitian: bool = False,
    transform: npt.NDArray[np.complexfloating] | None = None,
) -> Looks:
    """Average blocks of `range_looks` x `azimuth_looks` pixels; remainders at the far edges are left out.

    On sloping ground the looks of a block come from different ranges and elevations; the power-weighted centre tells
    which range the angle estimate, itself weighted by power, belongs to.

    Args:
        slc: images of all channels, shape (channels, rows, cols).
        range_looks: block height, pixels.
        azimuth_looks: block width, pixels.
        hermitian: whether the covariance is complex, as complex beams need it (`Beams.is_complex`).
        transform: matrix that the channels are multiplied by (`estimate.whitening`), shape (channels, channels); None:
            they stay as they are.

    Raises:
        UserError: a look count below 1 or larger than the image.
    """
    channels, rows, cols = slc.shape
    if not (1 <= range_looks <= rows and 1 <= azimuth_looks <= cols):
        raise UserError(
            f"Looks are {range_looks} x {azimuth_looks} in an image of {rows} x {cols} pixels; "
            "each must be 1 or more and fit in the image."
        )
    high, wide, count = rows // range_looks, cols // azimuth_looks, range_looks * azimuth_looks
    blocks = slc[:, : high * range_looks, : wide * azimuth_looks].reshape(
        channels, high, range_looks, wide, azimuth_looks
    )
    matrices = np.empty((high, wide, channels, channels), dtype=np.complex64 if hermitian else np.float32)
    power, finite = np.empty((high, wide, count)), np.empty((high, wide), dtype=np.bool_)
    rows_at_once = max(1, SAMPLES_AT_ONCE // (wide * count * channels))

    def work(piece: slice) -> None:
        for first in range(piece.start, piece.stop, rows_at_once):
            part = slice(first, min(first + rows_at_once, piece.stop))
            samples = (
                blocks[:, part].transpose(1, 3, 2, 4, 0).astype(np.complex64, order="C").reshape(-1, count, channels)
            )
            good = np.isfinite(samples).all(axis=(1, 2))
            samples[~good] = 0
            if transform is not None:
                samples = samples @ transform.T.astype(np.complex64)
            matrices[part] = covariance(samples, hermitian).reshape(matrices[part].shape)
            power[part] = np.sum(np.square(samples.view(np.float32)), axis=-1).reshape(power[part].shape)
            finite[part] = good.reshape(finite[part].shape)

    in_parallel(work, high, rows_at_once)
    power[power.sum(axis=-1) == 0] = 1
    weight = power / power.sum(axis=-1, keepdims=True)
    down, across = np.divmod(np.arange(count), azimuth_looks)
    return Looks(
        covariance=matrices,
        count=count,
        row=np.arange(high)[:, None] * range_looks + weight @ down,
        col=np.arange(wide)[None, :] * azimuth_looks + weight @ across,
        finite=finite,
    )


@compiled
def _real_parts(
    samples: npt.NDArray[np.float32], cosine: np.float32, sine: np.float32, result: npt.NDArray[np.float32]
) -> None:
    """Real part of g g^H exp(-j phase), with that `cosine` and `sine`, summed over looks.

    For samples g = x + j y, given as numbers x, y in turn along the channels.
    """
    channels = result.shape[1]
    x, y = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for i in range(len(samples)):
        matrix = result[i]
        matrix[:] = 0
        for k in range(samples.shape[1]):
            g = samples[i, k]
            for m in range(channels):
                x[m] = g[2 * m]
                y[m] = g[2 * m + 1]
            for m in range(channels):
                row, p, q = matrix[m], cosine * x[m] + sine * y[m], cosine * y[m] - sine * x[m]
                for n in range(channels):
                    row[n] += p * x[n] + q * y[n]
