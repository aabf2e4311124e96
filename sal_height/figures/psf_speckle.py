"""The PSF paper on synthetic tapes of known responses: responses from speckle, and whether targets have the same.

The paper concludes from the difference that the system is not linear (section 3). Here it is linear, except where a
limiter is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sal_height.figures.curve import Curve, Figure
from sal_height.figures.noise import circular
from sal_height.figures.psf_estimators import (
    COUNT,
    FREQUENCY,
    checked,
    depth_and_pedestal,
    generators,
    in_band,
    mean_modulus,
    shown,
)
from sal_height.figures.psf_theory import chip_transform, cosine_beam, swung_modulus, through_fejer
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, Saturation, TapeTarget, make_tape
from sal_height.numeric import C64, C128, F64, Bool, frequencies, window
from sal_height.response import (
    SpeckleSpectra,
    estimate_speckle_spectra,
    find_pure_speckle,
    periodogram_covariance,
    superposition,
)

ROWS = 256
"""Rows of all tapes; an image of the paper has as many columns."""

IMAGES = 8
"""Number of images side by side in a tape, as in the paper."""

RANGE = RangeFault()

SWINGING = AzimuthFault(swing=0.1, swing_period=float(ROWS * IMAGES))
"""A beam that swings by a tenth of the band, once in the tape."""

SPECKLE_COLS, TARGETS, BINS = 960, 8, 128
"""Columns of speckle next to the targets, number of targets, and range pixels of their chips."""

OVER_CLUTTER_DB = 40.0

NOISES = np.array([0.0, 0.3, 0.6])
"""Rms of white noise over that of speckle."""

SHOWN_NOISE = 0.6
"""Noise at which spectra are drawn, and p-values counted."""

P_VALUES = np.array([0.05, 0.25, 0.5, 0.75])

LEVELS = np.array([8.0, 12.0, 16.0, 24.0])
"""Levels of the limiter, over the rms of the signal where targets are spread out."""

SIGNIFICANCE = 0.05

NOISE_WINDOWS = {"white": None, "Taylor": "taylor", "Hamming": "hamming"}
"""Weights over the band that noise has passed, by name; the response itself has Taylor weights."""

SPECKLE_TAPES, NOISY_TAPES, LINEAR_TAPES, LIMITED_TAPES, READINGS = 50, 51, 52, 53, 54
"""Numbers that distinguish tapes."""


def psf_speckle(trials: int, seed: int) -> Iterator[Curve]:
    """|R| and |A| of eight images and of all, the paper's way, and the pointing of the antenna; figures 16 to 24.

    Moduli are over their mean. The paper's |A| is smeared by the swing; the other one has the swing removed.
    """
    rngs = generators(trials, seed, SPECKLE_TAPES)
    moduli, powers, errors = [], [], []
    for number, rng in enumerate(rngs):
        tape = make_tape((ROWS, ROWS * IMAGES), rng, (), RANGE, SWINGING)
        moduli.append([_moduli(tape[:, first : first + ROWS]) for first in range(0, ROWS * IMAGES, ROWS)])
        spectra = estimate_speckle_spectra(tape, find_pure_speckle(tape))
        powers.append(spectra.azimuth.power)
        errors.append(spectra.azimuth.standard_error)
        if number == 0:
            yield _pointing(spectra)
    for number, image in enumerate(moduli[0], start=1):
        for quantity, modulus in zip(("|R|", "|A|"), image, strict=True):
            yield shown(quantity, f"image {number}", FREQUENCY, modulus, ":", number + 1)
    mean = np.mean(moduli, axis=(0, 1))
    error = np.sqrt(np.mean(np.var(moduli, axis=0, ddof=1), axis=0) / (len(rngs) * IMAGES))
    power = through_fejer(np.abs(RANGE.response(ROWS)) ** 2, COUNT)
    yield checked("|R|", "average", mean[0], error[0], _over_mean(np.sqrt(power)), 0)
    # Up to this frequency the tape's swinging beam, interpolated between pointings, is a cosine within 0.3 %.
    smeared = np.where(np.abs(FREQUENCY) < 0.35, _over_mean(swung_modulus(COUNT, SWINGING.swing)), np.nan)
    yield checked("|A|", "average, smeared", mean[1], error[1], smeared, 0)
    still, aligned = np.sqrt(cosine_beam(COUNT)), np.sqrt(np.mean(powers, axis=0))
    scale = float(np.mean(still))
    error_of_power = np.mean(errors, axis=0) / np.sqrt(len(rngs))
    truth = np.where(in_band(still), still / scale, np.nan)
    yield checked("|A|", "average, swing taken out", aligned / scale, error_of_power / (2 * aligned * scale), truth, 1)


def _moduli(image: C64) -> list[F64]:
    """|R| and |A| of an image the paper's way, over their means."""
    return [_over_mean(modulus) for modulus in mean_modulus(image, find_pure_speckle(image))]


def _pointing(spectra: SpeckleSpectra) -> Curve:
    """Pointing of the antenna at each column of tiles; one in each image is checked against the truth."""
    found = spectra.pointing
    nowhere = np.full(ROWS * IMAGES // COUNT, np.nan)
    columns = (np.arange(len(nowhere), dtype=np.float64) + 0.5) * COUNT - 0.5
    swung = SWINGING.swing * np.sin(2 * np.pi * columns / SWINGING.swing_period)
    truth = np.where(np.arange(len(swung)) % (ROWS // COUNT) == 0, swung, np.nan)
    value, sigma = (found.displacement, found.sigma) if found else (nowhere, nowhere)
    return Curve("pointing", "first tape", columns, value, sigma, truth)


def _over_mean(modulus: F64) -> F64:
    return modulus / np.mean(modulus)


@dataclass(frozen=True)
class TapeResponses:
    """Targets and speckle of one tape.

    Attributes:
        response: response R of its targets at BINS frequencies, 1 at the peak.
        error: standard error of each, as a complex number.
        speckle: spectra of its speckle.
    """

    response: C128
    error: F64
    speckle: SpeckleSpectra

    @property
    def p_value(self) -> float:
        """P-value of the test of superposition."""
        return superposition(self.response, self.error, self.speckle).p_value


def psf_superposition(trials: int, seed: int) -> Iterator[Curve]:
    """Responses of targets and of speckle, the paper's readings of them, and the result of the test; figures 10 and 24.

    All systems are linear except those with a limiter. Depth and pedestal of speckle are those of R convolved with
    Fejer's kernel, and of noise: no sign of non-linearity.
    """
    tapes = {
        noise: [_compared(rng, noise) for rng in generators(trials, seed, NOISY_TAPES)] for noise in NOISES.tolist()
    }
    yield from _powers(tapes[SHOWN_NOISE])
    yield from _readings(tapes, np.random.default_rng((seed, READINGS)))
    for name, window_name in NOISE_WINDOWS.items():
        linear = [
            _compared(rng, SHOWN_NOISE, noise_window=window_name).p_value
            for rng in generators(trials, seed, LINEAR_TAPES, 3.0)  # p-values need many
        ]
        below = np.array(linear)[:, None] < P_VALUES
        yield _fraction("share of linear tapes", f"p-value below, {name} noise", P_VALUES, below, P_VALUES)
    limited = [
        [_compared(rng, SHOWN_NOISE, level).p_value < SIGNIFICANCE for level in LEVELS.tolist()]
        for rng in generators(trials, seed, LIMITED_TAPES)
    ]
    none = np.full(len(LEVELS), np.nan)
    yield _fraction("share of limited tapes", "p-value below 0.05", LEVELS, np.array(limited), none)


def _compared(
    rng: np.random.Generator, noise: float, level: float | None = None, noise_window: str | None = None
) -> TapeResponses:
    """Targets and speckle of a new tape with targets on one side.

    Args:
        rng: random numbers of the tape.
        noise: rms of the noise over that of the speckle.
        level: level of a limiter, over the rms; None: the system is linear.
        noise_window: weights over the band that the noise has passed; None: it is white.
    """
    cols = [SPECKLE_COLS + 96 + COUNT * number for number in range(TARGETS)]
    targets = tuple(TapeTarget(ROWS // 2, col, OVER_CLUTTER_DB) for col in cols)
    limiter = Saturation(level) if level else None
    shape = ROWS, SPECKLE_COLS + COUNT * (TARGETS + 1)
    tape = make_tape(shape, rng, targets, RANGE, AzimuthFault(), noise, 0.0, limiter, noise_weights(noise_window))
    clutter = tape[:, :SPECKLE_COLS]
    speckle = estimate_speckle_spectra(clutter, find_pure_speckle(clutter))
    chips = tape[(ROWS - BINS) // 2 :][:BINS, cols]
    peaks = chips[BINS // 2]
    response = chip_transform(np.mean(chips / peaks, axis=1))
    over_clutter = TARGETS * np.mean(np.abs(peaks) ** 2) / np.mean(np.abs(clutter) ** 2)
    power = np.interp(frequencies(BINS), FREQUENCY, speckle.range.power, period=1)
    error = np.sqrt(BINS * power / over_clutter)
    return TapeResponses(response, error, speckle)


def noise_weights(name: str | None) -> F64 | None:
    """Weights of noise at ROWS frequencies: a window over the band of the tape, 0 outside; None: white."""
    if name is None:
        return None
    band = np.flatnonzero(np.abs(frequencies(ROWS)) < RANGE.support / 2)
    weights = np.zeros(ROWS)
    weights[band] = window(name, len(band))
    return weights


def _truth() -> C128:
    """R as chips of BINS pixels retain it, 1 at the peak."""
    pixels = np.fft.fftshift(np.fft.ifft(np.fft.ifftshift(RANGE.response(ROWS))))
    chip = pixels[(ROWS - BINS) // 2 :][:BINS]
    return chip_transform(chip / chip[BINS // 2])


def _prediction(noise: float) -> F64:
    """Mean periodogram of speckle and white noise behind a linear system, of mean 1."""
    power = through_fejer(np.abs(RANGE.response(ROWS)) ** 2, COUNT)
    return (power / np.mean(power) + noise**2) / (1 + noise**2)


def _covariance(noise: float) -> C128:
    """Autocovariance over range of speckle and white noise behind a linear system, over that at lag 0."""
    signal = np.fft.ifft(np.fft.ifftshift(np.abs(RANGE.response(ROWS)) ** 2))[:COUNT]
    return (signal / signal[0] + noise**2 * (np.arange(COUNT) == 0)) / (1 + noise**2)


def _powers(tapes: list[TapeResponses]) -> Iterator[Curve]:
    """|R|^2 of targets and of speckle, each over its mean."""
    response, error = _mean_response(tapes)
    of_targets = np.abs(response) ** 2 - error**2
    yield shown("|R|^2", "targets", frequencies(BINS), of_targets / of_targets.mean(), "-", 1)
    power = np.mean([tape.speckle.range.power for tape in tapes], axis=0)
    error = np.mean([tape.speckle.range.standard_error for tape in tapes], axis=0) / np.sqrt(len(tapes))
    yield checked("|R|^2", "speckle", power, error, _prediction(SHOWN_NOISE), 0)
    yield shown("|R|^2", "linear prediction", FREQUENCY, _prediction(SHOWN_NOISE), "--", 2)


def _mean_response(tapes: list[TapeResponses]) -> tuple[C128, F64]:
    """Mean response of the targets of several tapes, with its standard error."""
    response = np.mean([tape.response for tape in tapes], axis=0)
    error = np.sqrt(np.mean([tape.error**2 for tape in tapes], axis=0) / len(tapes))
    return response, error


def _readings(tapes: dict[float, list[TapeResponses]], rng: np.random.Generator) -> Iterator[Curve]:
    """Depth of the sawtooth and pedestal, of targets and of speckle, over the noise.

    The closed form includes the effect of noise in a spectrum on a reading: it is the mean reading of spectra drawn
    about the true one, and their scatter is the standard error, or that of the tapes' readings if it is greater:
    without noise the errors at frequencies outside the band are more alike than those of a sub-image.
    """
    draws = 200  # of a spectrum by its standard errors
    read = np.zeros((3, len(NOISES), 2, 2))
    for index, (noise, some) in enumerate(tapes.items()):
        response, error = _mean_response(some)
        drawn = _truth() + error * circular(rng, (draws, BINS))
        read[:, index, 0] = _reading(np.abs(response) ** 2 - error**2, np.abs(drawn) ** 2 - error**2)
        power = np.mean([tape.speckle.range.power for tape in some], axis=0)
        lines = sum(tape.speckle.range.independent for tape in some)
        scatter = periodogram_covariance(_covariance(noise), COUNT) / lines
        read[:, index, 1] = _reading(power, rng.multivariate_normal(_prediction(noise), scatter, draws))
        of_tapes = np.std([depth_and_pedestal(tape.speckle.range.power, RANGE.teeth) for tape in some], axis=0, ddof=1)
        read[2, index, 1] = np.maximum(read[2, index, 1], of_tapes / np.sqrt(len(some)))
    read[1, :, 0, 1] = np.nan  # the pedestal of targets in noise is not drawn
    for kind, name in enumerate(("depth", "pedestal")):
        for source, whose in enumerate(("targets", "speckle")):
            value, expected, error = read[:, :, source, kind]
            style = ("-", "--")[kind]
            yield Curve("depth and pedestal", f"{name}, {whose}", NOISES, value, error, expected, style, source)


def _reading(power: F64, drawn: F64) -> F64:
    """Depth and pedestal of a spectrum; their mean and scatter over drawn ones; shape (3, 2)."""
    readings = np.array([depth_and_pedestal(one, RANGE.teeth) for one in drawn])
    return np.stack([depth_and_pedestal(power, RANGE.teeth), readings.mean(axis=0), readings.std(axis=0)])


def _fraction(quantity: str, case: str, x: F64, happened: Bool, expected: F64) -> Curve:
    """Fraction of tapes where something `happened`, (tapes, points); standard error by the expected fraction."""
    value = np.mean(happened, axis=0)
    fraction = np.where(np.isnan(expected), value, expected)
    return Curve(quantity, case, x, value, np.sqrt(fraction * (1 - fraction) / len(happened)), expected)


_FREQUENCY = "frequency (cycles per pixel)"

SPECKLE_FIGURES = {
    "psf_speckle": Figure(
        f"PSF paper, figures 16 to 24: moduli from speckle, antenna swinging by {SWINGING.swing} of the band",
        {
            "|R|": (_FREQUENCY, "|R| over its mean"),
            "|A|": (_FREQUENCY, "|A| over its mean"),
            "pointing": ("column", "displacement of the beam (cycles per pixel)"),
        },
        20,
        psf_speckle,
    ),
    "psf_superposition": Figure(
        f"PSF paper, figures 10 and 24: targets {OVER_CLUTTER_DB:.0f} dB over clutter, and speckle",
        {
            "|R|^2": (_FREQUENCY, f"|R|^2 over its mean (noise {SHOWN_NOISE} of the speckle)"),
            "depth and pedestal": ("noise over speckle (rms)", "over |R|"),
            "share of linear tapes": ("nominal level", "share with a lower p-value"),
            "share of limited tapes": ("level of the limiter (over the rms)", f"share with p < {SIGNIFICANCE}"),
        },
        11,
        psf_superposition,
    ),
}
"""Figures by name."""
