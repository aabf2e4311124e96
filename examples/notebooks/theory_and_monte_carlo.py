# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Theory and Monte Carlo
#
# How good can an elevation be? For two detectors the law of their ratio is known in closed form. For an array there are
# the Cramér-Rao bounds, which hold at high CNR, and a threshold of CNR below which estimates break down. This notebook
# draws random pixels, runs the estimators that also process flights, and lays the results beside theory. Every point of
# Monte Carlo has an error bar of two standard errors; angles are in beamwidths.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import gamma

from sal_height.beams import pattern_named
from sal_height.elevation import (
    OBJECTIVES,
    conditional_crb,
    products,
    ratio,
    speckle_crb,
    stochastic_crb,
    total_least_squares,
)
from sal_height.figures.sample_statistics import mean, median, s68, share, std
from sal_height.figures.unit_arrays import array_of
from sal_height.numeric import C64
from sal_height.theory import TargetPixels, cnr_detector_of, gaussian_law, s68_of

TRIALS, SEED = 20_000, 1
sinc = pattern_named("sinc")
scores = []  # of all points that have a closed form: deviation over standard error

# %% [markdown]
# ## The ratio of two detectors is biased
#
# Of a pixel, let Σ be the sum of the two amplitudes and Δ their difference, each with noise. Their ratio, averaged over
# looks with the power of Σ as the weight, tends to the middle: noise in the denominator makes it smaller by the factor
# C / (C + 1), where C is the CNR of Σ. More looks do not help. Total least squares allows for the noise in both
# channels; its median is right.

# %%
pair, elevation, looks = array_of((sinc,), 2, 0.5), 0.3, 4
kappa = float(np.diff(pair.response(elevation, 0.0))[0] / np.sum(pair.response(elevation, 0.0)))


def sum_and_difference(cnr_sum: float, looks: int, seed: tuple[int, int]) -> tuple[C64, C64]:
    """Σ and Δ of pixels that hold the same fluctuating target, with this CNR of Σ (power ratio): (pixels, looks)."""
    pixels = TargetPixels(pair, elevation, float(cnr_detector_of(cnr_sum, pair, elevation, 0.0)), looks)
    lower, upper = np.moveaxis(pixels.draw(np.random.default_rng(seed), TRIALS), -1, 0)
    return upper + lower, upper - lower


cnr_db = np.array([0, 3, 6, 9, 12, 15, 20])
drawn = [
    products(*sum_and_difference(10 ** (level / 10), looks, (SEED, number)))
    for number, level in enumerate(cnr_db.tolist())
]
biased, spread = (np.array([statistic(ratio(one, 2.0)) for one in drawn]) for statistic in (mean, std))
unbiased = np.array([median(total_least_squares(one, 2.0)) for one in drawn])
laws = [gaussian_law(kappa, 10 ** (level / 10), looks) for level in cnr_db]
expected, width = np.array([law.mean() for law in laws]), np.array([law.std() for law in laws])
scores += [*(biased[:, 0] - expected) / biased[:, 1], *(spread[:, 0] - width) / spread[:, 1]]

figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained")
left.plot(cnr_db, expected, "C0-", label="mean of the ratio, closed form")
left.errorbar(cnr_db, biased[:, 0], 2 * biased[:, 1], fmt="C0o", label="mean of the ratio, Monte Carlo")
left.errorbar(cnr_db, unbiased[:, 0], 2 * unbiased[:, 1], fmt="C1s", label="median of total least squares")
left.axhline(kappa, color="k", lw=0.8, label="without noise")
left.set(xlabel="CNR of Σ (dB)", ylabel="Δ / Σ", title=f"{looks} looks", ylim=(0, None))
left.legend()
right.semilogy(cnr_db, width, "C0-", label="closed form")
right.errorbar(cnr_db, spread[:, 0], 2 * spread[:, 1], fmt="C0o", label="Monte Carlo")
right.set(xlabel="CNR of Σ (dB)", ylabel="standard deviation of the ratio", title=f"{looks} looks")
right.legend()
plt.show()

# %% [markdown]
# ## One look has no variance
#
# With one look, the ratio has Student's law with two degrees of freedom. It has a mean but no variance: the standard
# deviation of a sample depends on its worst outliers, and grows with the size of the sample without end, in jumps. Half
# the width between 16 and 84 % (*s68*) does exist, and settles.

# %%
one_look = ratio(products(*sum_and_difference(10.0, 1, (SEED, len(cnr_db)))), 2.0)
law = gaussian_law(kappa, 10.0, 1)
sizes = np.unique(np.logspace(2, np.log10(TRIALS), 25).astype(int))
widths = np.array([s68(one_look[:size]) for size in sizes])
scores.append((widths[-1, 0] - s68_of(law)) / widths[-1, 1])
figure, axis = plt.subplots(figsize=(8, 4.6), layout="constrained")
axis.semilogx(sizes, [np.std(one_look[:size]) for size in sizes], "C1s-", label="standard deviation of the sample")
axis.errorbar(sizes, widths[:, 0], 2 * widths[:, 1], fmt="C0o", label="s68 of the sample")
axis.axhline(s68_of(law), color="C0", label="s68, closed form")
axis.set(xlabel="pixels in the sample", ylabel="spread of the ratio", title="one look, CNR of Σ 10 dB", ylim=(0, None))
axis.legend()
plt.show()

# %% [markdown]
# ## An array: bounds and threshold
#
# Sixteen detectors, half a beamwidth apart, estimate an elevation by maximum likelihood. Three Cramér-Rao bounds differ
# in what is known of the amplitudes: the *conditional* one knows their energy, the *speckle* one averages the variance
# over it, the *stochastic* one holds for amplitudes that are Gaussian and unknown.
#
# Below a threshold, noise in some other direction looks stronger than the target, and the estimate is anywhere. Such
# outliers are rare at first, but they govern the standard deviation long before they are frequent. The search spans
# eight beamwidths, and noise in directions a beamwidth apart is independent: that makes seven directions besides the
# target's. With K looks, the noise in each has the power of a gamma variable of order K, and the target has that of
# such a variable times 1 + C a², where C is the CNR of one detector and a² the power gain of the array. The probability
# that the strongest of the seven exceeds the target is an integral over that law. It is an approximation: noise may be
# stronger between these directions, and its peak may by chance lie near the target.

# %%
array, place = array_of((sinc,), 16, 0.5), 1.75
gain = float(np.sum(array.response(place, 0.0) ** 2))
levels = np.array([-2.5, 0.0, 2.5, 5.0, 7.5, 10.0, 15.0, 20.0])
DIRECTIONS = 7


def outlier_probability(cnr: float, looks: int) -> float:
    """Probability that noise in one of the other directions is stronger than the target."""
    power = np.linspace(0.0, gamma.ppf(1 - 1e-12, looks), 4001)
    quieter = gamma.cdf(power * (1 + cnr * gain), looks) ** DIRECTIONS
    return 1 - float(np.trapezoid(gamma.pdf(power, looks) * quieter, power))


errors = {}
for looks in (4, 16):
    for level in levels.tolist():
        pixels = TargetPixels(array, place, 10 ** (level / 10), looks)
        errors[looks, level] = pixels.peak_elevations(SEED, TRIALS, OBJECTIVES["normalised"], 0.0) - place

# %%
cnr = 10 ** (np.linspace(levels[0], levels[-1], 91) / 10)
figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
for colour, looks in (("C0", 4), ("C1", 16)):
    samples = [errors[looks, level] for level in levels.tolist()]
    for style, label, chosen in (
        ("o", "all estimates", samples),
        ("s", "estimates within a beamwidth", [one[np.abs(one) < 1] for one in samples]),
    ):
        values, uncertainty = np.array([std(one) for one in chosen]).T
        fill = colour if style == "o" else "none"
        left.errorbar(levels, values, 2 * uncertainty, fmt=colour + style, mfc=fill, label=f"{label}, {looks} looks")
    for style, bound in {"-": stochastic_crb, "--": speckle_crb, ":": conditional_crb}.items():
        name = bound.__name__.removesuffix("_crb") + f" bound, {looks} looks"
        left.semilogy(10 * np.log10(cnr), bound(array, place, 0.0, cnr, looks), colour + style, lw=1, label=name)
    found, uncertainty = np.array([share(np.abs(one) > 1) for one in samples]).T
    some = found > 0
    right.errorbar(
        levels[some], found[some], 2 * uncertainty[some], fmt=f"{colour}o", label=f"Monte Carlo, {looks} looks"
    )
    theory = [outlier_probability(one, looks) for one in cnr]
    right.semilogy(10 * np.log10(cnr), theory, colour + "-", label=f"theory, {looks} looks")
left.set(xlabel="CNR of one detector (dB)", ylabel="standard deviation of the elevation (beamwidths)", ylim=(5e-3, 20))
left.legend(ncols=2, fontsize="small")
right.set(xlabel="CNR of one detector (dB)", ylabel="share of estimates off by more than a beamwidth", ylim=(1e-5, 1))
right.legend()
plt.show()

for (looks, level), error in errors.items():
    cnr_here, core = 10 ** (level / 10), std(error[np.abs(error) < 1]).value
    over = core / float(speckle_crb(array, place, 0.0, cnr_here, looks))
    outliers = share(np.abs(error) > 1)
    print(
        f"{looks:2d} looks, {level:4.1f} dB: {over:.2f} of the speckle bound within a beamwidth; outliers "
        f"{outliers.value:.2%} ± {outliers.standard_error:.2%}, theory {outlier_probability(cnr_here, looks):.2%}"
    )

# %% [markdown]
# ## What this notebook claims

# %%
assert np.all(np.abs(scores) < 4), "Monte Carlo of the ratio agrees with its closed forms"
assert biased[0, 0] < 0.6 * kappa, "the ratio is biased at 0 dB"
assert abs(unbiased[3, 0] - kappa) < 4 * unbiased[3, 1], "total least squares is not, at 9 dB"
assert np.std(one_look) > 1.5 * widths[-1, 0], "the standard deviation of one look is that of its outliers"
for (looks, level), error in errors.items():
    bound = float(speckle_crb(array, place, 0.0, 10 ** (level / 10), looks))
    if level >= 5:
        assert std(error[np.abs(error) < 1]).value < 1.3 * bound, "estimates near the target are near the bound"
    if level >= 20:
        assert np.std(error) < 1.1 * bound, "at high CNR all estimates are"
    found, theory = float(np.mean(np.abs(error) > 1)), outlier_probability(10 ** (level / 10), looks)
    if 0.001 < found < 0.3:
        assert theory / 1.3 < found < 1.3 * theory, "outliers are as frequent as the integral says"
