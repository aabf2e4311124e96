"""The PSF paper on synthetic tapes of known responses: range and azimuth response, estimated from point targets.

Four targets, as in the paper, are found in each tape; their power over the clutter, and the faults of the responses,
are ours. Range, azimuth and cut are from the same tapes, as those of the paper are from the same targets.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sal_height.figures.curve import Curve, Figure
from sal_height.figures.psf_estimators import (
    COUNT,
    FREQUENCY,
    checked,
    generators,
    in_band,
    masked_transfer_function,
    shown,
)
from sal_height.figures.psf_speckle import SPECKLE_FIGURES
from sal_height.figures.psf_theory import (
    azimuth_psf,
    chip_response,
    range_psf,
    relative_variance,
    taylor_psf,
    through_fejer,
    tied,
)
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, TapeTarget, make_tape
from sal_height.numeric import C128, F64
from sal_height.response import (
    FINENESS,
    FLOOR,
    PointTarget,
    chip_at,
    cut_through,
    estimate_transfer_function,
    find_targets,
)

TAPE = (2000, 256)
"""Rows and columns of a tape; with this number of rows neither teeth nor ends of the band fall on a frequency."""

POSITIONS = tuple((row, 128) for row in (250, 750, 1250, 1750))
"""Positions of the targets, which are displaced from these by up to half a pixel."""

OVER_CLUTTER_DB = 40.0
"""Power of the targets' peaks over the mean clutter, for an azimuth response without phase."""

RANGE, AZIMUTH = RangeFault(), AzimuthFault(quartic=1.5)
"""Taylor weights of -35 dB and a sawtooth of 0.1; a cosine beam whose phase is 1.5 rad at the ends of the band."""

TARGET_TAPES, GROUP_TAPES = 40, 41
"""Numbers that give the tapes of each figure different random numbers."""

PIXELS = np.arange(COUNT, dtype=np.float64) - COUNT / 2

DEPTHS = np.array([0.05, 0.1, 0.2])
"""Depths of the sawtooth, over the amplitude."""

CUT_DEPTH = 0.1

RECOVERY_DB = np.array([20.0, 30.0, 40.0, 50.0, 60.0])


def psf_range(trials: int, seed: int) -> Iterator[Curve]:
    """|R| and arg R of four targets and of the average, the paper's way; figures 6 to 10.

    The closed form is the part of R that a chip of 64 pixels retains, scaled to a mean of 1.
    """
    found = [_targets(RANGE, rng) for rng in generators(trials, seed, TARGET_TAPES)]
    truth, beam = _truth(RANGE)
    clutter = through_fejer(np.abs(RANGE.response(TAPE[0])) ** 2, COUNT)
    error = np.sqrt(COUNT * clutter / np.mean(clutter) / (2 * _over_clutter(beam) * len(found)))
    average = np.mean([masked_transfer_function(targets)[0] for targets in found], axis=0)
    singles = [masked_transfer_function([target])[0] for target in found[0]]
    yield from _responses("R", singles, average, error, truth)


def psf_azimuth(trials: int, seed: int) -> Iterator[Curve]:
    """|A| and arg A of four targets, the paper's way, and the average without its mask; figures 11 to 15."""
    found = [_targets(RANGE, rng) for rng in generators(trials, seed, TARGET_TAPES)]
    other, truth = _truth(RANGE)
    variance = relative_variance(truth, other, _over_clutter(truth) * len(found), FLOOR)
    average = np.mean([estimate_transfer_function(targets).azimuth.response for targets in found], axis=0)
    paper = np.mean([masked_transfer_function(targets)[1] for targets in found], axis=0)
    singles = [masked_transfer_function([target])[1] for target in found[0]]
    yield from _responses("A", singles, average, np.sqrt(variance / 2) * np.abs(truth), truth)
    yield shown("|A|", "average with the mask", FREQUENCY, np.abs(paper), "-.", 6)
    yield shown("arg A", "average with the mask", FREQUENCY, np.angle(paper), "-.", 6)


def psf_cut(trials: int, seed: int) -> Iterator[Curve]:
    """The point-spread function along range, and its echoes over the depth of the sawtooth; figure 26.

    An echo of the amplitude depth / pi is in quadrature with Taylor's sidelobe there. The band of 7 / 16 has a
    null there, so that only the echo is left. All depths have the same clutter.
    """
    middle, echo = COUNT * FINENESS // 2, int(RANGE.teeth) * FINENESS
    levels, errors = np.zeros((2, len(DEPTHS))), np.zeros(len(DEPTHS))
    for index, depth in enumerate(DEPTHS.tolist()):
        fault = RangeFault(sawtooth=depth)
        found = [_targets(fault, rng) for rng in generators(trials, seed, TARGET_TAPES)]
        response = np.mean([estimate_transfer_function(targets).range.response for targets in found], axis=0)
        cut = np.abs(cut_through(response, FINENESS))
        levels[:, index] = cut[[middle - echo, middle + echo]]
        errors[index] = np.sqrt(0.5 / (_over_clutter(_truth(fault)[1]) * len(found)))
        if depth == CUT_DEPTH:
            distance = (np.arange(len(cut)) - middle) / FINENESS
            theory = np.abs(range_psf(distance, fault))
            yield shown("point-spread function", "4 targets a tape", distance, _db(cut))
            yield shown("point-spread function", "theory", distance, _db(theory), "--", 1)
            yield shown("point-spread function", "no sawtooth", distance, _db(taylor_psf(distance, fault)), ":", 2)
    for colour, (side, values) in enumerate(zip((-1, 1), levels, strict=True)):
        at = np.array(side * RANGE.teeth)
        expected = np.array([np.abs(range_psf(at, RangeFault(sawtooth=depth))) for depth in DEPTHS.tolist()])
        error = 20 / np.log(10) * errors / values
        yield Curve("echo", f"{at:+.0f} pixels", DEPTHS, _db(values), error, _db(expected), "-", colour)
    yield shown("echo", "depth / pi", DEPTHS, _db(DEPTHS / np.pi), ":", 2)


def psf_recovery(trials: int, seed: int) -> Iterator[Curve]:
    """Rms errors of |R|, arg R, |A| and arg A from four targets over the target-to-clutter ratio.

    Moduli are over their greatest; all are over the band. Theory is of the first order.
    """
    truth = [response / response.mean() for response in (RANGE.response(COUNT), AZIMUTH.response(COUNT))]
    # Four groups of four targets for every tape, as they need no tape around them.
    squares = np.array([_squares(rng, truth) for rng in generators(trials, seed, GROUP_TAPES, 4)])
    mean, scatter = squares.mean(axis=0), squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    rms, error = np.sqrt(mean), scatter / (2 * np.sqrt(mean))
    for axis, name in enumerate("RA"):
        response, other = truth[axis], truth[1 - axis]
        peak = np.abs(np.mean(AZIMUTH.response(COUNT))) ** 2 / np.mean(np.abs(AZIMUTH.response(COUNT))) ** 2
        over_clutter = len(POSITIONS) * peak * 10 ** (RECOVERY_DB / 10)
        variance = np.array([relative_variance(response, other, ratio, FLOOR) for ratio in over_clutter.tolist()])
        band, (of_modulus, of_phase) = in_band(response), tied(response)
        weight = np.abs(response) ** 2 / np.max(np.abs(response)) ** 2
        for kind, fraction in enumerate((np.mean((of_modulus * weight)[band]), np.mean(of_phase[band]))):
            # From 40 dB errors are those of the first order within 1 %.
            theory = np.where(RECOVERY_DB >= 40.0, np.sqrt(variance * fraction), np.nan)
            case = (f"|{name}|", f"arg {name}")[kind]
            yield Curve(
                "error", case, RECOVERY_DB, rms[:, axis, kind], error[:, axis, kind], theory, colour=2 * axis + kind
            )


def _targets(fault: RangeFault, rng: np.random.Generator) -> tuple[PointTarget, ...]:
    """The targets found in a new tape."""
    positions = np.array(POSITIONS) + rng.uniform(-0.5, 0.5, (len(POSITIONS), 2))
    targets = tuple(TapeTarget(row, col, OVER_CLUTTER_DB) for row, col in positions.tolist())
    return find_targets(make_tape(TAPE, rng, targets, fault, AZIMUTH)).require()


def _truth(fault: RangeFault) -> tuple[C128, C128]:
    """Range and azimuth response as chips retain them."""
    return chip_response(range_psf(PIXELS, fault)), chip_response(azimuth_psf(PIXELS, AZIMUTH))


def _over_clutter(beam: C128) -> float:
    """Power of the peaks of a tape's targets over the mean clutter, which the azimuth response's phase lowers."""
    lost = np.abs(np.mean(beam)) / np.mean(np.abs(beam))
    return float(len(POSITIONS) * 10 ** (OVER_CLUTTER_DB / 10) * lost**2)


def _responses(name: str, singles: list[C128], average: C128, error: F64, truth: C128) -> Iterator[Curve]:
    """Modulus and phase of single targets, of the average with its standard error, and of the truth."""
    band = in_band(truth)
    modulus, phase = f"|{name}|", f"arg {name}"
    for number, single in enumerate(singles, start=1):
        yield shown(modulus, f"target {number}", FREQUENCY, np.abs(single), ":", number + 1)
        yield shown(phase, f"target {number}", FREQUENCY[band], np.angle(single[band]), ":", number + 1)
    yield checked(modulus, "average", np.abs(average), error, np.where(band, np.abs(truth), np.nan), 0)
    angles = np.where(band, np.angle(average), 0.0)
    yield checked(phase, "average", angles, error / np.abs(average), np.where(band, np.angle(truth), np.nan), 0)
    yield shown(modulus, "truth", FREQUENCY, np.abs(truth), "--", 1)
    yield shown(phase, "truth", FREQUENCY[band], np.angle(truth[band]), "--", 1)


def _squares(rng: np.random.Generator, truth: list[C128]) -> F64:
    """Mean square errors of a group of targets at each of RECOVERY_DB: shape (.., R and A, modulus and phase)."""
    squares = []
    for level in RECOVERY_DB.tolist():
        target = TapeTarget(20, 30, level)
        tapes = (make_tape((COUNT, COUNT), rng, (target,), RANGE, AZIMUTH) for _ in POSITIONS)
        made = estimate_transfer_function([chip_at(tape, 20, 30, clutter=1.0) for tape in tapes])
        estimates = (made.range.response, made.azimuth.response)
        squares.append([_square_errors(one, true) for one, true in zip(estimates, truth, strict=True)])
    return np.array(squares)


def _square_errors(response: C128, truth: C128) -> tuple[float, float]:
    """Mean squares over the band of the error of the modulus, over the greatest, and of the phase (rad)."""
    band = in_band(truth)
    modulus = (np.abs(response) - np.abs(truth))[band] / np.abs(truth).max()
    return float(np.mean(modulus**2)), float(np.mean(np.angle(response * truth.conj())[band] ** 2))


def _db(amplitude: F64) -> F64:
    return 20 * np.log10(np.maximum(np.abs(amplitude), 1e-4))


_FREQUENCY = "frequency (cycles per pixel)"

PSF_FIGURES = {
    "psf_range": Figure(
        f"PSF paper, figures 6 to 10: range response from point targets {OVER_CLUTTER_DB:.0f} dB over clutter",
        {"|R|": (_FREQUENCY, "|R| over its mean"), "arg R": (_FREQUENCY, "arg R (rad)")},
        12,
        psf_range,
    ),
    "psf_azimuth": Figure(
        f"PSF paper, figures 11 to 15: azimuth response from point targets {OVER_CLUTTER_DB:.0f} dB over clutter",
        {"|A|": (_FREQUENCY, "|A| over the mean of A"), "arg A": (_FREQUENCY, "arg A (rad)")},
        14,
        psf_azimuth,
    ),
    **SPECKLE_FIGURES,
    "psf_cut": Figure(
        "PSF paper, figure 26: point-spread function along range, and the echoes of the sawtooth",
        {
            "point-spread function": ("distance from the peak (pixels)", "level (dB)"),
            "echo": ("depth of the sawtooth", "level of the echo (dB)"),
        },
        6,
        psf_cut,
    ),
    "psf_recovery": Figure(
        "Errors of the responses from four point targets",
        {"error": ("target-to-clutter ratio (dB)", "rms error (moduli over the greatest; rad)")},
        4,
        psf_recovery,
    ),
}
"""Figures by name."""
