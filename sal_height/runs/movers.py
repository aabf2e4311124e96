"""`sal-height movers`: what moves in the strips or dwells of a bag, with its place, height and radial velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagReader
from sal_height.errors import Rejected, UserError
from sal_height.geometry import sphere_coordinates
from sal_height.io import new_folder
from sal_height.movers import ALONE, DwellMovers, Looked, Mover, MoverSettings, check_sensor
from sal_height.pipeline import dwell_with_movers, movers
from sal_height.runs.campaign import Case, plan
from sal_height.runs.catalogue import NodeParameters
from sal_height.runs.recorded_dwells import COMPRESSION, MOST_DWELLS, Compressed, RecordedDwells, Work
from sal_height.runs.reporting import reporting
from sal_height.sensor import Sensor


@dataclass(frozen=True, eq=False)
class SeenMover:
    """A mover, and in which image it was seen.

    Attributes:
        dwell: number of the block that completed the image.
        stamp_ns: of its first pulse.
        mover: what was found.
    """

    dwell: int
    stamp_ns: int
    mover: Mover

    def summary(self) -> dict[str, Any]:
        """What the report says of it."""
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
    """What the report says of the velocity along the flight; nothing if nothing tells it."""
    if np.isnan(one.along_sigma):
        return {}
    return {"along_velocity_mps": one.along_velocity, "along_velocity_sigma_mps": one.along_sigma}


@dataclass(frozen=True, eq=False)
class FoundMovers:
    """What was found in a bag.

    Attributes:
        movers: in the order of time.
        candidates: number of pixels that were looked at.
        images: number of images.
        dwells: number of dwells in the bag.
        left_out: how many of them tell nothing.
        warnings: sentences on what could not be used, and on what is used in spite of them.
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
        if self.movers:
            place = f"{'east m':>11}{'north m':>11}{'height m':>10}{'+-':>7}"
            along = f"{'along m/s':>11}{'+-':>7}" if any(_along(seen.mover) for seen in self.movers) else ""
            lines.append(f"{'dwell':>6}{place}{'mm/s':>11}{'+-':>7}{'by walk m/s':>13}{'+-':>7}{along}")
        for seen in self.movers:
            one = seen.summary()
            place = f"{one['east_m']:11.3f}{one['north_m']:11.3f}{one['height_m']:10.3f}{one['height_sigma_m']:7.3f}"
            speed = f"{1e3 * one['radial_velocity_mps']:11.2f}{1e3 * one['radial_velocity_sigma_mps']:7.2f}"
            walk = f"{one['walk_velocity_mps']:13.2f}{one['walk_velocity_sigma_mps']:7.2f}"
            along = "".join(
                f"{value:{width}.2f}" for value, width in zip(_along(seen.mover).values(), (11, 7), strict=False)
            )
            lines.append(f"{seen.dwell:6d}{place}{speed}{walk}{along}")
        if not all(seen.mover.resolved for seen in self.movers):
            period = 1e3 * self.movers[0].mover.ambiguity
            lines.append(
                f"Velocities in mm/s that differ by multiples of {period:.4g} mm/s look the same; those by the walk "
                "through rows do not."
            )
        return "\n".join(lines)


def find_in_bag(
    bag: Path, out: Path, given: NodeParameters | None = None, wanted: Mapping[str, Any] | None = None
) -> FoundMovers:
    """Compress the strips or dwells of a bag and find what moves; leaves report.json in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        given: parameters of nodes that replace recorded ones.
        wanted: settings of the search by name.

    Raises:
        UserError: the bag cannot be used or has no image in which movers could be told, or a parameter or a setting is
            not allowed.
    """
    settings = MoverSettings(**(wanted or {}))
    scheme = plan(Case(bag, out, {}, given or {}, ("ml",)), MOST_DWELLS)
    with reporting(new_folder(out), {"bag": bag.name, "settings": settings.model_dump()}) as report:
        work = scheme.works[0]
        reader = NamespacedReader(work.bag, work.namespace)
        looking = _Looking(work, reader, settings, "cols" in (given or {}).get(COMPRESSION, {}))
        looking.read(reader, "images")
        told = looking.losses.told(len(work.dwells))
        warnings = [*scheme.warnings, *told]
        report |= {"dwells": len(work.dwells), **looking.losses.counts(), "warnings": warnings}
        if not looking.images:
            raise UserError(f"Bag {bag} has no image in which movers could be looked for. {' '.join(told)}".rstrip())
        candidates = sum(one.candidates for one in looking.images)
        if not candidates:
            warnings.append(
                f"No pixel is {settings.prominence_db:g} dB brighter than what is around it, so none was looked at; "
                "set prominence_db to less."
            )
        report |= {
            "images": len(looking.images),
            "candidates": candidates,
            "expected_false_alarms_at_most": settings.false_alarm_rate * candidates,
            "fastest_mps": min((one.fastest for one in looking.images), default=0.0),
            "ground_lag_rad": [list(one.ground_lag) for one in looking.images],
            "movers": [one.summary() for one in looking.seen],
        }
    return FoundMovers(looking.seen, candidates, len(looking.images), len(work.dwells), looking.losses.dwells, warnings)


class _Looking(RecordedDwells):
    """The strips or dwells of a bag, in which movers are looked for."""

    def __init__(self, work: Work, reader: BagReader, settings: MoverSettings, cols_given: bool) -> None:
        """Look with these settings; images of dwells have all Doppler frequencies, unless their columns are given.

        Raises:
            UserError: as its base; or a sensor of the bag cannot tell movers.
        """
        super().__init__(work, reader)
        for sensor in self.sensors.values():
            check_sensor(sensor)
        self._settings = settings
        self._cols_given = cols_given
        self._dwells = DwellMovers[Compressed](settings)
        self.images: list[Looked] = []
        self.seen: list[SeenMover] = []

    def compression_of(self, sensor: Sensor) -> Any:
        """Parameters of the compression: of dwells with a column for each Doppler frequency, as many as pulses."""
        parameters = super().compression_of(sensor)
        if sensor.mode != "spotlight" or self._cols_given:
            return parameters
        return parameters.changed(cols=sensor.pulse_count)

    def made(self, compressed: Compressed) -> None:
        """Look for movers in an image."""
        slc, sensor, calibration = compressed.slc, compressed.sensor, compressed.calibration
        try:
            if sensor.mode == "stripmap":
                self._take(compressed, movers(slc, sensor, self._settings, calibration))
                return
            seconds = 1e-9 * compressed.frames[0].stamp_ns
            dwell = dwell_with_movers(slc, seconds, sensor, self._settings, calibration)
        except UserError as error:
            self.losses.drop("movers", error)
            return
        self._tell(self._dwells.add(dwell, compressed))

    def end(self) -> None:
        """Process the dwells that are left, and tell what moves in the last ones."""
        super().end()
        self._tell(self._dwells.end())

    def _tell(self, found: Sequence[tuple[Compressed, Looked | None]]) -> None:
        """Take what was found in dwells."""
        for compressed, one in found:
            if one:
                self._take(compressed, one)
            else:
                self.losses.drop("movers", Rejected("no overlap", ALONE.format(compressed.frames[0].dwell)))

    def _take(self, compressed: Compressed, found: Looked) -> None:
        """Keep what was found in an image."""
        frame = compressed.frames[0]
        self.images.append(found)
        in_order = sorted(found.movers, key=lambda one: float(np.dot(one.position, compressed.slc.aperture.direction)))
        self.seen += [SeenMover(frame.dwell, frame.stamp_ns, one) for one in in_order]
