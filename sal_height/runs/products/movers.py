"""`sal-height movers`: movers in the strips or dwells of a bag, with their position, height and radial velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.described import sensors_of
from sal_height.engine.movers import ImageMovers, MoverDetection
from sal_height.engine.results import DwellKey, Product
from sal_height.errors import UserError
from sal_height.geometry import sphere_coordinates
from sal_height.graph.catalogue import DETECTOR, NodeParameters, parameters_of
from sal_height.graph.plan import DwellChanges
from sal_height.graph.reporting import reporting
from sal_height.io import new_folder
from sal_height.movers import Blind, Mover, MoverSettings, check_sensor
from sal_height.runs.chain.chain_runs import COMPRESSION, BagRun, plan
from sal_height.runs.chain.replay_parameters import ReplayPlan
from sal_height.sensor import Sensor
from sal_height.tables import aligned, counted, number_text

STAGES_OF_MOVERS = (COMPRESSION, DETECTOR)


def _entry(found: ImageMovers, mover: Mover) -> dict[str, Any]:
    """Entries of the report on a mover of an image, which the block of that dwell completed."""
    east, north, height = (float(value) for value in sphere_coordinates(mover.position))
    entry = {
        "dwell": found.key.number,
        "stamp_ns": found.key.stamp_ns,
        "east_m": east,
        "north_m": north,
        "height_m": height,
        "covariance_m2": mover.covariance.tolist(),
        "height_sigma_m": mover.sigma,
        "radial_velocity_mps": mover.radial_velocity,
        "radial_velocity_sigma_mps": mover.velocity_sigma,
        "ambiguity_mps": mover.ambiguity,
        "ambiguity_resolved": mover.resolved,
        "walk_velocity_mps": mover.walk_velocity,
        "walk_velocity_sigma_mps": mover.walk_sigma,
        "found_by_walk": mover.walks,
        "likelihood_ratio": mover.likelihood_ratio,
        "cnr_db": mover.cnr_db,
    }
    if not np.isnan(mover.along_sigma):
        entry |= {"along_velocity_mps": mover.along_velocity, "along_velocity_sigma_mps": mover.along_sigma}
    return entry


def _blind_entry(blind: Blind) -> dict[str, float]:
    """Entries of the report on the radial velocities that the lag does not show in strips."""
    return {"cnr_db": blind.cnr_db, "radial_velocity_sigma_mps": blind.sigma, "fraction": blind.fraction}


def movers_table(summary: Mapping[str, Any]) -> str:
    """The report as a table with a line for each mover."""
    movers = summary["movers"]
    seen = f"{summary['candidates']} bright pixels of {summary['images']} images were looked at"
    lines = [f"{counted(len(movers), 'mover')}; {seen}"]
    if summary["dwells_left_out"]:
        lines[0] += f"; {summary['dwells_left_out']} of {summary['dwells']} dwells were left out"
    rows = [["dwell", "east m", "north m", "height m", "+-", "mm/s", "+-", "migration m/s", "+-"]]
    is_along = any("along_velocity_mps" in one for one in movers)
    along = ("along_velocity_mps", "along_velocity_sigma_mps") if is_along else ()
    rows[0] += ["along m/s", "+-"] if along else []
    for one in movers:
        row = [f"{one[key]:.3f}" for key in ("east_m", "north_m", "height_m", "height_sigma_m")]
        row += [f"{1e3 * one[key]:.2f}" for key in ("radial_velocity_mps", "radial_velocity_sigma_mps")]
        row += [f"{one[key]:.2f}" for key in ("walk_velocity_mps", "walk_velocity_sigma_mps")]
        rows.append([str(one["dwell"]), *row, *(number_text(one.get(key), ".2f") for key in along)])
    lines += [aligned(rows)] if movers else []
    if not all(one["ambiguity_resolved"] for one in movers):
        lines.append(
            "Velocities in mm/s that differ by multiples of "
            f"{1e3 * movers[0]['ambiguity_mps']:.4g} mm/s look the same; those by range migration do not."
        )
    if summary["blind"]:
        blind = ", ".join(f"{100 * one['fraction']:.2g} % at {one['cnr_db']:g} dB" for one in summary["blind"])
        lines.append(
            f"Blind radial velocities, which look like the ground's unless range migration or smear show them: {blind}."
        )
    return "\n".join(lines)


def find_in_bag(
    bag: Path,
    out: Path,
    given: NodeParameters | None = None,
    wanted: Mapping[str, Any] | None = None,
    jobs: int = 1,
) -> tuple[dict[str, Any], list[str]]:
    """Compress the strips or dwells of a bag and find what moves; leaves report.json in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        given: parameters of nodes that replace recorded ones.
        wanted: settings of the search by name.
        jobs: dwells that are processed side by side.

    Returns:
        The numbers of the report, and warnings on data that were not used or used with reservations.

    Raises:
        UserError: the bag cannot be used or has no image in which movers could be found, or a parameter or a setting is
            not allowed.
    """
    settings = MoverSettings(**(wanted or {}))
    scheme = plan(bag, given or {}, ("ml",))
    with reporting(new_folder(out), {"bag": bag.name, "settings": settings.model_dump()}) as report:
        sensors, _ = sensors_of(scheme.reader)
        for sensor in sensors.values():
            check_sensor(sensor)
        first, scheme = _with_columns(scheme, sensors, given or {})
        own = MoverDetection.settings(**dict(settings))
        run = BagRun(scheme, STAGES_OF_MOVERS, jobs=jobs, settings={COMPRESSION: first, DETECTOR: own})
        items = (made.result.item for made in run.results("images") if isinstance(made.result, Product))
        found = [item for item in items if isinstance(item, ImageMovers)]
        looked = [one.looked for one in found]
        said = run.losses.described(len(scheme.frames))
        warnings = [*scheme.warnings, *said]
        summary: dict[str, Any] = {"dwells": len(scheme.frames), "dwells_left_out": run.losses.dwells}
        report.update({**summary, **run.losses.counts(), "warnings": warnings})
        if not looked:
            raise UserError(f"Bag {bag} has no image in which movers could be looked for. {' '.join(said)}".rstrip())
        candidates = sum(one.candidates for one in looked)
        if not candidates:
            warnings.append(
                f"No pixel is {settings.prominence_db:g} dB brighter than what is around it, so none was looked at; "
                "set prominence_db to less."
            )
        summary |= {
            "images": len(looked),
            "candidates": candidates,
            "expected_false_alarms_at_most": settings.false_alarm_rate * candidates,
            "fastest_mps": min((one.fastest for one in looked), default=0.0),
            "ground_lag_rad": [list(one.ground_lag) for one in looked],
            "blind": [_blind_entry(one) for one in looked[len(looked) // 2].blind],
            "movers": [_entry(one, mover) for one in found for mover in _in_order(one)],
        }
        report.update(summary)
    return summary, warnings


def _settings_for(scheme: ReplayPlan, sensors: Mapping[str, Sensor], given: NodeParameters, dwell: DwellKey) -> Any:
    """Settings of the compression: of spotlight a column for each Doppler frequency, as many as pulses."""
    settings = parameters_of(COMPRESSION, scheme.values.get(COMPRESSION, {}))
    sensor = sensors.get(dwell.sensor)
    if sensor is None or sensor.mode != "spotlight" or "cols" in given.get(COMPRESSION, {}):
        return settings
    return settings.changed(cols=sensor.pulse_count)


def _with_columns(scheme: ReplayPlan, sensors: Mapping[str, Sensor], given: NodeParameters) -> tuple[Any, ReplayPlan]:
    """Settings of the compression at the first dwell, and the scheme with those of dwells of other sensors."""
    dwells = sorted(scheme.frames, key=lambda dwell: scheme.frames[dwell].first_ns)
    first = _settings_for(scheme, sensors, given, dwells[0])
    changes = list(scheme.changes)
    for before, dwell in pairwise(dwells):
        if before.sensor != dwell.sensor:
            cols = _settings_for(scheme, sensors, given, dwell).cols
            changes.append(DwellChanges(dwell, {COMPRESSION: {"cols": cols}}))
    return first, replace(scheme, changes=tuple(changes))


def _in_order(found: ImageMovers) -> list[Mover]:
    """Movers of an image, in the order of the flight."""
    direction = found.images.slc.aperture.direction
    return sorted(found.looked.movers, key=lambda one: float(np.dot(one.position, direction)))
