"""The Doppler centroid along the columns of images, and images turned until all columns have the same.

The centroid moves with the column where the antenna swings, and over a spotlight image whose azimuth phase is left in
it. A response that is pooled over columns needs one band in azimuth. The mean product of neighbouring columns has the
phase 2 pi times the centroid in cycles per pixel (Madsen, "Estimating the Doppler centroid of SAR data", IEEE Trans.
AES 25, 1989). Pixels count by their phase alone, so that bright points do not outweigh the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from sal_height.numeric import C128, F64, Complex


def steadied(images: Sequence[Complex]) -> tuple[list[Complex], list[F64]]:
    """Turn the pixels until all columns of all images have the Doppler centroid of their mean.

    Args:
        images: complex pixels, range along axis 0, shapes (rows, cols).

    Returns:
        The images, the same objects if the centroid does not move significantly; and for each image what was subtracted
        from the centroid between each column and the next, cycles per pixel, shape (cols - 1,).
    """
    measured = [_neighbours(image) for image in images]
    mean = sum((products.sum() for products, _ in measured), 0j)
    relative = [products * np.exp(-1j * np.angle(mean)) for products, _ in measured]
    # The centroid of a column moves if it differs from the mean by six standard errors.
    moved = [np.any(np.abs(one.imag) > 6.0 * error) for one, (_, error) in zip(relative, measured, strict=True)]
    if not any(moved):
        return list(images), [np.zeros(len(one)) for one in relative]
    turns = [np.angle(one) for one in relative]
    phasors = (np.exp(-1j * np.cumsum(np.append(0.0, turn))).astype(np.complex64) for turn in turns)
    turned = [image * phasor for image, phasor in zip(images, phasors, strict=True)]
    return turned, [turn / (2 * np.pi) for turn in turns]


def _neighbours(image: Complex) -> tuple[C128, float]:
    """Mean product of each column and the next, smoothed along the columns, and the standard error of its parts."""
    amplitude = np.abs(image)
    phasors = np.zeros(image.shape, dtype=np.complex64)
    np.divide(image, amplitude, out=phasors, where=np.isfinite(amplitude) & (amplitude > 0), casting="same_kind")
    products = np.einsum("rc,rc->c", phasors[:, 1:], phasors[:, :-1].conj()).astype(np.complex128)
    # A phase that is quadratic over the image would cancel in the mean: it is taken out first and put back.
    bend = np.angle(np.sum(products[1:] * products[:-1].conj()))
    straight = products * np.exp(-1j * bend * np.arange(len(products)))
    columns = 65  # about those of a tile of speckle
    smooth = uniform_filter1d(straight, columns, mode="constant")
    error = np.sqrt(np.mean(np.abs(straight - smooth) ** 2) / (2 * columns)) if len(products) else 0.0
    return smooth * np.exp(1j * bend * np.arange(len(products))), float(error)
