"""The system's response from pure speckle: |R| over range frequency, |A| over azimuth frequency, the pointing.

Speckle scatters white, so that the power spectrum of its image is that of the response (PSF paper, eq. 2.6). A
sub-image of M pixels shows it through its own ends: its mean periodogram is |R|^2 convolved with the Fejer kernel,
which lifts the troughs of a sawtooth and the skirts of a band. In the autocovariance c(l) the same is a factor, the
triangle 1 - |l| / M; transforms of twice the length make the covariance at all lags known, and dividing by the triangle
undoes the kernel up to the resolution of M pixels (`AxisSpectrum.unfolded`).

The modulus that the paper averages, of 64 x 64 sub-images, is sqrt(pi) / 2 times the root of the mean periodogram, as
of any Rayleigh amplitude (`mean_modulus`).

The phase of c(1) along azimuth is the Doppler centroid in cycles per pixel, times 2 pi (Madsen, "Estimating the Doppler
centroid of SAR data", IEEE Trans. AES 25, 1989): the pointing of the antenna. It is common to sub-images from the same
columns, so that the swing of the antenna shows, and |A| is averaged after it has been removed.

Spectra start at -1/2 cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.linalg import toeplitz

from sal_height.numeric import C64, C128, F32, F64, Index, ShortRepr, blocks, frequencies, in_parallel
from sal_height.response.speckle_tiles import SpeckleTiles, checked_image, sum_of_powers


@dataclass(frozen=True)
class AxisSpectrum(ShortRepr):
    """Second-order statistics of speckle along one axis.

    Attributes:
        covariance: autocovariance at lags 0 to M - 1 over that at 0, M the pixels of a sub-image; white noise adds to
            lag 0, a spur is taken out.
        lines: number of lines of M pixels that were averaged.
        independent: number of independent lines among them, as neighbouring lines correlate.
        spur: power of a wave of half a cycle per pixel over the mean of the image; 0: no such wave.
    """

    covariance: C128
    lines: int
    independent: float
    spur: float = 0.0

    @property
    def power(self) -> F64:
        """Mean periodogram of the sub-images, no spur: |R|^2 convolved with Fejer's kernel; mean 1, shape (M,)."""
        return fejer_power(self.covariance)

    @property
    def standard_error(self) -> F64:
        """Standard error of `power`, shape (M,): `power` over the root of `independent`, as of periodograms."""
        return self.power / np.sqrt(self.independent)

    def unfolded(self, count: int) -> tuple[F64, F64]:
        """|R|^2 at `count` frequencies, of mean 1, without Fejer's kernel; and its standard error.

        The covariance at each lag is shrunk by its error, to 0 if that is half of it, so that undoing the kernel does
        not raise noise. The result may be negative by its error, which is that of the mean periodogram propagated
        through the division by the triangle; errors by structure finer than a sub-image, such as
        steps, are additional.
        """
        size = len(self.covariance)
        # Up to two standard errors the covariance at a lag is set to 0.
        lost = 4.0 * self._lag_variance / np.maximum(np.abs(self.covariance) ** 2, np.finfo(float).tiny)
        shrunk = self.covariance * np.maximum(0, 1 - lost)
        passed = np.where(lost < 1, np.sqrt(1 + lost**2), 0)
        lag = np.arange(1 - size, size)
        weight = passed[np.abs(lag)] / (1 - np.abs(lag) / size)
        apart = frequencies(count)[:, None] - frequencies(2 * size)
        undo = (np.exp(-2j * np.pi * apart[..., None] * lag) @ weight).real / (2 * size)
        covariance = periodogram_covariance(self.covariance, 2 * size)
        variance = np.einsum("fk,kl,fl->f", undo, covariance, undo, optimize=True) / self.independent
        return transform(shrunk, frequencies(count)), np.sqrt(np.maximum(variance, 0))

    @property
    def _lag_variance(self) -> F64:
        """Variance of the covariance at each lag, at most: sum |c|^2 over the independent pairs of pixels."""
        size = len(self.covariance)
        triangle = 1 - np.arange(size) / size
        total = 2 * np.sum(triangle * np.abs(self.covariance) ** 2) - 1
        return total / (self.independent * size * triangle)


@dataclass(frozen=True)
class Pointing(ShortRepr):
    """Pointing of the antenna along the track.

    Attributes:
        cols: middle columns of the tiles of speckle, pixels from the centre of the first column.
        displacement: Doppler centroid there, from -1/2 to 1/2, cycles per pixel.
        sigma: standard error of the displacement, cycles per pixel.
    """

    cols: F64
    displacement: F64
    sigma: F64


@dataclass(frozen=True)
class SpeckleSpectra(ShortRepr):
    """The response as estimated from speckle.

    Attributes:
        range: spectrum |R|^2 along axis 0.
        neighbours: covariance at lags 0 to M - 1 in range between pixels of neighbouring columns, in units of the mean
            power, the Doppler centroid taken out: that of |R|^2 alone, as noise that is white along azimuth averages
            out; a spur remains. M is the number of pixels of a sub-image.
        azimuth: spectrum |A|^2 along axis 1, averaged after the along-track changes of the pointing were removed.
        pointing: pointing of the antenna; None: the azimuth response is too flat to have a centre.
    """

    range: AxisSpectrum
    neighbours: C128
    azimuth: AxisSpectrum
    pointing: Pointing | None

    @property
    def noise_floor(self) -> float:
        """Power of white noise over the mean of the image: that of the quietest frequencies of the quieter axis.

        The quietest are one in eight. A pedestal of the response looks the same, and a flat response all the more; the
        least of estimates that err lies below what is true.
        """
        powers = [np.sort(axis.unfolded(len(axis.covariance))[0]) for axis in (self.range, self.azimuth)]
        return max(0.0, min(float(np.mean(power[: max(1, len(power) // 8)])) for power in powers))


def estimate_speckle_spectra(image: C64, tiles: SpeckleTiles) -> SpeckleSpectra:
    """Spectra of the tiles of pure speckle, each over its own brightness.

    Args:
        image: complex pixels, shape (rows, cols), range along axis 0.
        tiles: tiles of this image, as of `find_pure_speckle`.

    Raises:
        UserError: the image is not complex or not two-dimensional.
    """
    where, sums = np.argwhere(tiles.pure), _periodograms(checked_image(image), tiles)
    brightness = tiles.intensity[tiles.pure][:, None] * (tiles.tile[0] * tiles.tile[1])
    down, across, nyquist = (_covariance(power / brightness) for power in sums[:3])
    beside = sums[3] / brightness / (1 - 1 / tiles.tile[1])
    # Lines that are neighbours correlate: as many are independent as the correlation along them has of that over all.
    rho, (row, col) = tiles.correlation, (size // 2 for size in tiles.correlation.shape)
    shares = [sum_of_powers(part, tiles.tile, 2) for part in (rho[:, [col]], rho[[row]])]
    lines = [len(where) * tiles.tile[1], len(where) * tiles.tile[0]]
    independent = [
        count * share / sum_of_powers(rho, tiles.tile, 2) for count, share in zip(lines, shares, strict=True)
    ]
    mean = down.mean(axis=0)
    spur = _nyquist_spur(mean, independent[0])
    if spur:
        mean = mean - spur * (-1.0) ** np.arange(len(mean))
        across = across - nyquist
    pointing, turn = _pointing(across, where[:, 1], tiles)
    azimuth = np.mean(across * np.exp(-1j * turn[:, None] * np.arange(across.shape[1])), axis=0)
    aligned = np.mean(beside * np.exp(-1j * turn)[:, None], axis=0) * np.exp(-1j * np.angle(azimuth[1]))
    return SpeckleSpectra(
        range=AxisSpectrum(mean / mean[0].real, lines[0], independent[0], spur),
        neighbours=_covariance(aligned.real) / mean[0].real,
        azimuth=AxisSpectrum(azimuth / azimuth[0].real, lines[1], independent[1]),
        pointing=pointing,
    )


def transform(covariance: C128, frequency: F64) -> F64:
    """Power spectrum at frequencies (cycles per pixel) of a covariance at lags from 0 up, c(-l) being c(l)*."""
    waves = np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(covariance))))
    return 2 * (waves @ covariance).real - covariance[0].real


def fejer_power(covariance: C128) -> F64:
    """Mean periodogram of M pixels of a field with this covariance at lags 0 to M - 1; shape (M,)."""
    size = len(covariance)
    return transform(covariance * (1 - np.arange(size) / size), frequencies(size))


def periodogram_covariance(covariance: C128, count: int) -> F64:
    """Covariance of the periodogram of M pixels of a circular Gaussian field between `count` frequencies.

    |K(f, f')|^2 with K = 1 / M sum over m, m' of c(m - m') exp(-j 2 pi (f m - f' m')), after Isserlis' theorem:
    neighbours correlate as far as the kernel reaches. The diagonal is the square of the periodogram's mean.

    Args:
        covariance: covariance c at lags 0 to M - 1.
        count: number of frequencies from -1/2 up.
    """
    return np.abs(cross_spectrum(covariance, count)) ** 2


def cross_spectrum(covariance: C128, count: int) -> C128:
    """K(f, f') of `periodogram_covariance`, shape (count, count)."""
    size = len(covariance)
    waves = np.exp(-2j * np.pi * np.outer(frequencies(count), np.arange(size)))
    return waves @ toeplitz(covariance, covariance.conj()) @ waves.conj().T / size


def _periodograms(image: C64, tiles: SpeckleTiles) -> tuple[F64, F64, F64, C128]:
    """Energy spectra of every pure tile at twice as many frequencies as pixels, in the order of an FFT.

    Returns:
        Summed over columns, shape (pure tiles, 2 rows of a tile); summed over rows, (.., 2 columns); the part of the
        latter that is at half a cycle per row; and the spectrum over range of each column times the conjugate of its
        neighbour's, summed over columns, (pure tiles, 2 rows).
    """
    rows, cols = tiles.tile
    count = tiles.pure.sum(axis=1)
    first = np.cumsum(count) - count
    down = np.zeros((count.sum(), 2 * rows))
    across, nyquist = (np.zeros((count.sum(), 2 * cols)) for _ in range(2))
    beside = np.zeros((count.sum(), 2 * rows), dtype=np.complex128)

    def measure(part: slice) -> None:
        for row in range(part.start, part.stop):
            strip = image[row * rows : (row + 1) * rows, : tiles.pure.shape[1] * cols].reshape(rows, -1, cols)
            chosen = np.flatnonzero(tiles.pure[row])
            # 2^15 pixels at a time and their spectra stay in a processor's cache.
            for some in blocks(len(chosen), max(1, 2**15 // (rows * cols))):
                pixels = np.take(strip, chosen[some], axis=1)
                own = slice(first[row] + some.start, first[row] + some.stop)
                spectra = scipy.fft.fft(pixels.reshape(rows, -1), 2 * rows, axis=0).reshape(2 * rows, -1, cols)
                down[own] = _energy(spectra).sum(axis=2).T
                beside[own] = np.einsum("ftc,ftc->tf", spectra[..., 1:], spectra[..., :-1].conj())
                across[own] = _energy(scipy.fft.fft(pixels, 2 * cols, axis=2)).sum(axis=0)
                line = scipy.fft.fft(pixels[::2].sum(axis=0) - pixels[1::2].sum(axis=0), 2 * cols)
                nyquist[own] = np.abs(line) ** 2 / rows

    in_parallel(measure, len(count))
    return down, across, nyquist, beside


def _energy(spectra: C64) -> F32:
    return np.square(spectra.real) + np.square(spectra.imag)


def _covariance(power: F64) -> C128:
    """Covariance at lags 0 to M - 1 of each row of spectra at 2 M frequencies: divided by the triangle."""
    size = power.shape[-1] // 2
    return scipy.fft.ifft(power, axis=-1)[..., :size] / (1 - np.arange(size) / size)


def _nyquist_spur(covariance: C128, independent: float) -> float:
    """Power of a line at half a cycle per pixel; 0 unless it stands out of the two neighbouring bins.

    It must stand out by 5 standard errors and by half of them: a response may have edges.
    """
    size = len(covariance)
    triangle = 1 - np.arange(size) / size
    line, *beside = transform(covariance * triangle, 0.5 + np.array([0, -1, 1]) / size)
    level = float(np.mean(beside))
    excess = float(line) - level
    return excess / size if excess > level * max(5 * np.sqrt(1.5 / independent), 0.5) else 0.0


def _pointing(covariance: C128, column: Index, tiles: SpeckleTiles) -> tuple[Pointing | None, F64]:
    """Pointing of each column of tiles, and of each tile how far it turns neighbours more than in the mean, rad."""
    columns, group = np.unique(column, return_inverse=True)
    beat = np.zeros(len(columns), dtype=np.complex128)
    np.add.at(beat, group, covariance[:, 1])
    sigma = _pointing_error(np.abs(beat).sum() / len(covariance), tiles) / np.sqrt(np.bincount(group))
    if not np.median(sigma) < 0.1:  # cycles per pixel: the azimuth response is too flat to have a centre
        return None, np.zeros(len(covariance))
    turn = np.angle(beat * np.conj(beat.sum()))
    middle = np.asarray((columns + 0.5) * tiles.tile[1] - 0.5, dtype=np.float64)
    displacement = np.asarray(np.angle(beat) / (2 * np.pi), dtype=np.float64)
    pointing = Pointing(middle, displacement, np.asarray(sigma, dtype=np.float64))
    return pointing, np.asarray(turn[group], dtype=np.float64)


def _pointing_error(coherence: float, tiles: SpeckleTiles) -> float:
    """Standard error of the Doppler centroid of one tile, cycles per pixel; infinite if neighbours do not correlate.

    The error d of the estimated c(1), which is real once the centroid is out, has E|d|^2 = sum |rho(m, l)|^2 / pixels
    and E d^2 = sum rho(m, l + 1) rho(m, l - 1)* / pixels (Bartlett); its imaginary part over c(1) is that of the phase.

    Args:
        coherence: coherence |c(1)| along azimuth, without bias.
        tiles: tiles with the correlation rho.
    """
    rho = tiles.correlation
    alike = np.sum(np.abs(rho) ** 2) - np.sum(rho[:, 2:] * rho[:, :-2].conj()).real
    pixels = tiles.tile[0] * (tiles.tile[1] - 1)
    if not rho[rho.shape[0] // 2, rho.shape[1] // 2 + 1]:
        return float("inf")
    return float(np.sqrt(max(alike, 0.0) / (2 * pixels)) / coherence / (2 * np.pi))
