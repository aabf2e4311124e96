"""`sal-height calibrate`: estimate a sensor's calibration from a recorded bag."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.beams import ZERNIKE
from sal_height.calibration import Calibration, load_calibration
from sal_height.engine.calibrator import MOST_DWELLS
from sal_height.errors import UserError
from sal_height.graph.catalogue import CALIBRATOR, NodeParameters, check_parameters
from sal_height.graph.plan import DEFAULT, Execution, Outcome, Plan
from sal_height.graph.reporting import PARAMETERS, conclude, merged, reporting
from sal_height.io import new_folder, or_null, writing
from sal_height.runs.chain.chain_runs import COMPRESSION, plan
from sal_height.runs.chain.entry import Part, contents
from sal_height.runs.products.pictures import beam_width, draw_calibration
from sal_height.runs.replay.by_calls import perform_by_calls
from sal_height.topics import LOSSES, SENSOR_INFO

STAGES = ["sar_compression", CALIBRATOR]

CALIBRATION = "calibration.npz"
"""File of the calibration in the folder of a run."""


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
    values = {name: scheme.parameters.get(name, {}) for name in STAGES}
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
            [SENSOR_INFO, *scheme.topics],
        )
        outcome = perform_by_calls(asked, scheme, execution, jobs)
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
