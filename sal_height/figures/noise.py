"""Figures 5 and 6 of the SAL paper: noise of the discriminant of a pair, with its closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from sal_height.elevation import DISCRIMINANTS, products
from sal_height.figures.curve import Curve
from sal_height.figures.sample_statistics import Measured, mean, median, s68, std
from sal_height.numeric import C128, F64, in_threads
from sal_height.theory import SteadyLaw, gaussian_law, gaussian_mean, s68_of, steady_mean

Signal = Callable[[np.random.Generator, tuple[int, int]], C128]

KAPPAS = np.linspace(-1, 1, 9)
"""Discriminants without noise, on the horizontal axis."""

CNR_DB = (0, 5, 10, 15, 20)
"""CNR of the sum channel in one look, dB."""

FLUCTUATING_LOOKS = 4
"""Number of looks of figure 6."""

BLOCK = 8192
"""Number of trials that are drawn at a time; each block has a random generator of its own."""


def circular(rng: np.random.Generator, shape: tuple[int, ...]) -> C128:
    """Circular complex Gaussian numbers of mean power 1."""
    parts = rng.standard_normal((*shape, 2)) / np.sqrt(2)
    return parts.view(np.complex128)[..., 0]


def steady(_rng: np.random.Generator, shape: tuple[int, int]) -> C128:
    """Amplitudes of a target of constant brightness 1."""
    return np.ones(shape, dtype=np.complex128)


def fig5(trials: int, seed: int) -> Iterator[Curve]:
    """One look at a target of constant brightness: spread, mean and median over kappa.

    The standard deviation, which the paper plots, has no theory: it does not exist for one look, and that of a sample
    depends on its worst outliers. Half the 16 to 84 % width does exist.
    """
    for index, cnr_db in enumerate(CNR_DB):
        cnr, case = 10 ** (cnr_db / 10), f"CNR {cnr_db} dB"
        sample = discriminants(np.random.SeedSequence((seed, 5)), steady, cnr, 1, trials)
        laws = [SteadyLaw(kappa, cnr) for kappa in KAPPAS.tolist()]
        yield _curve("standard deviation", case, index, [std(row) for row in sample], np.full(len(KAPPAS), np.nan))
        yield _curve("half 16-84 % width", case, index, [s68(row) for row in sample], [s68_of(law) for law in laws])
        yield _curve("mean", case, index, [mean(row) for row in sample], steady_mean(KAPPAS, cnr))
        yield _curve("median", case, index, [median(row) for row in sample], [law.ppf(0.5) for law in laws])


def fig6(trials: int, seed: int) -> Iterator[Curve]:
    """Four looks at a fluctuating target, weighted by power: standard deviation and mean over kappa."""
    for index, cnr_db in enumerate(CNR_DB):
        cnr, case = 10 ** (cnr_db / 10), f"CNR {cnr_db} dB"
        sample = discriminants(np.random.SeedSequence((seed, 6)), circular, cnr, FLUCTUATING_LOOKS, trials)
        spread = [gaussian_law(kappa, cnr, FLUCTUATING_LOOKS).std() for kappa in KAPPAS.tolist()]
        yield _curve("standard deviation", case, index, [std(row) for row in sample], spread)
        yield _curve("mean", case, index, [mean(row) for row in sample], gaussian_mean(KAPPAS, cnr))


def discriminants(seed: np.random.SeedSequence, signal: Signal, cnr_sum: float, looks: int, trials: int) -> F64:
    """Estimates of the discriminant by `ratio`, shape (KAPPAS, trials).

    All kappas use the same draws of target and noise, and so do all CNRs of a figure: their curves are smooth, and few
    points are far from theory by chance.
    """
    counts = [min(BLOCK, trials - first) for first in range(0, trials, BLOCK)]
    draw = partial(_block, signal, cnr_sum, looks)
    return np.concatenate(in_threads(draw, seed.spawn(len(counts)), counts), axis=1)


def _block(signal: Signal, cnr_sum: float, looks: int, seed: np.random.SeedSequence, trials: int) -> F64:
    rng = np.random.default_rng(seed)
    target = np.sqrt(cnr_sum) * signal(rng, (trials, looks))
    total, noise = target + circular(rng, target.shape), circular(rng, target.shape)
    return np.stack([_ratio(total, kappa * target + noise) for kappa in KAPPAS.tolist()])


def _ratio(total: C128, difference: C128) -> F64:
    """Estimate as the node does from Sigma and Delta, shapes (trials, looks), in unit noise."""
    return DISCRIMINANTS["ratio"](products(total, difference), 1.0)


def _curve(quantity: str, case: str, colour: int, measured: list[Measured], closed_form: npt.ArrayLike) -> Curve:
    values, errors = np.array(measured).T
    return Curve(quantity, case, KAPPAS, values, errors, np.asarray(closed_form, dtype=np.float64), colour=colour)
