"""Impulse response of a target in each image, as numbers and as a picture (`sal-height irf`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.io import check_new_folder, new_folder, or_null, write_text, writing
from sal_height.progress import Bar
from sal_height.response import CutResponse, ImpulseResponse, chip_around, measure_brightest, measure_windows
from sal_height.response.image import AXES, Image, image_name
from sal_height.runs.responses.images import images_of
from sal_height.runs.responses.pictures import DrawnTarget, draw_responses
from sal_height.tables import aligned, number_text

MOST_DRAWN = 4
"""Greatest number of targets in the picture: the first ones. More would make it unreadable."""

CUT = ("width_px", "width_m", "pslr_db", "islr_db")
"""Entries of a report on a cut through a response."""


def irf(
    paths: list[Path],
    out: Path,
    near: tuple[int, int] | None = None,
    dwell: int | None = None,
    channel: int | None = None,
    azimuth_axis: int = 1,
    jobs: int = 1,
) -> list[dict[str, Any]]:
    """Measure a target in each image and write irf.json and irf.png to `out`.

    Args:
        paths: .npy and .npz files and bags.
        out: folder; must be new or empty, which is checked before anything is measured.
        near: row and column of a pixel near the target; None for the brightest target of each image.
        dwell: measure only the images of this dwell; None for all.
        channel: measure only the images of this channel; None for all.
        azimuth_axis: along-track axis (0 or 1) of arrays in .npy and .npz files; in bags it is 1.
        jobs: dwells of a bag without images of which these are made side by side.

    Returns:
        The entries of irf.json, one per image: image, topic, dwell, channel; row, col (pixels), position_m (map);
        range and azimuth, each with width_px, width_m, pslr_db, islr_db; peak_over_median_db, entropy. A quantity that
        the image does not show is None.

    Raises:
        UserError: something cannot be read, measured or written, or there is nothing to measure.
    """
    check_new_folder(out)
    entries: list[dict[str, Any]] = []
    targets: list[DrawnTarget] = []
    images = (image for path in paths for image in images_of(path, dwell, channel, azimuth_axis, jobs))
    for image in Bar(images, desc="irf", unit=" image", delay=1, leave=False):
        try:
            response = measure_brightest(image.pixels, near)
        except UserError as error:
            raise UserError(f"Image {image.name}: {error}") from error
        entries.append(_entry(image, response))
        if len(targets) < MOST_DRAWN:
            chip = chip_around(image.pixels, round(response.row), round(response.col))
            targets.append(DrawnTarget(image.name, image.axes, chip, response))
    folder = new_folder(out)
    write_text(folder / "irf.json", json.dumps(entries, indent=2, allow_nan=False) + "\n")
    more = f" (the first {len(targets)} of {len(entries)} images)" if len(entries) > len(targets) else ""
    with writing(folder / "irf.png"):
        draw_responses(targets, f"Impulse responses{more}", folder / "irf.png")
    return entries


def response_table(entries: list[dict[str, Any]]) -> str:
    """Format the entries of irf.json as a table; a dash stands for a quantity that the image does not show."""
    heading = ["image", "row", "col"]
    for axis in AXES:
        heading += [f"{axis} px", "m", "PSLR dB", "ISLR dB"]
    rows = [[*heading, "peak dB", "entropy"]]
    for entry in entries:
        cuts = [entry[axis][key] for axis in AXES for key in CUT]
        numbers = [entry["row"], entry["col"], *cuts, entry["peak_over_median_db"], entry["entropy"]]
        name = image_name(entry["image"], entry["topic"], entry["dwell"], entry["channel"])
        rows.append([name, *(number_text(number, ".3f") for number in numbers)])
    lines = [aligned(rows)]
    coarse = sum(any((entry[axis]["width_px"] or 1) < 1 for axis in AXES) for entry in entries)
    if coarse:
        lines.append(
            f"{coarse} of {len(entries)} responses are narrower than a pixel: the image is sampled too coarsely for "
            "its bandwidth, so these figures cannot be trusted."
        )
    return "\n".join(lines)


def window_table() -> str:
    """Format a table of what each window costs and gains, measured on an ideal point response."""
    rows = [["window", "PSLR dB", "ISLR dB", "width bins", "broadening", "noise gain"]]
    for name, one in measure_windows().items():
        levels = [f"{one.response.pslr_db:.2f}", f"{one.response.islr_db:.2f}"]
        rows.append([name, *levels, *(f"{cost:.4f}" for cost in (one.response.width, one.broadening, one.noise_gain))])
    return aligned(rows)


def _entry(image: Image, response: ImpulseResponse) -> dict[str, Any]:
    """The entry of irf.json."""
    grid = image.grid
    spacings = (grid.row_spacing, grid.col_spacing) if grid else (np.nan, np.nan)
    cuts = dict(zip(image.axes, zip((response.row_cut, response.col_cut), spacings, strict=True), strict=True))
    return {
        "image": str(image.path),
        "topic": image.topic,
        "dwell": image.dwell,
        "channel": image.channel,
        "row": response.row,
        "col": response.col,
        "position_m": grid.points(response.row, response.col).tolist() if grid else None,
        **{axis: cut_entry(*cuts[axis]) for axis in AXES},
        "peak_over_median_db": or_null(response.peak_over_median_db),
        "entropy": response.entropy,
    }


def cut_entry(cut: CutResponse, spacing: float) -> dict[str, float | None]:
    """Entries of a report on a cut, by CUT, of an image with this pixel spacing (m)."""
    return {
        "width_px": or_null(cut.width),
        "width_m": or_null(cut.width * spacing),
        "pslr_db": or_null(cut.pslr_db),
        "islr_db": or_null(cut.islr_db),
    }
