"""Estimators as the PSF paper defines them, for comparison with those of `response`, and its tapes and curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft

from sal_height.errors import NotDetermined
from sal_height.figures.curve import Curve, exact_curve
from sal_height.numeric import C64, C128, F64, Bool, Complex, frequencies
from sal_height.response.point_targets import PointTarget
from sal_height.response.speckle_tiles import SpeckleTiles, checked_image
from sal_height.response.transfer_function import centred

COUNT = 64
"""Pixels along each side of chips and sub-images, as in the paper."""

FREQUENCY = frequencies(COUNT)
"""Frequencies of a chip, cycles per pixel."""


def generators(trials: int, seed: int, figure: int, tapes: float = 1.0) -> list[np.random.Generator]:
    """Make a random generator for each tape.

    Args:
        trials: number of trials of `sal-height figures`.
        seed: seed of all random numbers.
        figure: number of the figure, whose tapes differ from those of others.
        tapes: number of tapes over the usual one.
    """
    # A tape stands for 1000 trials: 20 tapes for the usual 20 000.
    count = round(tapes * min(max(trials // 1000, 4), 40))
    return [np.random.default_rng(sequence) for sequence in np.random.SeedSequence((seed, figure)).spawn(count)]


def in_band(response: Complex | F64) -> Bool:
    """True where a response is strong enough to have a phase."""
    return np.abs(response) > 0.1 * np.abs(response).max()


def checked(quantity: str, case: str, value: F64, error: F64, theory: F64, colour: int) -> Curve:
    """A curve over FREQUENCY of which every fifth point has a closed form.

    Bins err independently, and of hundreds some are three sigma off.
    """
    closed_form = np.where(np.arange(COUNT) % 5 == 0, theory, np.nan)
    return Curve(quantity, case, FREQUENCY, value, error, closed_form, "-", colour)


def shown(quantity: str, case: str, x: F64, value: F64, style: str = "-", colour: int = 0) -> Curve:
    """A curve that is shown and not checked: of one draw, or of theory itself."""
    return exact_curve(quantity, case, x, value, np.full_like(value, np.nan), style, colour)


AZIMUTH_STRIPE = 3
"""Rows of the cross that pass the azimuth response, as in the paper."""


RANGE_STRIPE = 5
"""Columns of the cross that pass the range response, as in the paper."""


def masked_transfer_function(
    targets: Sequence[PointTarget], azimuth_stripe: int = AZIMUTH_STRIPE, range_stripe: int = RANGE_STRIPE
) -> tuple[C128, C128]:
    """R and A the paper's way: chips masked by a cross, plain means over k_a and over k_r (figures 10 and 15).

    The cross has no effect on R: the mean over k_a is the transform of the row through the peak, which it passes.

    Args:
        targets: chips of one shape.
        azimuth_stripe: rows of the cross's stripe along azimuth.
        range_stripe: columns of its stripe along range.

    Raises:
        NotDetermined: no target is given.
    """
    if not targets:
        raise NotDetermined("No point target determines the transfer function; one at least is needed.")
    spectra = np.stack([masked_spectrum(target, azimuth_stripe, range_stripe) for target in targets])
    range_response = spectra.mean(axis=(0, 2))
    turned = spectra * np.exp(-1j * np.angle(range_response))[:, None]
    return centred(range_response), centred(turned.mean(axis=(0, 1)))


def masked_spectrum(
    target: PointTarget, azimuth_stripe: int = AZIMUTH_STRIPE, range_stripe: int = RANGE_STRIPE
) -> C128:
    """Transform a chip of which only a cross through the peak is left (PSF paper, figures 4 and 5)."""
    shape = target.spectrum.shape
    down, across = (np.minimum(np.arange(size), size - np.arange(size)) for size in shape)
    cross = (down <= azimuth_stripe // 2)[:, None] | (across <= range_stripe // 2)
    return scipy.fft.fftshift(scipy.fft.fft2(target.chip * cross))


def mean_modulus(image: C64, tiles: SpeckleTiles) -> tuple[F64, F64]:
    """The paper's estimates of |R| and |A|: mean moduli of the two-dimensional transforms of the tiles.

    Returns:
        Averaged over azimuth frequency, shape (rows of a tile,), and over range frequency, (columns of a tile,); a
        white image has sqrt(pi) / 2.
    """
    image, (rows, cols) = checked_image(image), tiles.tile
    modulus = np.zeros(tiles.tile)
    for row, col in np.argwhere(tiles.pure):
        part = image[row * rows : (row + 1) * rows, col * cols : (col + 1) * cols]
        modulus += np.abs(scipy.fft.fft2(part)) / np.sqrt(tiles.intensity[row, col] * rows * cols)
    modulus = scipy.fft.fftshift(modulus) / tiles.pure.sum()
    return modulus.mean(axis=1), modulus.mean(axis=0)


def depth_and_pedestal(power: F64, teeth: float) -> tuple[float, float]:
    """Depth of a sawtooth and height of the pedestal in |R|: as the paper reads them from its figures 10 and 24.

    The depth is pi / 2 times the sawtooth's fundamental in ln |R|, next to a parabola, where the power is above half of
    its greatest; the pedestal is the mean |R| of the quietest quarter of the frequencies over the greatest.

    Args:
        power: power |R|^2 at frequencies from -1/2 up; of speckle, its mean periodogram.
        teeth: number of teeth of the sawtooth in all frequencies.
    """
    modulus = np.sqrt(np.maximum(power, 0))
    frequency = frequencies(len(power))
    inside = power > power.max() / 2
    phase = 2 * np.pi * teeth * frequency[inside]
    terms = [np.ones(inside.sum()), frequency[inside], frequency[inside] ** 2, np.cos(phase), np.sin(phase)]
    fit, *_ = np.linalg.lstsq(np.stack(terms, axis=1), np.log(modulus[inside]), rcond=None)
    pedestal = np.sort(modulus)[: len(modulus) // 4].mean() / modulus.max()
    return float(np.pi / 2 * np.hypot(fit[3], fit[4])), float(pedestal)
