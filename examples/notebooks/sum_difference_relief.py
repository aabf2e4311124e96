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
# # Relief from sum and difference
#
# A radar with two beams, one above the other, needs only two receivers: one for the sum Σ of the beams, one for their
# difference Δ. The ratio Δ/Σ of a pixel tells the elevation angle of its scatterer, and with it the height. This is
# monopulse, as in tracking radars, applied to every pixel of a SAR image.
#
# This notebook goes from the ratio of single pixels to a map of mountains: the discriminator, heights and their errors
# before tracking and after it, and the map of all dwells.

# %%
import matplotlib.pyplot as plt
import numpy as np

from sal_height.beams import column_squint
from sal_height.elevation import ESTIMATORS, discriminant, look_grid, products, speckle_crb, total_least_squares
from sal_height.imaging import ImageSettings, azimuth_resolution, image_beams
from sal_height.pipeline import Compressor, elevations, heights_of_dwells
from sal_height.relief import PriorEstimate, ReliefMap, TrackingSettings, fitting_cell_size, track
from sal_height.simulation import flight_of, load_preset, truth_image

preset = load_preset("xband_sumdiff")
flight = flight_of(preset, seed=1)
sensor = flight.sensor
compressor = Compressor()
image_settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
slcs = [
    compressor.add(flight.phase_history(dwell), flight.track(dwell), sensor, image_settings)
    for dwell in range(flight.dwells)
]

# %% [markdown]
# ## The discriminator
#
# Each image has two channels, Σ and Δ. Of the pixels of one height, `products` sums the powers and the cross product,
# and `total_least_squares` makes the ratio of them that is most likely. Beside it stands the elevation angle that the
# simulator knows. The curve is the ratio that the beams have without noise.

# %%
estimator = ESTIMATORS["sum_difference"]
settings = estimator.settings(
    range_looks=preset.looks[0],
    azimuth_looks=preset.looks[1],
    max_sigma_beamwidths=100.0,  # no height is left out for its standard deviation: tracking weighs them
)
truths, gammas = [], []
for dwell, slc in enumerate(slcs):
    grid, beams = look_grid(slc.grid, *settings.windows), image_beams(sensor, slc.azimuth_window)
    cell = sensor.range_resolution * azimuth_resolution(sensor, slc.aperture, preset.flight.slant_range_m)
    truths.append(truth_image(flight.surface(dwell), slc.aperture, grid, cell, beams))
    blocks = slc.images.reshape(2, grid.rows, preset.looks[0], grid.cols, preset.looks[1]).swapaxes(2, 3)
    total, difference = blocks.reshape(2, *grid.shape, -1)
    gammas.append(total_least_squares(products(total, difference), np.nan))
gamma, elevation = np.stack(gammas), np.stack([truth.elevation for truth in truths])

middle, reach = np.mean(sensor.beams.span), np.ptp(sensor.beams.span) / 2
angle = np.linspace(-1, 1, 101) * reach
known = np.isfinite(elevation) & (np.abs(gamma) < 2)
figure, axis = plt.subplots(figsize=(7, 5), layout="constrained")
shown = axis.hexbin(
    1e3 * (elevation[known] - middle), gamma[known], gridsize=50, bins="log", cmap="cividis", mincnt=1, linewidths=0
)
axis.plot(1e3 * angle, discriminant(sensor.beams, middle + angle, 0.0), "r-", label="two beams without noise")
axis.set(xlabel="elevation from the middle of the beams (mrad)", ylabel="Δ / Σ", title="what the pixels measure")
axis.set(xlim=1e3 * reach * np.array([-1, 1]), ylim=(-1.5, 1.5))
axis.legend(loc="upper left")
figure.colorbar(shown, label="pixels")
plt.show()

edges = np.linspace(-0.5, 0.5, 6) * reach + middle
of_bin = np.digitize(elevation, edges)
centres = (edges[1:] + edges[:-1]) / 2
medians = np.array([np.median(gamma[known & (of_bin == number)]) for number in range(1, 6)])
expected = np.array([np.median(discriminant(sensor.beams, elevation[of_bin == n], 0.0)) for n in range(1, 6)])
for centre, found, beam in zip(centres, medians, expected, strict=True):
    print(f"at {1e3 * (centre - middle):5.1f} mrad: median of Δ / Σ {found:6.3f}, of the beams {beam:6.3f}")

# %% [markdown]
# ## Heights
#
# `heights_of_dwells` inverts the curve, and computes height, place and standard deviation from elevation, range and
# Doppler. Two beams as wide as these measure angles much less well than the sixteen narrow beams of preset
# `xband_relief`: the standard deviation is a good part of the relief. The Cramér-Rao bound says that no estimator can
# do much better with them. The errors are a little below it for two reasons: the darkest pixels are not detected, and
# the four looks depend on each other, while the bound is that of fewer independent ones.

# %%
fields = heights_of_dwells(slcs, sensor, estimator, settings)
count = float(np.median(elevations(slcs[0], sensor, estimator, settings)[1].count))
rise = preset.flight.slant_range_m * np.sin(preset.flight.look_angle_rad)  # of height over elevation, m/rad
true_height = np.stack([truth.height for truth in truths])
measured, sigma = (np.stack([getattr(field.first, name) for field in fields]) for name in ("height", "sigma"))
bounds = []
for slc, field, truth in zip(slcs, fields, truths, strict=True):
    squint = column_squint(field.grid, slc.aperture, sensor.beams, sensor.look_side)
    cnr = 10 ** (preset.cnr_db / 10) * truth.power
    bounds.append(rise * speckle_crb(image_beams(sensor, slc.azimuth_window), truth.elevation, squint, cnr, count))
single = np.isfinite(measured) & np.stack([truth.single for truth in truths])
error = (measured - true_height)[single]
ratio = float(np.sqrt(np.mean((error / np.stack(bounds)[single]) ** 2)))
within = float(np.mean(np.abs(error) < sigma[single]))
print(f"{error.size} heights; standard deviation of the terrain {np.std(true_height[single]):.0f} m")
print(f"their error {np.std(error):.0f} m, {ratio:.2f} times the Cramér-Rao bound; {within:.0%} are within one sigma")

# %% [markdown]
# ## Tracking
#
# Mountains are smooth compared with these errors. `track` knows this as a prior: heights are correlated over a certain
# length and have a certain standard deviation about their mean. It estimates both from the dwells, and a Kalman filter
# and smoother then weigh each pixel against its neighbours along range. By default it does so along the flight as well.

# %%
tracked = {}
for along_track in (False, True):
    before, images = PriorEstimate(), []
    for slc, field in zip(slcs, fields, strict=True):
        image, prior, before = track(field, slc.aperture, before, TrackingSettings(along_track=along_track))
        images.append(image)
    tracked["along range and the flight" if along_track else "along range"] = images
print(f"prior: correlation length {prior.length:.0f} m, standard deviation {prior.sigma:.0f} m")

left = {"not tracked": float(np.std(error))}
kept = {}
for name, images in tracked.items():
    smooth, said = (np.stack([getattr(image.first, key) for image in images]) for key in ("height", "sigma"))
    chosen = single & np.isfinite(smooth)
    left[name] = float(np.std((smooth - true_height)[chosen]))
    kept[name] = float(np.mean(np.abs(smooth - true_height)[chosen] < said[chosen]))
    print(f"tracked {name}: error {left[name]:.0f} m; {kept[name]:.0%} of the heights are within one sigma")

dwell, col = len(slcs) // 2, fields[0].grid.cols // 2
figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
distance = np.arange(fields[0].grid.rows) * fields[0].grid.row_spacing / 1e3
line = fields[dwell].first
axis.errorbar(
    distance, line.height[:, col], line.sigma[:, col], fmt=".", color="0.6", lw=0.8, label="one pixel, 1 sigma"
)
for (name, images), colour in zip(tracked.items(), ("C0", "C1"), strict=True):
    line = images[dwell].first
    height, said = line.height[:, col], line.sigma[:, col]
    axis.fill_between(distance, height - said, height + said, color=colour, alpha=0.25, linewidth=0)
    axis.plot(distance, height, color=colour, label=f"tracked {name}, 1 sigma")
axis.plot(distance, true_height[dwell, :, col], "k-", lw=1.5, label="terrain")
axis.set(xlabel="slant range from the first row (km)", ylabel="height (m)", title=f"dwell {dwell}, one column")
axis.legend()
plt.show()

# %% [markdown]
# ## The map
#
# `ReliefMap` averages all dwells in the cells of one grid, weighted by their variances. Here the dwells lie side by
# side, so that few cells are seen twice.

# %%
maps = {}
for name, images in {"not tracked": fields, **tracked}.items():
    relief_map = ReliefMap(fitting_cell_size(fields[0].grid, slcs[0].aperture), max_cells=10**6)
    for image in images:
        relief_map.add(image)
    maps[name] = relief_map.relief()

figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey=True, layout="constrained")
low, high = np.percentile(true_height[single], [1, 99])
map_error = {}
for axis, (name, relief) in zip(axes.flat[1:], maps.items(), strict=True):
    rows, cols = relief.height.shape
    east, north = relief.east + relief.cell_size * np.arange(cols), relief.north + relief.cell_size * np.arange(rows)
    terrain = flight.scene.heights(*np.meshgrid(east, north))
    seen = np.isfinite(relief.height)
    map_error[name] = float(np.std((relief.height - terrain)[seen]))
    extent = np.array([east[0], east[-1], north[0], north[-1]]) / 1e3
    shown = axis.imshow(relief.height, origin="lower", extent=extent, vmin=low, vmax=high, cmap="viridis")
    axis.set_title(f"{name}: error {map_error[name]:.0f} m", fontsize="medium")
axes[0, 0].imshow(terrain, origin="lower", extent=extent, vmin=low, vmax=high, cmap="viridis")
axes[0, 0].set_title("terrain", fontsize="medium")
figure.supxlabel("east (km)")
figure.supylabel("north (km)")
figure.colorbar(shown, ax=axes, label="height (m)", shrink=0.8)
plt.show()

# %% [markdown]
# ## What this notebook claims

# %%
assert np.all(np.abs(medians - expected) < 0.02), "the median of Δ / Σ is that of the beams"
assert 0.8 < ratio < 1.3, "the errors of single pixels are near the Cramér-Rao bound"
assert 0.6 < within < 0.8, "two thirds of them are within the sigma that is stated"
assert left["along range"] < 0.7 * left["not tracked"], "tracking along range removes a third of the error or more"
assert left["along range and the flight"] < left["along range"], "tracking along the flight removes more"
assert all(0.6 < share < 0.8 for share in kept.values()), "sigma stays honest"
assert map_error["along range and the flight"] < 0.5 * map_error["not tracked"], "the map gains as well"
