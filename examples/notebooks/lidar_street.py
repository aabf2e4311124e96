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
# # A street in three dimensions
#
# A lidar with a synthetic aperture flies past a street, 5 km away. It has 16 detectors, whose beams lie above each
# other, half a beamwidth apart. Every detector makes an image of range and azimuth. A pixel of these images is bright
# in the detectors that look towards its scatterer, and the ratios of its amplitudes tell the elevation angle. With
# range and azimuth this is a place in three dimensions.
#
# This notebook goes from the samples of the detectors to heights, draws them, and compares their errors with the least
# that any estimator can have. Where several surfaces lie at the same range (*layover*), it counts how many were found.

# %%
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from sal_height.beams import column_squint
from sal_height.elevation import ESTIMATORS, MlSettings, Validity, speckle_crb
from sal_height.geometry import sphere_coordinates
from sal_height.imaging import ImageSettings, Processing, azimuth_resolution, image_beams
from sal_height.pipeline import Compressor, elevations, heights_of_dwells
from sal_height.runs.truth.comparison import FOUND_ORDERS, TRUE_ORDERS, compare, joined_comparisons
from sal_height.simulation import flight_of, load_preset, truth_image
from sal_height.simulation.lit_surfaces import lit_surfaces

preset = load_preset("sal_spotlight")
flight = flight_of(preset, seed=1)
sensor = flight.sensor

# %% [markdown]
# ## From phase history to images
#
# The flight consists of short dwells. In each of them the beams are held on one piece of the street. The simulator
# delivers the *phase history*: complex samples over pulses and fast-time frequencies, for every detector, with speckle
# and noise. `Compressor` focuses them; all detectors get the same filter, so that their ratios are preserved.

# %%
compressor = Compressor()
image_settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
slcs = [
    compressor.add(flight.phase_history(dwell), flight.track(dwell), sensor, image_settings)
    for dwell in range(flight.dwells)
]

power = np.concatenate([np.mean(np.abs(slc.images) ** 2, axis=0) / slc.noise_power.mean() for slc in slcs], axis=1)
grid = slcs[0].grid
figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
length, depth = power.shape[1] * grid.col_spacing, power.shape[0] * grid.row_spacing
shown = axis.imshow(10 * np.log10(power), cmap="cividis", vmin=0, vmax=20, extent=(0, length, depth, 0))
axis.set(
    title="mean over all detectors: behind each car is its shadow",
    xlabel="distance along the flight (m)",
    ylabel="slant range from the first row (m)",
)
figure.colorbar(shown, label="power over noise (dB)")
plt.show()

# %% [markdown]
# ## From images to heights
#
# `ml` is the exact maximum likelihood over all detectors. Four pixels are averaged for one height. Each pixel gets up
# to three surfaces, each with its place and its standard deviation, or a reason why there is none. Below, every surface
# of every pixel is a point; nothing is left out.

# %%
ml, settings = ESTIMATORS["ml"], MlSettings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
fields = heights_of_dwells(slcs, sensor, ml, settings)

surfaces = [surface for field in fields for surface in field.surfaces]
there = [np.isfinite(surface.height) for surface in surfaces]
places = np.concatenate([surface.positions[seen] for surface, seen in zip(surfaces, there, strict=True)])
sigma = np.concatenate([surface.sigma[seen] for surface, seen in zip(surfaces, there, strict=True)])
east, north, height = sphere_coordinates(places)
print(f"{len(height)} surfaces in {sum(field.validity.size for field in fields)} pixels")

figure = plt.figure(figsize=(12, 6), layout="constrained")
for number, (values, colours, label) in enumerate(
    ((height, {"cmap": "viridis"}, "height (m)"), (sigma, {"cmap": "cividis", "norm": LogNorm()}, "sigma (m)")), 1
):
    axis = figure.add_subplot(1, 2, number, projection="3d")
    points = axis.scatter(east, north, height, c=values, s=6, linewidths=0, depthshade=False, **colours)
    axis.set(xlabel="east (m)", ylabel="north (m)", zlabel="height (m)", zlim=(-0.5, 2.0), zticks=(0, 1, 2))
    axis.set_box_aspect((np.ptp(east), np.ptp(north), 2.5), zoom=0.9)
    axis.view_init(elev=38, azim=55)
    figure.colorbar(points, ax=axis, label=label, orientation="horizontal", shrink=0.7, pad=0.02)
plt.show()

# %% [markdown]
# ## Errors, and the least that they can be
#
# The simulator knows what each pixel should show. Where a pixel holds one scatterer, the Cramér-Rao bound follows from
# the beams, the CNR and the number of looks. Neighbouring pixels are alike, because the images are weighted to have low
# sidelobes, so that four pixels count as fewer looks; `looks.count` says as how many.

# %%
_, looks, _, _ = elevations(slcs[0], sensor, ml, settings)
count = float(np.median(looks.count))
rise = preset.flight.slant_range_m * np.sin(preset.flight.look_angle_rad)  # of height over elevation, m/rad
comparisons, errors, sigmas, bounds = [], [], [], []
for dwell, (slc, field) in enumerate(zip(slcs, fields, strict=True)):
    lit, beams = flight.surface(dwell), image_beams(sensor, slc.azimuth_window)
    cell = sensor.range_resolution, azimuth_resolution(sensor, slc.aperture, preset.flight.slant_range_m)
    spacing = slc.grid.row_spacing, slc.grid.col_spacing
    reach = Processing(slc.range_window, slc.azimuth_window).reach(cell, spacing)
    true_surfaces = lit_surfaces(lit, slc.aperture, field.grid, cell, reach, beams, seen=field.first.positions)
    comparisons.append(compare(field, true_surfaces, sensor.beamwidth))
    truth = truth_image(lit, slc.aperture, field.grid, cell[0] * cell[1], beams)
    squint = column_squint(field.grid, slc.aperture, sensor.beams, sensor.look_side)
    bound = rise * speckle_crb(beams, truth.elevation, squint, 10 ** (preset.cnr_db / 10) * truth.power, count)
    single = truth.single & (field.validity == Validity.OK)
    errors.append((field.first.height - truth.height)[single])
    sigmas.append(field.first.sigma[single])
    bounds.append(bound[single])
error, stated, bound = map(np.concatenate, (errors, sigmas, bounds))
near = np.abs(error) < 5 * stated
ratio = float(np.sqrt(np.mean((error / bound)[near] ** 2)))
print(f"four pixels count as {count:.2f} looks; {np.mean(~near):.2%} of the errors are beyond 5 sigma")
print(f"the others have {ratio:.2f} times the Cramér-Rao bound (rms)")

of_class = np.digitize(bound, np.quantile(bound, np.arange(1, 8) / 8))
rows = []
for number in range(8):
    chosen = near & (of_class == number)
    least, spread, said = (np.sqrt(np.mean(values[chosen] ** 2)) for values in (bound, error, stated))
    rows.append((least, spread, spread / np.sqrt(2 * np.count_nonzero(chosen)), said))
least, spread, uncertainty, said = 100 * np.array(rows).T  # cm
figure, axis = plt.subplots(figsize=(7, 5), layout="constrained")
axis.errorbar(least, spread, 2 * uncertainty, fmt="o", label="errors of height (rms), with 2 standard errors")
axis.plot(least, said, "s", mfc="none", label="standard deviation that the pixels state (rms)")
axis.plot(least, least, "k-", label="Cramér-Rao bound")
axis.set(xlabel="Cramér-Rao bound (cm of height)", ylabel="standard deviation (cm of height)", ylim=(0, None))
axis.set_title("pixels with one scatterer, in eight classes of their bound")
axis.legend(loc="lower right")
plt.show()

# %% [markdown]
# ## Layover
#
# The side of a car, its roof and the street before it have the same range. How many surfaces does a pixel truly hold,
# and how many did the estimator find? Two surfaces closer than 0.3 beamwidths count as one.

# %%
result = joined_comparisons(comparisons)
found = result.surfaces - result.missed
print(f"{found} of {result.surfaces} lit surfaces were found")
print(f"{result.ghosts} of {result.shadow} pixels in shadow show a surface where there is none")
pixels = result.confusion[:, :-1]  # the last column is of tracked heights
share = pixels / pixels.sum(axis=1, keepdims=True)
figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
shown = axis.imshow(share, cmap="cividis", vmin=0, vmax=1, aspect="auto")
for (row, col), number in np.ndenumerate(pixels):
    axis.text(col, row, str(number), ha="center", va="center", color="black" if share[row, col] > 0.5 else "white")
axis.set_xticks(range(len(FOUND_ORDERS) - 1), FOUND_ORDERS[:-1])
axis.set_yticks(range(len(TRUE_ORDERS)), TRUE_ORDERS)
axis.set(xlabel="what was found in the pixel", ylabel="what the pixel holds", title="number of pixels")
figure.colorbar(shown, label="share of the pixels of a row")
plt.show()

# %% [markdown]
# ## What this notebook claims

# %%
assert ratio < 1.3, "the errors of single scatterers are near the Cramér-Rao bound"
assert np.mean(~near) < 0.005, "hardly any error is beyond 5 sigma"
assert 0.6 < np.mean(np.abs(error) < stated) < 0.8, "two thirds of the errors are within one sigma"
assert found > 0.8 * result.surfaces, "four of five lit surfaces are found, layover included"
assert result.ghosts < 0.01 * result.shadow, "shadow stays empty"
