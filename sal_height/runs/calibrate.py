"""`sal-height calibrate`: estimate a sensor's calibration from a recorded bag."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.reader import BagReader
from sal_height.beams import ZERNIKE
from sal_height.calibration import Calibration, load_calibration
from sal_height.errors import UserError
from sal_height.io import new_folder, or_null, writing
from sal_height.nodes.played import SENSOR
from sal_height.nodes.psf_calibration import MOST_DWELLS
from sal_height.runs.calibration_picture import beam_width, draw_calibration
from sal_height.runs.catalogue import CALIBRATOR, NodeParameters
from sal_height.runs.conductor import DEFAULT, Execution, Outcome, Plan, perform
from sal_height.runs.entry import air_in, check_air, contents
from sal_height.runs.recorded_parameters import recorded_at_start
from sal_height.runs.reporting import PARAMETERS, conclude, merged, reporting

STAGES = ["sar_compression", CALIBRATOR]

CALIBRATION = "calibration.npz"
"""File of the calibration in the folder of a run."""


def calibrate(
    bag: Path, out: Path, parameters: NodeParameters, execution: Execution = DEFAULT
) -> tuple[Outcome, Calibration | None]:
    """Calibrate a sensor on the scene of a bag; leaves calibration.npz, its picture and report.json in `out`.

    The images are formed with the recorded parameters, except that they cover the whole range window, are not weighted
    in range and have no calibration applied.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        parameters: values that replace recorded parameters of nodes.
        execution: how the run is carried out.

    Returns:
        What the run did, and the calibration; None if the run was interrupted.

    Raises:
        UserError: the bag cannot be used, or too much of it was dropped for a calibration.
    """
    reader = BagReader(bag)
    sensor, dwells = contents(reader)
    unweighted = {"sar_compression": {"range_window": "rectangular", "rows": 0, "calibration": ""}}
    wanted = {CALIBRATOR: {"dwells": min(dwells, MOST_DWELLS), "dwell_step": 1, "file": str(out / CALIBRATION)}}
    recorded = recorded_at_start(reader, nodes=STAGES)
    own = {name: recorded.values.get(name, {}) for name in STAGES}
    values = recorded.check(merged(merged(own, unweighted), wanted), parameters, STAGES)
    air = air_in(reader)
    check_air(values, [sensor], air, f"Bag {bag}")
    folder = new_folder(out)
    made, played = folder / "bag", [*SENSOR, *air]
    with reporting(folder, {"bag": bag.name}) as report:
        nodes = {**values, "player": {"bag": str(bag), "topics": played}}
        topics = ["sensor_info", "calibration", "diagnostics"]
        custom_data = {PARAMETERS: json.dumps(values)}
        outcome = perform(Plan("player", STAGES, topics, made, nodes, dwells, custom_data, played), execution)
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
    """The calibration as a table; a dash stands for what was not measured."""
    summary = _summary(calibration)
    keys = ("gain_db", "gain_sigma_db", "phase_rad", "phase_sigma_rad", "ripple_db", "ripple_sigma_db")
    heading = f"{'channel':>8}{'gain dB':>10}{'+-':>7}{'phase deg':>11}{'+-':>7}{'ripple dB rms':>15}{'+-':>7}"
    lines = [
        f"{channel:8d}{gain:10.3f}{_sigma(of_gain, 3)}{np.degrees(phase):11.2f}"
        f"{_sigma(of_phase and np.degrees(of_phase), 2)}{ripple:15.3f}{_sigma(of_ripple, 3)}"
        for channel, (gain, of_gain, phase, of_phase, ripple, of_ripple) in enumerate(
            zip(*(summary[key] for key in keys), strict=True)
        )
    ]
    width = f"beam width over that described: {beam_width(calibration)}"
    return "\n".join([heading, *lines, width, f"calibration {calibration.id}"])


def _sigma(value: float | None, digits: int) -> str:
    """A standard error in seven columns."""
    return f"{'-':>7}" if value is None else f"{value:7.{digits}f}"


def _summary(calibration: Calibration) -> dict[str, Any]:
    gain = calibration.response.mean(axis=1)
    ripple = np.abs(calibration.response / gain[:, None] - 1)
    decibels = 20 / np.log(10)
    return {
        "id": calibration.id,
        "config_hash": calibration.config_hash,
        "dwells": calibration.dwells,
        "gain_db": (decibels * np.log(np.abs(gain))).tolist(),
        "phase_rad": np.angle(gain).tolist(),
        "ripple_db": (decibels * np.sqrt(np.mean(ripple**2, axis=1))).tolist(),
        "ripple_sigma_db": [or_null(sigma) for sigma in decibels * calibration.response_sigma],
        "gain_sigma_db": [or_null(sigma) for sigma in decibels * calibration.gain_sigma],
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
