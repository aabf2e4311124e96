"""Regions of pure speckle: a circular Gaussian field of even brightness, and nothing else.

The PSF paper picks them by eye (section 3). Here every tile of the image takes three tests, in addition to those of its
numbers. Those of the intensity I use the number of independent pixels, from the field's own correlation rho,
which brightness does not change: the intensities of a circular Gaussian field at a distance l correlate by |rho(l)|^2,
and their Laguerre polynomials of degree n by |rho(l)|^2n.

    noise     if the power of receiver noise is known: the tile is too little above it. If it is not known: pixels that
              are neighbours in azimuth do not correlate. Receiver noise has passed the window over range frequency, but
              no antenna, so that it is white in azimuth; so is speckle whose response fills all azimuth frequencies
              evenly, and only the power of the noise distinguishes the two.
    moment    <I^2> / <I>^2 is 2 (Rayleigh amplitude; contrast 0.5227). With degree 2, its variance over N pixels is
              4 sum |rho|^4 / N, its bias -2 sum |rho|^2 / N, and its skewness that of N_e = N / sum |rho|^4
              independent pixels, 10 / sqrt(N_e): Pearson's type III.
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
from sal_height.numeric import C64, C128, F32, F64, U8, WORKERS, Bool, Index, in_parallel
from sal_height.settings import Settings, setting

TILE = (64, 64)  # rows and columns of the sub-images of the PSF paper
LEAST_TILE = 8  # fewer rows or columns than this make no tile
REACH = 16  # greatest lag, in pixels, at which the field's correlation is measured

REASONS = ("pure", "not finite", "zero", "real", "clipped", "like noise", "moment", "texture", "next to a bright point")
"""Verdicts on a tile, in the order of the tests; the last is for callers that know the positions of bright points."""


class SpeckleSettings(Settings):
    """Criteria for tiles of an image that count as pure speckle."""

    speckle_significance: float = setting(
        0.001,
        "fraction of tiles of speckle that each test of intensity rejects, and of images of noise with a tile "
        "that passes",
        minimum=1e-6,
        maximum=0.5,
    )
    speckle_over_noise_db: float = setting(
        3.0,
        "lowest power of a tile of speckle, with its noise, over that of receiver noise, if the latter is known",
        unit="dB",
        minimum=0.1,
        maximum=100.0,
    )


DEFAULTS = SpeckleSettings()


@dataclass(frozen=True, eq=False)
class SpeckleTiles:
    """Tiles of an image, side by side from its first pixel on, and the results of their tests.

    Attributes:
        tile: rows and columns of each tile.
        verdict: indices into REASONS; shape (tiles down, tiles across).
        intensity: mean |g|^2 of each tile; the same shape.
        correlation: rho of the field at lags up to REACH, or the tile less 1, lag (0, 0) in the middle, with the
            Doppler centroid removed; 0 where it is not significant; shape (lags down, lags across).
    """

    tile: tuple[int, int]
    verdict: U8
    intensity: F64
    correlation: C128

    @property
    def pure(self) -> Bool:
        """True for tiles that pass all tests, shape (tiles down, tiles across)."""
        return self.verdict == 0

    def counts(self) -> dict[str, int]:
        """Number of tiles by REASONS."""
        return {reason: int(np.sum(self.verdict == index)) for index, reason in enumerate(REASONS)}


def find_pure_speckle(
    image: C64,
    tile: tuple[int, int] = TILE,
    settings: SpeckleSettings = DEFAULTS,
    noise_power: float | None = None,
) -> SpeckleTiles:
    """Test every tile of an image; axis 0 is range, axis 1 azimuth.

    Args:
        image: complex pixels, shape (rows, cols).
        tile: rows and columns of a tile; the image's own where it has fewer. The rest beyond whole tiles does not
            count.
        settings: thresholds of the tests.
        noise_power: E|n|^2 of the receiver noise in a pixel; None: not known.

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
    down, across = image.shape[0] // rows, image.shape[1] // cols
    block = (max(4, rows // 8), max(4, cols // 8))
    verdict = np.zeros((down, across), dtype=np.uint8)
    intensity, moment, white = np.zeros((3, down, across))
    means = np.zeros((down, across, (rows // block[0]) * (cols // block[1])))

    def measure(part: slice) -> None:
        for row in range(part.start, part.stop):
            strip = image[row * rows : (row + 1) * rows, : across * cols].reshape(rows, across, cols)
            verdict[row] = _unusable(strip)
            with np.errstate(all="ignore"):  # of tiles that are not usable
                power = np.square(strip.real) + np.square(strip.imag)
                intensity[row] = power.mean(axis=(0, 2), dtype=np.float64)
                power /= intensity[row, :, None].astype(np.float32)
                moment[row] = np.mean(power**2, axis=(0, 2), dtype=np.float64)
                means[row] = _block_means(power, block)
                if noise_power is None:
                    white[row] = _white_tail(strip)

    in_parallel(measure, down)
    if noise_power is None:  # as rare in the whole image as the settings say
        noisy = white >= settings.speckle_significance / white.size
    else:
        noisy = intensity < noise_power * 10 ** (settings.speckle_over_noise_db / 10)
    verdict[(verdict == 0) & noisy] = REASONS.index("like noise")
    correlation = _field_correlation(image, (rows, cols), np.argwhere(verdict == 0))
    with np.errstate(all="ignore"):
        moment_tail = _moment_tail(moment, correlation, (rows, cols))
        texture_tail = _texture_tail(means, correlation, (rows, cols), block)
    verdict[(verdict == 0) & (moment_tail < settings.speckle_significance)] = REASONS.index("moment")
    verdict[(verdict == 0) & (texture_tail < settings.speckle_significance)] = REASONS.index("texture")
    found = SpeckleTiles((rows, cols), verdict, intensity, correlation)
    if not found.pure.any():
        raise NotDetermined(_why_none(found, noise_power))
    return found


def _why_none(tiles: SpeckleTiles, noise_power: float | None) -> str:
    """A message on an image without pure speckle: the verdicts on its tiles, and what is needed."""
    failed = ", ".join(f"{count} {reason}" for reason, count in tiles.counts().items() if count)
    need = (
        "at least one is needed, or the power of the receiver noise: where neighbours in azimuth do not correlate, "
        "only that separates speckle from noise"
        if noise_power is None and tiles.counts()["like noise"]
        else "at least one is needed, of even brightness and well above the noise"
    )
    size = f"{tiles.tile[0]} x {tiles.tile[1]}"
    return f"None of the {tiles.verdict.size} tiles of {size} pixels is pure speckle ({failed}); {need}."


def checked_image(image: C64) -> C64:
    """The image in complex64, row by row; UserError if it is not complex or not two-dimensional."""
    if image.ndim != 2 or not np.iscomplexobj(image):
        raise UserError(f"The image has {image.ndim} axes of {image.dtype}; speckle needs 2 axes of complex pixels.")
    return np.ascontiguousarray(image, dtype=np.complex64)


def _unusable(strip: C64) -> U8:
    """Verdict on tiles (rows, tiles, cols) from their numbers alone, 0 where nothing is wrong with them."""
    parts = np.abs(strip.view(np.float32))  # real and imaginary parts in turn
    greatest = parts.max(axis=(0, 2))
    at_greatest = np.count_nonzero(parts >= greatest[:, None] * np.float32(1 - 1e-6), axis=(0, 2))
    pixels = strip.shape[0] * strip.shape[2]
    wrong = [
        ~np.isfinite(greatest),
        np.count_nonzero(strip == 0, axis=(0, 2)) > 5e-3 * pixels,  # fewer are small numbers of a coarse quantiser
        ~strip.imag.any(axis=(0, 2)),
        at_greatest >= max(3, 1e-3 * 2 * pixels),
    ]
    return np.select(wrong, [1, 2, 3, 4], 0).astype(np.uint8)


def _block_means(power: F32, block: tuple[int, int]) -> F32:
    """Mean intensities of the whole blocks in tiles (rows, tiles, cols), shape (tiles, blocks)."""
    (rows, tiles, cols), (high, wide) = power.shape, block
    inside = power[: rows // high * high, :, : cols // wide * wide]
    return (
        inside.reshape(rows // high, high, tiles, cols // wide, wide)
        .mean(axis=(1, 4))
        .swapaxes(0, 1)
        .reshape(tiles, -1)
    )


def _white_tail(strip: C64) -> F64:
    """Probability that neighbours in azimuth of noise that is white there correlate as much as in each tile, or more.

    The correlation of n pairs of pixels is circular Gaussian of power sum |rho|^2 / n, summed over the lags in range,
    which is the mean square of the spectrum along range over its squared mean (Parseval).

    Args:
        strip: tiles, shape (rows, tiles, cols).
    """
    rows, _, cols = strip.shape
    spectrum = np.mean(np.abs(scipy.fft.fft(strip, axis=0)) ** 2, axis=2, dtype=np.float64)
    intensity, pairs = spectrum.mean(axis=0) / rows, rows * (cols - 1)
    rho = np.abs(np.einsum("itj,itj->t", strip[..., 1:], strip[..., :-1].conj())) / (pairs * intensity)
    return np.exp(-pairs * (rho * rows * intensity) ** 2 / np.mean(spectrum**2, axis=0))


def _field_correlation(image: C64, tile: tuple[int, int], usable: Index) -> C128:
    """Correlation of the field: the median over some of the usable tiles, robust to a few bright ones.

    The error of a lag has the power sum |rho|^2 / pixels or less; what is not above 9 times that is 0.
    """
    reach = (min(REACH, tile[0] - 1), min(REACH, tile[1] - 1))
    middle = np.zeros((2 * reach[0] + 1, 2 * reach[1] + 1), dtype=np.complex128)
    middle[reach] = 1
    if not len(usable):
        return middle
    chosen = usable[np.linspace(0, len(usable) - 1, min(64, len(usable))).round().astype(int)]
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


def sum_of_powers(correlation: C128, size: tuple[int, int], exponent: float) -> float:
    """Sum over the lags of a rectangle of |rho|^exponent, each times the fraction of pixels at that distance.

    Args:
        correlation: rho, lag (0, 0) in the middle; a single row or column of lags is that at lag 0.
        size: rows and columns of the rectangle.
        exponent: exponent, 2 for means of intensity, 4 for its second moment.
    """
    down, across = (
        np.maximum(0, 1 - np.abs(np.arange(count) - count // 2) / side)
        for count, side in zip(correlation.shape, size, strict=True)
    )
    return float(down @ np.abs(correlation) ** exponent @ across)


def _moment_tail(moment: F64, correlation: C128, tile: tuple[int, int]) -> F64:
    """Probability of a moment as far from 2 or farther, to both sides."""
    pixels = tile[0] * tile[1]
    independent = pixels / sum_of_powers(correlation, tile, 4)
    bias = -2 * sum_of_powers(correlation, tile, 2) / pixels
    shape = 4 * independent / 100
    gamma = np.maximum(0, shape + np.sqrt(shape) * (moment - 2 - bias) / np.sqrt(4 / independent))
    return np.minimum(1, 2 * np.minimum(gammainc(shape, gamma), gammaincc(shape, gamma)))


def _texture_tail(means: F64, correlation: C128, tile: tuple[int, int], block: tuple[int, int]) -> F64:
    """Probability that mean intensities of the blocks of speckle, in tiles of mean 1, vary as much or more."""
    count = means.shape[-1]
    of_block = sum_of_powers(correlation, block, 2) / (block[0] * block[1])
    of_tile = sum_of_powers(correlation, tile, 2) / (tile[0] * tile[1])
    freedom = 2 / (2 / (count - 1) + 6 * of_block / count)
    return np.asarray(chdtrc(freedom, freedom * np.var(means, axis=-1) / (of_block - of_tile)))
