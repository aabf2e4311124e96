"""Complex point-spread function of a system from its images: numbers, arrays and a picture (`sal-height psf`)."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.io import check_new_folder, new_folder, or_null, write_text, writing
from sal_height.numeric import Complex, frequencies
from sal_height.progress import Bar
from sal_height.response import (
    LONG_CHIPS,
    NOISE_UNKNOWN,
    AxisSpread,
    Pointing,
    PsfReport,
    PsfSettings,
    ShapedNoise,
    report_on,
)
from sal_height.response.image import AXES, Image
from sal_height.runs.responses.images import images_of
from sal_height.runs.responses.irf import CUT, cut_entry
from sal_height.runs.responses.pictures import draw_psf
from sal_height.tables import aligned, number_text

Entry = dict[str, Any]

SAME_SPACING = 0.01
"""Relative difference allowed between the pixel spacings of images that are measured together."""


def psf(
    paths: list[Path],
    out: Path,
    chip: tuple[int, int] | None = None,
    dwell: int | None = None,
    channel: int | None = None,
    azimuth_axis: int = 1,
    settings: PsfSettings | None = None,
    noise_power: float | None = None,
    jobs: int = 1,
) -> list[Entry]:
    """Estimate the point-spread function of each channel from all its images; write psf.json, .npz and .png to `out`.

    With several channels, psf_N.npz and psf_N.png belong to channel N.

    Args:
        paths: .npy and .npz files and bags.
        out: folder; must be new or empty, which is checked before anything is measured.
        chip: rows (range) and columns (azimuth) around a target; None for 64 x 64, or what the smallest image allows.
        dwell: measure only the images of this dwell; None for all.
        channel: measure only the images of this channel; None for all.
        azimuth_axis: along-track axis (0 or 1) of arrays in .npy and .npz files; in bags it is 1.
        settings: criteria for pixels that are point targets and for tiles that are speckle; None for the defaults.
        noise_power: E|n|^2 of the receiver noise in a pixel of all images; None for what bags say.
        jobs: dwells of a bag without images of which these are made side by side.

    Returns:
        The entries of psf.json, one per channel. An undetermined part is None, with a reason in "undetermined".

    Raises:
        UserError: something cannot be read, pooled or written.
    """
    check_new_folder(out)
    groups: dict[int | None, list[Image]] = {}
    images = (image for path in paths for image in images_of(path, dwell, channel, azimuth_axis, jobs))
    for image in Bar(images, desc="psf: reading", unit="image", delay=1, leave=False):
        groups.setdefault(image.channel, []).append(image)
    settings = settings or PsfSettings()
    entries, reports = [], []
    for number, group in Bar(groups.items(), desc="psf", delay=1, leave=False):
        powers = [image.noise_power if noise_power is None else noise_power for image in group]
        known = [power for power in powers if power is not None]
        try:
            report = report_on(
                list(map(_upright, group)),
                chip,
                settings,
                known if len(known) == len(group) else None,
                _noise_shape(group),
            )
        except UserError as error:
            raise UserError(f"{_title(group)}: {error}") from error
        reports.append(report)
        entries.append(_entry(number, group, report, noise_known=len(known) == len(group)))
    folder = new_folder(out)
    write_text(folder / "psf.json", json.dumps(entries, indent=2, allow_nan=False) + "\n")
    for number, report, entry in zip(groups, reports, entries, strict=True):
        name = "psf" if len(groups) == 1 else f"psf_{number}"
        with writing(folder / f"{name}.npz"):
            np.savez(folder / f"{name}.npz", allow_pickle=False, **_arrays(report))
        reasons = list(entry["undetermined"].values())
        with writing(folder / f"{name}.png"):
            draw_psf(report, _title(groups[number]), reasons, folder / f"{name}.png")
    return entries


def determined(entries: list[Entry]) -> bool:
    """True if anything could be estimated from the images of any channel."""
    return any(entry[part] is not None for entry in entries for part in ("range", "speckle"))


def psf_table(entries: list[Entry]) -> str:
    """Format the entries of psf.json as a table; a dash stands for a quantity that could not be estimated."""
    return "\n\n".join("\n".join(_lines(entry)) for entry in entries)


def _upright(image: Image) -> Complex:
    """Pixels with range along axis 0."""
    return image.pixels if image.axes == AXES else image.pixels.T


def _noise_shape(group: list[Image]) -> ShapedNoise | None:
    """Shape of the receiver noise, if that of all images is known."""
    shapes = [image.noise_shape for image in group if image.noise_shape]
    return ShapedNoise.pooled(shapes) if len(shapes) == len(group) else None


def _title(group: list[Image]) -> str:
    more = f" and {len(group) - 1} more" if len(group) > 1 else ""
    return f"Image {group[0].name}{more}"


def _spacing(group: list[Image]) -> tuple[float, float]:
    """Pixel spacing in range and azimuth, m; NaN if unknown.

    Raises:
        UserError: the images have different spacings.
    """
    grids = [image.grid for image in group if image.grid]
    if len(grids) < len(group):
        return float("nan"), float("nan")
    both = np.array([(grid.row_spacing, grid.col_spacing) for grid in grids])
    if np.any(np.ptp(both, axis=0) > SAME_SPACING * both.min(axis=0)):
        low, high = both.min(axis=0), both.max(axis=0)
        raise UserError(
            f"{_title(group)} have pixels of {low[0]:g} to {high[0]:g} m in range and {low[1]:g} to {high[1]:g} m in "
            f"azimuth; images measured together must agree to {100 * SAME_SPACING:g} %. Select some with --dwell."
        )
    down, across = both.mean(axis=0)
    return float(down), float(across)


def _entry(number: int | None, group: list[Image], report: PsfReport, *, noise_known: bool) -> Entry:
    """The entry of psf.json."""
    spacing = _spacing(group)
    why = "Widths in metres need the pixel spacing, which an array file does not contain; measure a bag."
    no_metres = {} if np.isfinite(spacing).all() else {"metres": why}
    spread, transfer = report.spread, report.transfer
    verdicts = Counter(str(one) for survey in report.surveys for one in survey.verdicts.elements())
    measured = (spread.range, spread.azimuth) if spread else ()
    figures = {axis: _axis_entry(one, metres) for axis, one, metres in zip(AXES, measured, spacing, strict=False)}
    return {
        "channel": number,
        "images": [{"image": str(one.path), "topic": one.topic, "dwell": one.dwell} for one in group],
        "spacing_m": dict(zip(AXES, map(or_null, spacing), strict=True)),
        "chip": list(report.chip),
        "range": figures.get("range"),
        "azimuth": figures.get("azimuth"),
        "targets": _target_entries(group, report),
        "verdicts": verdicts,
        "disagreement": {axis: or_null(getattr(transfer, axis).disagreement) for axis in AXES} if transfer else None,
        "speckle": _speckle_entry(report, None if noise_known else NOISE_UNKNOWN),
        "pointing": _pointing_entries(report.pointing),
        "superposition": _linearity_entry(report),
        "undetermined": {**report.undetermined, **_missing_figures(figures, report), **no_metres},
    }


def _axis_entry(one: AxisSpread, spacing: float) -> Entry:
    return {
        **cut_entry(one.cut, spacing),
        "anomalous_sidelobes": [
            {
                "position_px": sidelobe.position,
                "position_m": or_null(sidelobe.position * spacing),
                "level_db": sidelobe.level_db,
                "significance": or_null(sidelobe.significance),
            }
            for sidelobe in one.sidelobes
        ],
    }


def _target_entries(group: list[Image], report: PsfReport) -> list[Entry]:
    """The accepted targets, at their rows and columns as the image has them in its file."""
    entries = []
    for index, (image, survey) in enumerate(zip(group, report.surveys, strict=True)):
        for target in survey.targets:
            row, col = (target.row, target.col) if image.axes == AXES else (target.col, target.row)
            place = image.grid.points(row, col).tolist() if image.grid else None
            over = 10 * float(np.log10(target.over_clutter))
            entries.append({"image": index, "row": row, "col": col, "position_m": place, "over_clutter_db": over})
    return entries


def _speckle_entry(report: PsfReport, remark: str | None) -> Entry | None:
    tiles, spectra = report.tiles, report.spectra
    if not tiles or not spectra:
        return None
    return {
        "tile": list(tiles.tile),
        "tiles": int(tiles.verdict.size),
        "verdicts": {reason: count for reason, count in tiles.counts().items() if count},
        "noise_floor": spectra.noise_floor,
        "nyquist_spur": spectra.range.spur,
        "remark": remark,
    }


def _pointing_entries(pointing: tuple[Pointing, ...]) -> list[Entry] | None:
    entries = [
        {"image": index, "azimuth_px": col, "displacement_cycles_per_px": displacement, "sigma": sigma}
        for index, one in enumerate(pointing)
        for col, displacement, sigma in zip(
            one.cols.tolist(), one.displacement.tolist(), one.sigma.tolist(), strict=True
        )
    ]
    return entries or None


def _linearity_entry(report: PsfReport) -> Entry | None:
    found, rows = report.linearity, report.linearity_rows
    if not found:
        return None
    cut = f"No target is isolated in a chip longer than {rows} rows, so echoes farther away are not included; "
    return {
        "p_value": found.p_value,
        "chi_square": found.chi_square,
        "freedom": found.freedom,
        "share": found.share,
        "chip_rows": rows,
        "remark": f"{cut}{LONG_CHIPS[0]} rows would include more." if rows < LONG_CHIPS[0] else None,
    }


def _missing_figures(figures: dict[str, Entry], report: PsfReport) -> dict[str, str]:
    """Remarks on each axis whose cut is too short, and one if a single target cannot show agreement."""
    reasons = {}
    for axis, length in zip(figures, report.chip, strict=False):
        missing = [name for name in ("width_px", "pslr_db", "islr_db") if figures[axis][name] is None]
        if missing:
            reasons[axis] = (
                f"A chip of {length} pixels in {axis} is too short for {', '.join(missing)}; it needs to be longer "
                "(--chip)."
            )
    if report.transfer and report.transfer.targets < 2:
        reasons["disagreement"] = "Agreement between targets needs at least two targets."
    return reasons


def _arrays(report: PsfReport) -> dict[str, npt.NDArray[Any]]:
    """The arrays of psf.npz: those that could be estimated."""
    rows, cols = report.chip
    arrays: dict[str, npt.NDArray[Any]] = {
        "range_frequency": frequencies(rows),
        "azimuth_frequency": frequencies(cols),
    }
    if report.transfer and report.spread:
        one = report.transfer
        arrays |= {
            "R": one.range.response,
            "R_sigma": one.range.sigma,
            "R_without_clutter": one.range.without_clutter(),
            "A": one.azimuth.response,
            "A_sigma": one.azimuth.sigma,
            "A_without_clutter": one.azimuth.without_clutter(),
            "psf": report.spread.pixels,
        }
    if report.spectra:
        for name, axis, count in (("R", report.spectra.range, rows), ("A", report.spectra.azimuth, cols)):
            arrays[f"speckle_{name}2"], arrays[f"speckle_{name}2_sigma"] = axis.unfolded(count)
    pointing = report.pointing
    if any(len(one.cols) for one in pointing):
        arrays["pointing_image"] = np.repeat(np.arange(len(pointing)), [len(one.cols) for one in pointing])
        arrays["pointing_azimuth_px"] = np.concatenate([one.cols for one in pointing])
        arrays["pointing"] = np.concatenate([one.displacement for one in pointing])
        arrays["pointing_sigma"] = np.concatenate([one.sigma for one in pointing])
    return arrays


def _lines(entry: Entry) -> list[str]:
    """Format one channel's entry."""
    first, count = entry["images"][0]["image"], len(entry["images"])
    channel = "" if entry["channel"] is None else f", channel {entry['channel']}"
    lines = [f"{first}{channel}{f', {count} images' if count > 1 else ''}"]
    if entry["range"]:
        rows = [[axis, *(number_text(entry[axis][key], ".3f") for key in CUT)] for axis in AXES]
        lines.append(aligned([["", "px", "m", "PSLR dB", "ISLR dB"], *rows]))
    for axis in AXES if entry["range"] else ():
        lines += [
            f"anomalous sidelobe in {axis} at {one['position_px']:+.1f} px, {number_text(one['position_m'], '.3f')} m: "
            f"{one['level_db']:.1f} dB, {number_text(one['significance'], '.1f')} standard errors"
            for one in entry[axis]["anomalous_sidelobes"]
        ]
    counted = ", ".join(f"{number} {verdict}" for verdict, number in entry["verdicts"].items())
    lines.append(f"candidates for point targets: {counted or 'none'}")
    return [*lines, *_speckle_lines(entry), *(f"not determined: {why}" for why in entry["undetermined"].values())]


def _speckle_lines(entry: Entry) -> list[str]:
    lines = []
    if entry["speckle"]:
        one = entry["speckle"]
        counted = ", ".join(f"{number} {verdict}" for verdict, number in one["verdicts"].items())
        lines.append(
            f"tiles of speckle: {counted}; noise floor {one['noise_floor']:.3g}, spur {one['nyquist_spur']:.2g} of "
            "the mean power"
        )
        lines += [one["remark"]] if one["remark"] else []
    if entry["pointing"]:
        places = [one["displacement_cycles_per_px"] for one in entry["pointing"]]
        sigma = float(np.median([one["sigma"] for one in entry["pointing"]]))
        lines.append(f"pointing: {min(places):+.4f} to {max(places):+.4f} cycles per pixel, each +- {sigma:.4f}")
    if entry["superposition"]:
        one = entry["superposition"]
        lines.append(
            f"superposition of targets and speckle: p = {one['p_value']:.3g} (chi-square {one['chi_square']:.1f} of "
            f"{one['freedom']}, chips of {one['chip_rows']} rows)"
        )
        lines += [one["remark"]] if one["remark"] else []
    return lines
