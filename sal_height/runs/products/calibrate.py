"""`sal-height calibrate`: estimate a sensor's calibration from a recorded bag."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sal_height.beams import ZERNIKE
from sal_height.calibration import Calibration, load_calibration
from sal_height.engine.calibrator import MOST_DWELLS
from sal_height.errors import UserError
from sal_height.graph.catalogue import CALIBRATOR, NodeParameters, check_parameters
from sal_height.graph.plan import DEFAULT, Execution, Outcome, Plan
from sal_height.graph.reporting import PARAMETERS, conclude, merged, reporting
from sal_height.io import new_folder, or_null, writing
from sal_height.numeric import C128, F64, Bool
from sal_height.picture import page
from sal_height.runs.chain.chain_runs import COMPRESSION, TAKEN, plan, run_of
from sal_height.runs.chain.entry import Part, contents
from sal_height.runs.chain.recording import perform_by_calls
from sal_height.tables import aligned, number_text
from sal_height.topics import LOSSES, SENSOR_INFO

STAGES = ["sar_compression", CALIBRATOR]

CALIBRATION = "calibration.npz"
"""File of the calibration in the folder of a run."""

DECIBELS = 20 / np.log(10)
"""Decibels of a change of ln amplitude by 1."""

SIGNIFICANT = 2.0
"""Standard errors from the described value beyond which a value is marked as a finding."""

STYLES = ("-", "--", "-.", ":")


def calibrate(
    bag: Path, out: Path, parameters: NodeParameters, execution: Execution = DEFAULT, jobs: int = 1
) -> tuple[Outcome, Calibration | None]:
    """Calibrate a sensor on the scene of a bag; leaves calibration.npz, its picture, a bag and report.json in `out`.

    The images are formed with the recorded parameters, except that they cover the whole range window, are not weighted
    in range and have no calibration applied.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        parameters: values that replace recorded parameters of nodes.
        execution: execution of the run, and topics to record in addition to the calibration.
        jobs: dwells that are compressed side by side.

    Returns:
        The report, and the calibration; None if the user has interrupted.

    Raises:
        UserError: the bag cannot be used, or too many dwells of it were dropped for a calibration.
    """
    sensor, dwells = contents(Part().open(bag))
    unweighted = {COMPRESSION: {"range_window": "rectangular", "rows": 0, "calibration": ""}}
    wanted = {CALIBRATOR: {"dwells": min(dwells, MOST_DWELLS), "dwell_step": 1, "file": str(out / CALIBRATION)}}
    check_parameters(parameters, STAGES)
    scheme = plan(bag, merged(merged(unweighted, wanted), parameters), for_heights=False)
    values = {name: scheme.values.get(name, {}) for name in STAGES}
    folder = new_folder(out)
    with reporting(folder, {"bag": bag.name, "warnings": scheme.warnings}) as report:
        asked = Plan(
            "player",
            STAGES,
            ["sensor_info", "calibration", LOSSES],
            folder / "bag",
            values,
            len(scheme.frames),
            {PARAMETERS: json.dumps(values)},
            [SENSOR_INFO, *TAKEN],
        )
        outcome = perform_by_calls(asked, execution, run_of(asked, scheme, jobs))
        conclude(outcome, values, report)
        path = Path(values[CALIBRATOR]["file"])
        if outcome.interrupted:
            return outcome, None
        if not path.is_file():
            raise UserError(
                f"The {dwells} dwells of {bag} gave no calibration; {folder}/report.json says what was dropped and why."
            )
        calibration = load_calibration(path)
        report["calibration"] = _summary(calibration)
    with writing(folder / "calibration.png"):
        draw_calibration(calibration, sensor.name, folder / "calibration.png")
    return outcome, calibration


def calibration_table(calibration: Calibration) -> str:
    """The calibration as a table; a dash stands for a value that was not measured."""
    summary = _summary(calibration)
    rows = [["channel", "gain dB", "+-", "phase deg", "+-", "ripple dB rms", "+-"]]
    for channel in range(len(summary["gain_db"])):
        row = [str(channel)]
        for name, unit, digits in (("gain", "db", 3), ("phase", "rad", 2), ("ripple", "db", 3)):
            for key in (f"{name}_{unit}", f"{name}_sigma_{unit}"):
                scale = np.degrees(1.0) if unit == "rad" else 1.0
                row.append(number_text(summary[key][channel], f".{digits}f", scale))
        rows.append(row)
    width = f"beam width over that described: {beam_width(calibration)}"
    return "\n".join([aligned(rows), width, f"calibration {calibration.id}"])


def _summary(calibration: Calibration) -> dict[str, Any]:
    gain = calibration.response.mean(axis=1)
    ripple = np.abs(calibration.response / gain[:, None] - 1)
    return {
        "id": calibration.id,
        "config_hash": calibration.config_hash,
        "dwells": calibration.dwells,
        "gain_db": (DECIBELS * np.log(np.abs(gain))).tolist(),
        "phase_rad": np.angle(gain).tolist(),
        "ripple_db": (DECIBELS * np.sqrt(np.mean(ripple**2, axis=1))).tolist(),
        "ripple_sigma_db": [or_null(sigma) for sigma in DECIBELS * calibration.response_sigma],
        "gain_sigma_db": [or_null(sigma) for sigma in DECIBELS * calibration.gain_sigma],
        "phase_sigma_rad": [or_null(sigma) for sigma in calibration.phase_sigma],
        "width_factor": calibration.width_factor,
        "width_sigma": or_null(calibration.width_sigma),
        "pupil": {
            "waves_rms": dict(zip(ZERNIKE, calibration.pupil.tolist(), strict=True)),
            "sigma": dict(zip(ZERNIKE, calibration.pupil_sigma.tolist(), strict=True)),
            "misfit": calibration.pupil_misfit,
            "p_value": calibration.pupil_p_value,
        }
        if calibration.pupil.size
        else None,
    }


def draw_calibration(calibration: Calibration, sensor: str, path: Path) -> None:
    """Write a PNG: gain and phase of each channel over those described, and the shapes over the band that differ.

    Shapes over the band that are within their standard errors are not drawn; without any other there is no such panel.
    """
    gain = calibration.response.mean(axis=1)
    shapes = calibration.response / gain[:, None]
    found = beyond_error(shapes, calibration.response_sigma)
    with page(path, 5.2 if found.any() else 2.6) as figure:
        panels = figure.subplots(2 if found.any() else 1, 2, squeeze=False)
        level, turn = DECIBELS * np.log(np.abs(gain)), np.degrees(np.angle(gain))
        _draw_gains(panels[0, 0], level, DECIBELS * calibration.gain_sigma, "gain over that described (dB)")
        _draw_gains(panels[0, 1], turn, np.degrees(calibration.phase_sigma), "phase over that described (°)")
        if found.any():
            _draw_shapes(panels[1], shapes, calibration.response_sigma, found)
        figure.suptitle(
            f"{sensor}: receivers, from {calibration.dwells} dwells; beam width over that described: "
            f"{beam_width(calibration)}\n{_said_of_shapes(found, calibration.response_sigma)}"
        )


def beam_width(calibration: Calibration) -> str:
    """Width of the beams relative to the description, with its standard error, as text."""
    if not np.isfinite(calibration.width_sigma):
        return "not determined"
    return f"{calibration.width_factor:.4f} +- {calibration.width_sigma:.4f}"


def beyond_error(shapes: C128, sigma: F64) -> Bool:
    """True for channels whose responses differ from a flat one by more than their standard error, rms over the band.

    Args:
        shapes: responses over their own means, shape (channels, frequencies).
        sigma: standard error of a frequency, shape (channels,); NaN: not measured, which is no finding.
    """
    return np.sqrt(np.mean(np.abs(shapes - 1) ** 2, axis=1)) > np.nan_to_num(sigma, nan=np.inf)


def _draw_gains(axes: Axes, value: F64, sigma: F64, label: str) -> None:
    """Draw a number of each channel with its error bar, filled where it differs from that described."""
    channel = np.arange(len(value))
    with np.errstate(invalid="ignore"):
        differs = np.abs(value) > SIGNIFICANT * sigma
    axes.axhline(0, color="0.5", lw=0.6)
    bars = np.nan_to_num(sigma)
    how: dict[str, Any] = {"fmt": "o", "color": "#0072b2", "elinewidth": 0.8, "capsize": 1.5}
    if differs.any():
        axes.errorbar(channel[differs], value[differs], bars[differs], label=f"beyond {SIGNIFICANT:g} sigma", **how)
    if not differs.all():
        axes.errorbar(
            channel[~differs], value[~differs], bars[~differs], mfc="w", label=f"within {SIGNIFICANT:g} sigma", **how
        )
    axes.set(xlabel="channel", ylabel=label)
    axes.grid()
    axes.legend()


def _draw_shapes(panels: Sequence[Axes], shapes: C128, sigma: F64, found: Bool) -> None:
    """Draw amplitude and phase over the band of the channels found to differ, each with its standard error."""
    place = (np.arange(shapes.shape[1]) - (shapes.shape[1] - 1) / 2) / shapes.shape[1]
    for number, channel in enumerate(np.flatnonzero(found)):
        # One part of the complex error: half of its power.
        error = sigma[channel] / np.sqrt(2)
        level, turn = DECIBELS * np.log(np.maximum(np.abs(shapes[channel]), 1e-6)), np.angle(shapes[channel])
        for axes, value, band in ((panels[0], level, DECIBELS * error), (panels[1], turn, error)):
            (line,) = axes.plot(place, value, ls=STYLES[number % len(STYLES)], label=str(channel))
            axes.fill_between(place, value - band, value + band, color=line.get_color(), alpha=0.25, lw=0)
    panels[0].set_ylabel("amplitude over its mean (dB)")
    panels[1].set_ylabel("phase over its mean (rad)")
    for axes in panels:
        axes.set_xlabel("fast-time frequency (bandwidths from the carrier)")
        axes.grid()
    panels[0].legend(title="channel, band: 1 sigma", ncols=4)


def _said_of_shapes(found: Bool, sigma: F64) -> str:
    """Note on the channels whose responses are flat."""
    if not np.isfinite(sigma).any():
        return "how receivers differ over the band was not determined"
    error = f"{DECIBELS * np.nanmedian(sigma) / np.sqrt(2):.2g} dB"
    if not found.any():
        return f"over the band all channels are flat within their standard error of {error}"
    return f"over the band {np.count_nonzero(found)} of {len(found)} channels differ by more than their standard error"
