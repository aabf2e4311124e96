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
# # Autofocus of recorded radar data
#
# The AFRL Gotcha data set holds the phase history of an X-band radar that flew circles around a car park. This notebook
# focuses three degrees of a circle, spoils the pulses with a phase error that blurs the image, and has autofocus find
# and remove that error from the data alone.
#
# The data are not part of this project: AFRL gives them out. Put consecutive files of one pass and polarisation, such
# as `data_3dsar_pass1_az001_HH.mat` and the two after it, into a folder, and name it in the environment variable
# `GOTCHA_FOLDER` or in the next cell. Reading them needs the extra `ros` (see README).

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, azimuth_resolution
from sal_height.imports import read_gotcha
from sal_height.numeric import F64
from sal_height.pipeline import Compressor
from sal_height.response import measure_brightest

FOLDER = Path(os.environ.get("GOTCHA_FOLDER", "../shared/data/afrl_gotcha"))
CYCLES = 3.0  # of the phase error at both ends of the aperture

files = sorted(FOLDER.glob("*.mat"))[:3]
if not files:
    raise SystemExit(f"There are no Gotcha files (*.mat) in {FOLDER}; name their folder in GOTCHA_FOLDER.")

# %% [markdown]
# ## The image as recorded
#
# `read_gotcha` returns the sensor, the track and the phase history, and the parameters that focus the scene on the
# ground. `Compressor` is the same that focuses lidar images. The response of the brightest target tells how well the
# image is focused: its widths are compared with those that follow from the bandwidth and from the length of the track.

# %%
collection = read_gotcha(files)
sensor, history, track = collection.sensor, collection.histories[0], Trajectory(list(collection.states))
settings = ImageSettings(**collection.parameters["sar_compression"])
recorded = Compressor().add(history, track, sensor, settings)

response, grid = measure_brightest(recorded.images[0]), recorded.grid
sight = grid.points(response.row, response.col) - recorded.aperture.position
slant_range = float(np.linalg.norm(sight))
cross = azimuth_resolution(sensor, recorded.aperture, slant_range)
along = sensor.range_resolution / abs(float(sight @ grid.row_direction) / slant_range)
HALF_POWER = 0.886  # width of the main lobe of an unweighted band, in resolutions
widths = np.array([response.row_cut.width * grid.row_spacing, response.col_cut.width * grid.col_spacing])
expected = HALF_POWER * np.array([along, cross])
print(f"{sensor.pulse_count} pulses, brightest target {response.peak_over_median_db:.1f} dB over the median")
for name, width, theory in zip(("ground range", "cross range"), widths, expected, strict=True):
    print(f"width in {name} {width:.3f} m; by bandwidth and track {theory:.3f} m")

# %% [markdown]
# ## The same with a phase error
#
# A path length that changes by centimetres during the flight, unknown to navigation, turns the phase of whole pulses. A
# quadratic error is the commonest: it is that of a wrong speed. Autofocus is asked to find it without being told
# anything of it; for comparison it also looks at the data as recorded.

# %%
phase = 2 * np.pi * CYCLES * np.linspace(-1, 1, sensor.pulse_count) ** 2
spoilt_history = replace(history, samples=history.samples * np.exp(1j * phase)[:, None].astype(np.complex64))
with_autofocus = settings.model_copy(update={"autofocus": True})
images = {
    "as recorded": recorded,
    "spoilt": Compressor().add(spoilt_history, track, sensor, settings),
    "spoilt, autofocused": Compressor().add(spoilt_history, track, sensor, with_autofocus),
    "as recorded, autofocused": Compressor().add(history, track, sensor, with_autofocus),
}
contrast = {name: measure_brightest(slc.images[0]).peak_over_median_db for name, slc in images.items()}
for name, value in contrast.items():
    print(f"{name}: brightest target {value:.1f} dB over the median")

peak = np.abs(recorded.images[0]).max()
row, col = round(response.row), round(response.col)
figure, axes = plt.subplots(1, 3, figsize=(12, 4.6), sharex=True, sharey=True, layout="constrained")
for axis, (name, slc) in zip(axes, images.items(), strict=False):
    level = 20 * np.log10(np.maximum(np.abs(slc.images[0][row - 75 : row + 76, col - 75 : col + 76]) / peak, 1e-4))
    shown = axis.imshow(level, cmap="cividis", vmin=-50, vmax=0, extent=(-15.1, 15.1, -15.1, 15.1), origin="lower")
    axis.set(title=name, xlabel="cross range (m)")
axes[0].set(ylabel="ground range (m)")
figure.colorbar(shown, ax=axes, label="power over that of the brightest target (dB)")
plt.show()

# %% [markdown]
# ## What autofocus found
#
# No image tells the mean of a phase error, nor its linear part, which only shifts the image: both are taken off before
# comparison. What autofocus finds in the data as recorded is taken off as well: it is an error that they came with, as
# the contrast of the image says, which grows by the correction.

# %%
time = np.linspace(-1, 1, sensor.pulse_count)


def without_trend(values: F64) -> F64:
    """A phase over the pulses without its mean and its linear part, rad."""
    return values - np.polyval(np.polyfit(time, values, 1), time)


own = without_trend(np.unwrap(images["as recorded, autofocused"].autofocus_phase))
found = without_trend(np.unwrap(images["spoilt, autofocused"].autofocus_phase))
left = without_trend(found - own - phase)
rms = float(np.sqrt(np.mean(left**2)))
stated = images["spoilt, autofocused"].focus.standard_error
print(f"put in {np.std(without_trend(phase)):.2f} rad rms, in the data as recorded {np.std(own):.2f} rad")
print(f"left {rms:.3f} rad rms; autofocus states a standard error of {stated:.3f} rad")

figure, (cuts, phases) = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained")
offset = np.arange(-30, 31) * grid.col_spacing
for (name, slc), style in zip(images.items(), ("k-", "C1-", "C0--"), strict=False):
    cut = np.abs(slc.images[0][row, col - 30 : col + 31]) / peak
    cuts.plot(offset, 20 * np.log10(np.maximum(cut, 1e-3)), style, label=name)
cuts.set(xlabel="cross range from the target (m)", ylabel="power (dB)", title="cut through the brightest target")
cuts.legend()
pulse = np.arange(sensor.pulse_count)
phases.plot(pulse, without_trend(phase), "k-", lw=4, alpha=0.4, label="put in")
phases.plot(pulse, found - own, "C0--", label="found by autofocus")
phases.plot(pulse, own, "C2-", label="found in the data as recorded")
phases.set(xlabel="pulse", ylabel="phase error (rad)", title="without mean and linear part")
phases.legend()
plt.show()

# %% [markdown]
# ## What this notebook claims

# %%
assert np.all(np.abs(widths / expected - 1) < 0.1), "the image is as sharp as bandwidth and track allow"
assert contrast["spoilt"] < contrast["as recorded"] - 10, "the error costs more than 10 dB"
assert contrast["spoilt, autofocused"] > contrast["as recorded"] - 0.5, "autofocus wins them back"
assert contrast["as recorded, autofocused"] > contrast["as recorded"], "it improves the image as recorded"
assert rms < stated, "of the error that was put in, less is left than autofocus states"
