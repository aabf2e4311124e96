"""What a run achieved: errors of every estimator against the truth, in ground coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sal_height_msgs.msg import HeightImage

from sal_height import convert
from sal_height.evaluation import Truth, height_bound, truth_image
from sal_height.flight import SimulatedFlight
from sal_height.geometry import Aperture, Grid, sphere_coordinates
from sal_height.height import column_squint
from sal_height.scene import VisibleSurface

Array = npt.NDArray[np.float64]


CELL_PIXELS = 1.5
"""Side of a ground cell in pixels on level ground: large enough that few cells stay empty."""


@dataclass(frozen=True)
class Mosaic:
    """Height images of a run in ground cells, each the mean of its pixels weighted by 1 / sigma^2; NaN where unseen.

    Attributes:
        east: centres of the cells, arc distance from the map origin, m, shape (cols,).
        north: centres of the cells, m, shape (rows,).
        height: estimate, m, shape (rows, cols).
        truth: true height of the same pixels with the same weights, m; NaN where a pixel has no scatterer.
        sigma: predicted standard deviation, m.
        bound: Cramer-Rao bound, m.
        single: True where all pixels hold a single scatterer.
        valid_share: valid pixels over all pixels of the images.
        ghosts: valid pixels in which there is no scatterer.
    """

    east: Array
    north: Array
    height: Array
    truth: Array
    sigma: Array
    bound: Array
    single: npt.NDArray[np.bool_]
    valid_share: float
    ghosts: int


def mosaic(images: Sequence[HeightImage], flight: SimulatedFlight, surfaces: Mapping[int, VisibleSurface]) -> Mosaic:
    """Mosaic of the height images of one estimator of a simulated flight, which saw `surfaces` in its dwells."""
    parts = [_pixels(image, flight, surfaces[image.dwell]) for image in images]
    shares = [np.mean(np.asarray(image.validity) == HeightImage.OK) for image in images]
    east, north, height, sigma, truth, bound, single = (np.concatenate(column) for column in zip(*parts, strict=True))
    grid = images[0].grid
    level_row = grid.row_spacing / np.sin(flight.preset.flight.look_angle_rad)
    step = (CELL_PIXELS * level_row, CELL_PIXELS * grid.col_spacing)
    col_of, row_of = np.rint(east / step[1]).astype(int), np.rint(north / step[0]).astype(int)
    first_row, first_col = row_of.min(), col_of.min()
    shape = (row_of.max() - first_row + 1, col_of.max() - first_col + 1)
    cell = (row_of - first_row) * shape[1] + col_of - first_col
    weight = 1 / sigma**2

    def total(values: Array) -> Array:
        return np.bincount(cell, values, shape[0] * shape[1]).reshape(shape)

    with np.errstate(divide="ignore", invalid="ignore"):
        weights = total(weight)
        return Mosaic(
            east=(first_col + np.arange(shape[1])) * step[1],
            north=(first_row + np.arange(shape[0])) * step[0],
            height=total(weight * height) / weights,
            truth=total(weight * truth) / weights,
            sigma=1 / np.sqrt(weights),
            bound=np.sqrt(total((weight * bound) ** 2)) / weights,
            single=(total(~single) == 0) & (weights > 0),
            valid_share=float(np.mean(shares)),
            ghosts=int(np.count_nonzero(~np.isfinite(truth))),
        )


def statistics(result: Mosaic | None) -> dict[str, float | int | None]:
    """Errors over the cells that hold a single scatterer; numbers that do not exist (no valid pixel) are None.

    `bias_m` mean, `rms_m`, `median_m`, `s68_m` half the 16 to 84 % width, `sigma_m` mean predicted standard deviation,
    `crb_m` mean Cramer-Rao bound averaged over speckle, `within_1_sigma` share; `valid` is the share of valid pixels.
    """
    errors = ("bias_m", "rms_m", "median_m", "s68_m", "sigma_m", "crb_m", "within_1_sigma")
    if result is None:
        return {"valid": 0.0, "cells": 0, "ghost_pixels": 0, **dict.fromkeys(errors)}
    chosen = result.single & np.isfinite(result.truth)
    error = (result.height - result.truth)[chosen]
    counts = {"valid": result.valid_share, "cells": len(error), "ghost_pixels": result.ghosts}
    if not len(error):
        return {**counts, **dict.fromkeys(errors)}
    low, middle, high = np.percentile(error, [16, 50, 84])
    bound = float(np.mean(result.bound[chosen]))
    return counts | {
        "bias_m": float(np.mean(error)),
        "rms_m": float(np.sqrt(np.mean(error**2))),
        "median_m": float(middle),
        "s68_m": float(high - low) / 2,
        "sigma_m": float(np.mean(result.sigma[chosen])),
        "crb_m": bound if np.isfinite(bound) else None,
        "within_1_sigma": float(np.mean(np.abs(error) < result.sigma[chosen])),
    }


def stage_report(accounts: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, object]]:
    """Per stage `in`, `processed`, `out`, `dropped` and `ignored` by reason and latencies, from the diagnostics."""
    return {
        name: {
            "in": int(account.get("in", 0)),
            "processed": int(account.get("processed", 0)),
            "out": int(account.get("out", 0)),
            "dropped": _by_reason(account, "dropped."),
            "ignored": _by_reason(account, "ignored."),
            "latency_p50_ms": account.get("latency_p50_ms"),
            "latency_p95_ms": account.get("latency_p95_ms"),
        }
        for name, account in accounts.items()
    }


def _by_reason(account: Mapping[str, float], prefix: str) -> dict[str, int]:
    return {key.removeprefix(prefix): int(count) for key, count in account.items() if key.startswith(prefix)}


def _pixels(image: HeightImage, flight: SimulatedFlight, surface: VisibleSurface) -> tuple[Array, ...]:
    """Of the valid pixels: ground position east and north, height, sigma, true height, bound, single."""
    grid, aperture = convert.grid_from_message(image.grid), convert.aperture_from_message(image.aperture)
    truth, bound = _truth(image, grid, aperture, flight, surface)
    height, sigma, east, north = (
        convert.float_view(values, grid.shape) for values in (image.height, image.sigma, image.east, image.north)
    )
    valid = np.asarray(image.validity).reshape(grid.shape) == HeightImage.OK
    offset = np.stack([east[valid], north[valid]], axis=-1) + grid.origin[:2]
    # The map position's height above the plane z = 0 does not matter for where it lies on the sphere to first order.
    ground_east, ground_north, _ = sphere_coordinates(np.concatenate([offset, height[valid][:, None]], axis=-1))
    return (
        ground_east,
        ground_north,
        height[valid].astype(np.float64),
        sigma[valid].astype(np.float64),
        truth.height[valid],
        bound[valid],
        truth.single[valid],
    )


def _truth(
    image: HeightImage, grid: Grid, aperture: Aperture, flight: SimulatedFlight, surface: VisibleSurface
) -> tuple[Truth, Array]:
    """True heights in the pixels of a height image, and the bound on estimating them."""
    sensor, track = flight.sensor, flight.preset.flight
    azimuth_cell = sensor.wavelength * track.slant_range_m / (2 * aperture.length)
    cell = sensor.range_resolution * azimuth_cell
    truth = truth_image(surface, aperture, grid, cell, sensor.beams)
    squint = column_squint(grid, aperture, sensor.beams, sensor.look_side)
    slope = np.full(grid.shape, track.slant_range_m * np.sin(track.look_angle_rad))
    looks = image.range_looks * image.azimuth_looks
    return truth, height_bound(truth, 10 ** (flight.preset.cnr_db / 10), looks, sensor.beams, squint, slope)
