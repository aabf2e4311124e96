"""`sal-height movers`: movers in the strips or dwells of a bag, with their position, height and radial velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.described import sensors_of
from sal_height.engine.movers import MOVERS, ImageMovers, MoverDetection
from sal_height.engine.stage import DwellKey, Product
from sal_height.errors import UserError
from sal_height.geometry import sphere_coordinates
from sal_height.graph.catalogue import DETECTOR, NodeParameters, parameters_of
from sal_height.graph.plan import DwellChanges
from sal_height.graph.reporting import reporting
from sal_height.io import new_folder
from sal_height.movers import Mover, MoverSettings, check_sensor
from sal_height.runs.chain.chain_runs import COMPRESSION, BagRun, plan
from sal_height.runs.chain.replay_parameters import ReplayPlan
from sal_height.sensor import Sensor
from sal_height.tables import aligned, number_text

STAGES_OF_MOVERS = (COMPRESSION, DETECTOR)


@dataclass(frozen=True, eq=False)
class SeenMover:
    """A mover, and in which image it was seen.

    Attributes:
        dwell: number of the block that completed the image.
        stamp_ns: stamp of its first pulse, ns since the epoch.
        mover: estimates of the mover.
    """

    dwell: int
    stamp_ns: int
    mover: Mover

    def summary(self) -> dict[str, Any]:
        """Entries of the report on the mover."""
        east, north, height = (float(value) for value in sphere_coordinates(self.mover.position))
        one = self.mover
        return {
            "dwell": self.dwell,
            "stamp_ns": self.stamp_ns,
            "east_m": east,
            "north_m": north,
            "height_m": height,
            "covariance_m2": one.covariance.tolist(),
            "height_sigma_m": one.sigma,
            "radial_velocity_mps": one.radial_velocity,
            "radial_velocity_sigma_mps": one.velocity_sigma,
            "ambiguity_mps": one.ambiguity,
            "ambiguity_resolved": one.resolved,
            "walk_velocity_mps": one.walk_velocity,
            "walk_velocity_sigma_mps": one.walk_sigma,
            **_along(one),
            "found_by_walk": one.walks,
            "likelihood_ratio": one.likelihood_ratio,
            "cnr_db": one.cnr_db,
        }


def _along(one: Mover) -> dict[str, float]:
    """Entries of the report on the along-track velocity; empty if it cannot be estimated."""
    if np.isnan(one.along_sigma):
        return {}
    return {"along_velocity_mps": one.along_velocity, "along_velocity_sigma_mps": one.along_sigma}


@dataclass(frozen=True, eq=False)
class BagMovers:
    """Movers of a bag.

    Attributes:
        movers: movers in the order of time.
        candidates: number of pixels that were examined.
        images: number of images.
        dwells: number of dwells in the bag.
        left_out: number of dwells in which nothing could be searched.
        warnings: warnings on data that were not used, and on data used with reservations.
    """

    movers: Sequence[SeenMover]
    candidates: int
    images: int
    dwells: int
    left_out: int
    warnings: Sequence[str]

    def table(self) -> str:
        """A line for each mover."""
        looked = f"{self.candidates} bright pixels of {self.images} images were looked at"
        lines = [f"{len(self.movers)} movers; {looked}"]
        if self.left_out:
            lines[0] += f"; {self.left_out} of {self.dwells} dwells were left out"
        rows = [["dwell", "east m", "north m", "height m", "+-", "mm/s", "+-", "by walk m/s", "+-"]]
        with_along = any(_along(seen.mover) for seen in self.movers)
        rows[0] += ["along m/s", "+-"] if with_along else []
        for seen in self.movers:
            one = seen.summary()
            row = [f"{one[key]:.3f}" for key in ("east_m", "north_m", "height_m", "height_sigma_m")]
            row += [f"{1e3 * one[key]:.2f}" for key in ("radial_velocity_mps", "radial_velocity_sigma_mps")]
            row += [f"{one[key]:.2f}" for key in ("walk_velocity_mps", "walk_velocity_sigma_mps")]
            along = ("along_velocity_mps", "along_velocity_sigma_mps") if with_along else ()
            rows.append([str(seen.dwell), *row, *(number_text(one.get(key), ".2f") for key in along)])
        lines += [aligned(rows)] if self.movers else []
        if not all(seen.mover.resolved for seen in self.movers):
            period = 1e3 * self.movers[0].mover.ambiguity
            lines.append(
                f"Velocities in mm/s that differ by multiples of {period:.4g} mm/s look the same; those by the walk "
                "through rows do not."
            )
        return "\n".join(lines)


def find_in_bag(
    bag: Path,
    out: Path,
    given: NodeParameters | None = None,
    wanted: Mapping[str, Any] | None = None,
    jobs: int = 1,
) -> BagMovers:
    """Compress the strips or dwells of a bag and find what moves; leaves report.json in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        given: parameters of nodes that replace recorded ones.
        wanted: settings of the search by name.
        jobs: dwells that are processed side by side.

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
        run = BagRun(scheme, STAGES_OF_MOVERS, jobs=jobs, wanted=[MOVERS], settings={COMPRESSION: first, DETECTOR: own})
        items = (made.result.item for made in run.results("images") if isinstance(made.result, Product))
        found = [item for item in items if isinstance(item, ImageMovers)]
        looked, seen = [one.looked for one in found], [mover for one in found for mover in _seen(one)]
        dwells = len(scheme.frames)
        said = run.losses.described(dwells)
        warnings = [*scheme.warnings, *said]
        report |= {"dwells": dwells, **run.losses.counts(), "warnings": warnings}
        if not looked:
            raise UserError(f"Bag {bag} has no image in which movers could be looked for. {' '.join(said)}".rstrip())
        candidates = sum(one.candidates for one in looked)
        if not candidates:
            warnings.append(
                f"No pixel is {settings.prominence_db:g} dB brighter than what is around it, so none was looked at; "
                "set prominence_db to less."
            )
        report |= {
            "images": len(looked),
            "candidates": candidates,
            "expected_false_alarms_at_most": settings.false_alarm_rate * candidates,
            "fastest_mps": min((one.fastest for one in looked), default=0.0),
            "ground_lag_rad": [list(one.ground_lag) for one in looked],
            "movers": [one.summary() for one in seen],
        }
    return BagMovers(seen, candidates, len(looked), dwells, run.losses.dwells, warnings)


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


def _seen(found: ImageMovers) -> list[SeenMover]:
    """Movers of an image, in the order of the flight."""
    direction = found.images.slc.aperture.direction
    in_order = sorted(found.looked.movers, key=lambda one: float(np.dot(one.position, direction)))
    return [SeenMover(found.key.number, found.key.stamp_ns, one) for one in in_order]
