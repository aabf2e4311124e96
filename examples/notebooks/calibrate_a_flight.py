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
# # Calibrate a flight on its own scene
#
# Heights follow from the ratios of amplitudes between detectors. If the receivers behind the detectors do not have the
# gains and phases that their description states, these ratios are wrong, and so are the heights.
#
# All detectors see the same speckle. How strongly each should see a scatterer depends on one unknown elevation; what
# does not fit this, in thousands of pixels, tells gains and phases. No target of known place is needed. This notebook
# spoils the receivers of a lidar, measures them on the first half of a flight, and looks at the heights of the second
# half. Every number has a standard error, and differences within the errors are not called differences.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from sal_height.calibration import Calibration, Calibrator
from sal_height.elevation import ESTIMATORS, MlSettings, Validity
from sal_height.imaging import ImageSettings, azimuth_resolution, image_beams
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights_of_dwells
from sal_height.simulation import Impairments, Preset, flight_of, load_preset, truth_image

GAINS_DB = (-0.8, -1.3, -0.3, 0.4, 1.1, 0.1, -0.5, -0.8)
PHASES_RAD = (0.15, 0.33, 0.05, -0.25, -0.19, 0.32, 0.04, -0.35)

described = replace(load_preset("small"), dwells=64)
spoilt = replace(described, impairments=Impairments(undescribed_gains_db=GAINS_DB, undescribed_phases_rad=PHASES_RAD))
first_half, second_half = range(described.dwells // 2), range(described.dwells // 2, described.dwells)

# %% [markdown]
# ## Measure the receivers
#
# `Calibrator` takes in the images of one dwell after the other. They must be neither calibrated nor weighted in range.
# `calibration` then returns the response of each receiver with its standard errors, and a sentence for each quantity
# that the scene does not determine. A gain that all receivers share cannot be seen in ratios, so that gains and phases
# are relative to their mean.

# %%
flight, compressor = flight_of(spoilt, seed=1), Compressor()
calibrator = Calibrator(flight.sensor)
unweighted = ImageSettings(air="none", range_window="rectangular")
for dwell in first_half:
    calibrator.add(compressor.add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, unweighted))
calibration, undetermined = calibrator.calibration()
for sentence in undetermined:
    print(sentence)

gain = np.mean(calibration.response, axis=1)
decibels = 20 / np.log(10)
found = {"gain (dB)": decibels * np.log(np.abs(gain)), "phase (rad)": np.angle(gain)}
errors = {"gain (dB)": decibels * calibration.gain_sigma, "phase (rad)": calibration.phase_sigma}
true = {"gain (dB)": np.array(GAINS_DB), "phase (rad)": np.array(PHASES_RAD)}
channels = np.arange(len(gain))
deviations = {}
figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
for axis, (name, values) in zip(axes, found.items(), strict=True):
    expected = true[name] - true[name].mean()
    relative = values - values.mean()
    deviations[name] = (relative - expected) / errors[name]
    axis.bar(channels, expected, color="0.8", label="put into the simulation")
    axis.errorbar(channels, relative, 2 * errors[name], fmt="o", capsize=4, label="measured, with 2 standard errors")
    axis.set(ylabel=f"{name}, relative to the mean")
axes[0].legend()
axes[1].set(xlabel="receiver")
plt.show()
for name, values in deviations.items():
    print(f"{name}: deviations from the truth in standard errors", np.round(values, 1))

# %% [markdown]
# ## Heights before and after
#
# The second half of the flight is processed three times: by a sensor that is as described, by the spoilt one, and by
# the spoilt one with the calibration. An error of the receivers moves heights by an amount that depends on where in the
# array a scatterer is seen. The errors are therefore averaged in classes of elevation. At the very ends of the array,
# which are not shown, the mean is biased with any receivers: estimates beyond the end are no heights.

# %%
settings = MlSettings(range_looks=described.looks[0], azimuth_looks=described.looks[1])
image_settings = ImageSettings(air="none", rows=described.image.rows, cols=described.image.cols)


def errors_of_heights(preset: Preset, calibration: Calibration | None = None) -> F64:
    """Elevation (beamwidths from the middle), error of height and its sigma (m), of pixels with one scatterer."""
    flight, compressor = flight_of(preset, seed=1), Compressor()
    sensor, slant_range = flight.sensor, preset.flight.slant_range_m
    slcs = [
        compressor.add(flight.phase_history(dwell), flight.track(dwell), sensor, image_settings, calibration)
        for dwell in second_half
    ]
    parts = []
    fields = heights_of_dwells(slcs, sensor, ESTIMATORS["ml"], settings, calibration)
    for dwell, slc, field in zip(second_half, slcs, fields, strict=True):
        beams, cell = image_beams(sensor, slc.azimuth_window), azimuth_resolution(sensor, slc.aperture, slant_range)
        truth = truth_image(flight.surface(dwell), slc.aperture, field.grid, sensor.range_resolution * cell, beams)
        chosen = truth.single & (field.validity == Validity.OK)
        angle = (truth.elevation - np.mean(beams.span)) / beams.beamwidth
        parts.append(np.stack([angle, field.first.height - truth.height, field.first.sigma])[:, chosen])
    return np.concatenate(parts, axis=1)


heights = {
    "as described": errors_of_heights(described),
    "spoilt": errors_of_heights(spoilt),
    "spoilt and calibrated": errors_of_heights(spoilt, calibration),
}
within = {name: float(np.mean(np.abs(error) < sigma)) for name, (_, error, sigma) in heights.items()}
for name, (_, error, _) in heights.items():
    print(f"{name}: {error.size} heights, error {100 * np.std(error):.2f} cm, {within[name]:.0%} within their sigma")

# %%
edges = np.linspace(-1.5, 1.5, 7)
means, uncertainties = {}, {}
figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
for number, (name, (angle, error, _)) in enumerate(heights.items()):
    of_class = [100 * error[(angle >= low) & (angle < low + 0.5)] for low in edges[:-1]]
    means[name] = np.array([np.mean(values) for values in of_class])
    uncertainties[name] = np.array([np.std(values) / np.sqrt(values.size) for values in of_class])
    middles = edges[:-1] + 0.25 + 0.06 * (number - 1)
    axis.errorbar(middles, means[name], 2 * uncertainties[name], fmt="osD"[number], capsize=4, label=name)
axis.axhline(0.0, color="k", lw=0.8)
axis.set(
    xlabel="elevation from the middle of the array (beamwidths)",
    ylabel="mean error of height (cm)",
    title="second half of the flight, with 2 standard errors",
)
axis.legend()
plt.show()
significance = {name: np.abs(means[name]) / uncertainties[name] for name in means}
for name, values in significance.items():
    print(f"{name}: mean errors in standard errors {np.round(values, 1)}")

# %% [markdown]
# ## What this notebook claims
#
# The spoilt receivers bias heights, the calibration removes this, and with it more pixels fit one scatterer again.
# Whether calibrated receivers are as good as those that were never spoilt, or a little worse, is within the error bars
# of this flight: nothing is claimed about it.

# %%
for name, values in deviations.items():
    assert np.all(np.abs(values) < 4), f"every {name} is measured to its standard errors"
    assert np.all(errors[name] < 0.2 * np.std(true[name])), f"the errors of {name} are small beside what was put in"
assert np.count_nonzero(significance["spoilt"] > 5) >= 3, "spoilt receivers bias heights"
assert np.all(significance["spoilt and calibrated"] < 4), "no bias is left that stands out from the errors"
lost = 1 - heights["spoilt"].shape[1] / heights["as described"].shape[1]
assert lost > 0.1, "spoilt receivers cost heights"
assert heights["spoilt and calibrated"].shape[1] > 0.97 * heights["as described"].shape[1], "they are won back"
