"""Regions of pure speckle: where an image holds nothing but a circular Gaussian field of even brightness.

The PSF paper picks them by eye (section 3). Here every tile of the image takes two tests of its intensity I, beside
those of its numbers. Both know how many of its pixels are independent, from the field's own correlation rho, which
brightness does not change: the intensities of a circular Gaussian field at a distance l correlate by |rho(l)|^2, and
their Laguerre polynomials of degree n by |rho(l)|^2n.

    moment    <I^2> / <I>^2 is 2 (Rayleigh amplitude; contrast 0.5227). With degree 2, its variance over N pixels is
              4 sum |rho|^4 / N, its bias -2 sum |rho|^2 / N, and its skewness that of N_e = N / sum |rho|^4
              independent pixels, 10 / sqrt(N_e): Pearson's type III.
    white     neighbouring pixels do not correlate: receiver noise, or a response that fills all frequencies evenly,
              from which it cannot be told. Such tiles do not show the response.
    texture   the variance of the mean intensities of blocks: that of speckle is <I>^2 sum |rho|^2 / pixels, summed up
              within a block; more than that is intensity that correlates where the field does not. Chi-square, with
              the degrees of freedom that the kurtosis of gamma-distributed means leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.special import chdtrc, gammainc, gammaincc

from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C64, C128, F64, U8, WORKERS, Bool, Index, compiled, in_parallel

TILE = (64, 64)
"""Rows and columns of the sub-images of the PSF paper."""

LEAST_TILE = 8
"""Fewer rows or columns than this make no tile."""

REASONS = ("pure", "not finite", "zero", "real", "clipped", "white", "moment", "texture", "beside a bright point")
"""What may become of a tile, in the order of the tests; the last is for those who know where bright points are."""

CLIPPED_SHARE = 1e-3
"""Share of the real and imaginary parts at a tile's greatest one from which on it is clipped."""

ZERO_SHARE = 5e-3
"""Share of the pixels from which on zeros are missing data, and not small numbers of a coarse quantiser."""

REACH = 16
"""Greatest lag, in pixels, at which the field's correlation is measured."""

NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Lags in rows and columns at which speckle that is sampled more finely than its band correlates."""

SAMPLED_TILES = 64
"""Most tiles from which the field's correlation is measured."""


@dataclass(frozen=True)
class SpeckleTiles:
    """Tiles of an image, side by side from its first pixel on, and what the tests say of them.

    Attributes:
        tile: rows and columns of each.
        verdict: indices into REASONS; shape (tiles down, tiles across).
        intensity: mean |g|^2 of each; the same shape.
        moment: <I^2> / <I>^2 of each, of speckle 2; the same shape.
        texture: variance of block means over that of speckle, of speckle 1; the same shape.
        correlation: rho of the field at lags up to REACH, or the tile less 1, lag (0, 0) in the middle, and the Doppler
            centroid taken out; 0 where it does not stand out of its error; shape (lags down, lags across).
        significance: of each of the two tests: share of tiles of pure speckle that it loses.
    """

    tile: tuple[int, int]
    verdict: U8
    intensity: F64
    moment: F64
    texture: F64
    correlation: C128
    significance: float

    @property
    def pure(self) -> Bool:
        """Where all tests are passed, shape (tiles down, tiles across)."""
        return self.verdict == 0

    def counts(self) -> dict[str, int]:
        """Number of tiles by REASONS."""
        return {reason: int(np.sum(self.verdict == index)) for index, reason in enumerate(REASONS)}


def find_pure_speckle(image: C64, tile: tuple[int, int] = TILE, significance: float = 0.001) -> SpeckleTiles:
    """Test every tile of an image; axis 0 is range, axis 1 azimuth.

    Args:
        image: complex pixels, shape (rows, cols).
        tile: rows and columns of a tile; the image's own where it has fewer. What is left beside whole tiles is not
            looked at.
        significance: share of the tiles of pure speckle that each of the two tests may lose.

    Raises:
        UserError: the image is not complex or not two-dimensional.
        NotDetermined: no tile is pure speckle.
    """
    image = checked_image(image)
    rows, cols = (min(most, size) for most, size in zip(tile, image.shape, strict=True))
    if min(rows, cols) < LEAST_TILE:
        raise NotDetermined(
            f"The image of {image.shape[0]} x {image.shape[1]} pixels, in tiles of {rows} x {cols}, shows no speckle; "
            f"tiles need {LEAST_TILE} pixels each way."
        )
    block = (max(4, rows // 8), max(4, cols // 8))
    sums, means = _tile_sums(image, (rows, cols), block)
    verdict = _unusable(sums, rows * cols)
    intensity = sums[..., 1] / (rows * cols)
    verdict[(verdict == 0) & (_white_tail(image, (rows, cols), intensity) >= significance)] = REASONS.index("white")
    correlation = _field_correlation(image, (rows, cols), np.argwhere(verdict == 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        moment = sums[..., 2] / (rows * cols) / intensity**2
        texture, texture_tail = _texture(means / intensity[..., None], correlation, (rows, cols), block)
        moment_tail = _moment_tail(moment, correlation, (rows, cols))
    verdict[(verdict == 0) & (moment_tail < significance)] = REASONS.index("moment")
    verdict[(verdict == 0) & (texture_tail < significance)] = REASONS.index("texture")
    found = SpeckleTiles((rows, cols), verdict, intensity, moment, texture, correlation, significance)
    if not found.pure.any():
        failed = ", ".join(f"{count} {reason}" for reason, count in found.counts().items() if count)
        raise NotDetermined(
            f"None of the {verdict.size} tiles of {rows} x {cols} pixels is pure speckle ({failed}); needed is one "
            f"whose intensity has the moment 2, and no texture, at a significance of {significance:g}, and whose "
            "neighbouring pixels correlate: those of receiver noise (white) do not."
        )
    return found


def checked_image(image: C64) -> C64:
    """The image in complex64, row by row; UserError if it is not complex or not two-dimensional."""
    if image.ndim != 2 or not np.iscomplexobj(image):
        raise UserError(f"The image has {image.ndim} axes of {image.dtype}; speckle needs 2 axes of complex pixels.")
    return np.ascontiguousarray(image, dtype=np.complex64)


def _tile_sums(image: C64, tile: tuple[int, int], block: tuple[int, int]) -> tuple[F64, F64]:
    """Of every tile: finite (0 or 1), sums of I and I^2, zero pixels, imaginary parts other than 0, greatest parts.

    Returns:
        These six, shape (tiles down, tiles across, 6), and mean intensities of blocks, (.., .., blocks).
    """
    down, across = image.shape[0] // tile[0], image.shape[1] // tile[1]
    sums = np.zeros((down, across, 6))
    means = np.zeros((down, across, (tile[0] // block[0]) * (tile[1] // block[1])))

    def measure(part: slice) -> None:
        for row in range(part.start, part.stop):
            strip = image[row * tile[0] : (row + 1) * tile[0], : across * tile[1]]
            finite = np.isfinite(strip.view(np.float32)).all(axis=0).reshape(across, -1).all(axis=1)
            _measure_strip(strip, tile[1], block, sums[row], means[row])
            sums[row, :, 0] = finite

    in_parallel(measure, down)
    return sums, means


@compiled
def _measure_strip(strip: C64, width: int, block: tuple[int, int], sums: F64, means: F64) -> None:
    down, across = strip.shape[0] // block[0], width // block[1]
    for tile in range(sums.shape[0]):
        pixels = strip[:, tile * width : (tile + 1) * width]
        total, square, greatest = 0.0, 0.0, np.float32(0)
        zeros, imaginary, top = 0, 0, 0
        for i in range(pixels.shape[0]):
            for j in range(width):
                real, imag = pixels[i, j].real, pixels[i, j].imag
                power = real * real + imag * imag
                total += power
                square += np.float64(power) * power
                zeros += power == 0
                imaginary += imag != 0
                greatest = max(greatest, abs(real), abs(imag))
        limit = greatest * np.float32(1 - 1e-6)
        for i in range(pixels.shape[0]):
            for j in range(width):
                top += (abs(pixels[i, j].real) >= limit) + (abs(pixels[i, j].imag) >= limit)
        for i in range(down):
            for j in range(across):
                mean = 0.0
                for row in range(i * block[0], (i + 1) * block[0]):
                    for col in range(j * block[1], (j + 1) * block[1]):
                        mean += pixels[row, col].real ** 2 + pixels[row, col].imag ** 2
                means[tile, i * across + j] = mean / (block[0] * block[1])
        sums[tile, 1], sums[tile, 2], sums[tile, 3] = total, square, zeros
        sums[tile, 4], sums[tile, 5] = imaginary, top


def _unusable(sums: F64, pixels: int) -> U8:
    """Verdict from the numbers alone, 0 where nothing is wrong with them."""
    clipped = sums[..., 5] >= max(3, CLIPPED_SHARE * 2 * pixels)
    wrong = [sums[..., 0] == 0, sums[..., 3] > ZERO_SHARE * pixels, sums[..., 4] == 0, clipped]
    return np.select(wrong, [1, 2, 3, 4], 0).astype(np.uint8)


def _field_correlation(image: C64, tile: tuple[int, int], usable: Index) -> C128:
    """Correlation of the field: the median over some of the usable tiles, so that a few bright ones do not tell.

    The error of a lag has the power sum |rho|^2 / pixels or less; what is not above 9 times that is 0.
    """
    reach = (min(REACH, tile[0] - 1), min(REACH, tile[1] - 1))
    middle = np.zeros((2 * reach[0] + 1, 2 * reach[1] + 1), dtype=np.complex128)
    middle[reach] = 1
    if not len(usable):
        return middle
    chosen = usable[np.linspace(0, len(usable) - 1, min(SAMPLED_TILES, len(usable))).round().astype(int)]
    corners = chosen * np.array(tile)
    chips = np.stack([image[row : row + tile[0], col : col + tile[1]] for row, col in corners])
    size = (tile[0] + reach[0], tile[1] + reach[1])
    power = np.abs(scipy.fft.fft2(chips, size, workers=WORKERS)) ** 2
    lags = [np.arange(-most, most + 1) for most in reach]
    pairs = np.outer(tile[0] - np.abs(lags[0]), tile[1] - np.abs(lags[1]))
    covariance = scipy.fft.ifft2(power, workers=WORKERS)[:, lags[0][:, None], lags[1]] / pairs
    turn = np.angle(covariance[:, reach[0], reach[1] + 1])
    covariance *= np.exp(-1j * turn[:, None, None] * lags[1]) / covariance[:, reach[0], reach[1]].real[:, None, None]
    rho = np.median(covariance.real, axis=0) + 1j * np.median(covariance.imag, axis=0)
    error = np.sum(np.abs(rho) ** 2) / (len(chips) * pairs)
    return np.where(np.abs(rho) ** 2 > 9 * error, rho, 0)


def _white_tail(image: C64, tile: tuple[int, int], intensity: F64) -> F64:
    """Probability that neighbouring pixels of white noise correlate as much as those of each tile, or more.

    The correlation of n pairs of pixels of a white circular Gaussian field is circular Gaussian of power 1 / n; the
    sum of n |rho|^2 over the lags is a gamma variable. Shape (tiles down, tiles across); NaN where a tile has no power.
    """
    (down, across), (rows, cols) = intensity.shape, tile
    tiles = image[: down * rows, : across * cols].reshape(down, rows, across, cols)
    total = np.zeros(intensity.shape)
    for step, aside in NEIGHBOURS:
        here = tiles[:, : rows - step, :, max(0, -aside) : cols - max(0, aside)]
        there = tiles[:, step:, :, max(0, aside) : cols - max(0, -aside)]
        pairs = (rows - step) * (cols - abs(aside))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            total += np.abs(np.einsum("irjc,irjc->ij", here, there.conj())) ** 2 / (pairs * intensity**2)
    return gammaincc(len(NEIGHBOURS), total)


def sum_of_powers(correlation: C128, size: tuple[int, int], exponent: float, along: int | None = None) -> float:
    """Sum over the lags of a rectangle of |rho|^exponent, each times the share of its pixels that are that far apart.

    Args:
        correlation: rho, lag (0, 0) in the middle.
        size: rows and columns of the rectangle.
        exponent: 2 for means of intensity, 4 for its second moment.
        along: sum over the lags along this axis only; None: both.
    """
    down, across = (
        np.maximum(0, 1 - np.abs(np.arange(count) - count // 2) / side)
        for count, side in zip(correlation.shape, size, strict=True)
    )
    if along is not None:
        (across, down)[along][:] = np.arange(correlation.shape[1 - along]) == correlation.shape[1 - along] // 2
    return float(down @ np.abs(correlation) ** exponent @ across)


def _moment_tail(moment: F64, correlation: C128, tile: tuple[int, int]) -> F64:
    """Probability of a moment as far from 2 or farther, to both sides."""
    pixels = tile[0] * tile[1]
    independent = pixels / sum_of_powers(correlation, tile, 4)
    bias = -2 * sum_of_powers(correlation, tile, 2) / pixels
    shape = 4 * independent / 100
    gamma = np.maximum(0, shape + np.sqrt(shape) * (moment - 2 - bias) / np.sqrt(4 / independent))
    return np.minimum(1, 2 * np.minimum(gammainc(shape, gamma), gammaincc(shape, gamma)))


def _texture(means: F64, correlation: C128, tile: tuple[int, int], block: tuple[int, int]) -> tuple[F64, F64]:
    """Variance of the mean intensities of blocks, of tiles of mean 1, over that of speckle; probability of more."""
    count = means.shape[-1]
    of_block = sum_of_powers(correlation, block, 2) / (block[0] * block[1])
    of_tile = sum_of_powers(correlation, tile, 2) / (tile[0] * tile[1])
    ratio = np.var(means, axis=-1) / (of_block - of_tile)
    freedom = 2 / (2 / (count - 1) + 6 * of_block / count)
    return np.asarray(ratio), np.asarray(chdtrc(freedom, freedom * ratio))
