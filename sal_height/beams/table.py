"""Measured beams: tables of complex amplitudes over angles, their CSV files, and the patterns that they make."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from sal_height.beams.apertures import PatternFunction
from sal_height.beams.pattern import Pattern, first_null
from sal_height.beams.spline import Surface, Values, spline_surface
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

COLUMNS = ("detector", "elevation_beamwidths", "azimuth_beamwidths", "real", "imaginary")
"""Columns of a file of beam tables; the third may be absent."""

DEGREE = 3
"""Degree of the spline through a table."""

LEAST_NODES = DEGREE + 1
"""Least number of offsets along one axis of a table."""

EDGE = 1e-9
"""Beamwidths beyond a table that count as its edge: elevations in rad are rounded to about 1e-12 beamwidths."""

UNKNOWN_MAIN_LOBE = 1.0
"""Half-width of the main lobe in azimuth, beamwidths, of a table with a single azimuth: that of a square aperture."""


@dataclass(frozen=True)
class BeamTable:
    """The measured beam of one detector; the same content as sal_height_msgs/BeamTable.

    Attributes:
        elevation: offsets from the detector's boresight along the detector axis, rad, increasing.
        azimuth: offsets beside it, rad, increasing; a single one: the beam depends on elevation only.
        real: real part of the amplitude at every elevation and, within it, every azimuth. All detectors of a sensor
            share one unit, because they are compared with each other; CNRs keep their meaning if the greatest modulus
            is near 1.
        imaginary: imaginary part, as `real`.

    Raises:
        UserError: the angles are too few or do not increase, or the values are not finite, not as many as directions,
            or all zero.
    """

    elevation: tuple[float, ...]
    azimuth: tuple[float, ...]
    real: tuple[float, ...]
    imaginary: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("elevation", "azimuth"):
            angles = np.array(getattr(self, name), dtype=np.float64)
            few = angles.size < LEAST_NODES and not (name == "azimuth" and angles.size == 1)
            if few or not (np.all(np.isfinite(angles)) and np.all(np.diff(angles) > 0)):
                raise UserError(
                    f"A beam table has {angles.size} offsets in {name}; they must be {LEAST_NODES} or more"
                    f"{' (or one in azimuth)' if name == 'azimuth' else ''}, finite and increasing."
                )
        size = len(self.elevation) * len(self.azimuth)
        if not len(self.real) == len(self.imaginary) == size:
            raise UserError(
                f"A beam table has {len(self.real)} real and {len(self.imaginary)} imaginary parts; its "
                f"{len(self.elevation)} x {len(self.azimuth)} angles need {size} each."
            )
        values = self.values
        if not np.all(np.isfinite(values)) or not np.any(values):
            raise UserError("A beam table has amplitudes that are not finite, or all zero; all must be finite.")

    @property
    def values(self) -> C128:
        """Amplitudes, shape (elevations, azimuths)."""
        flat = np.array(self.real, dtype=np.float64) + 1j * np.array(self.imaginary, dtype=np.float64)
        return flat.reshape(len(self.elevation), len(self.azimuth))


Grid = dict[tuple[float, float], tuple[complex, int]]
"""Amplitude and line number in the file, by elevation and azimuth in beamwidths."""


def read_beam_tables(path: Path, beamwidth: float, azimuth_beamwidth: float | None = None) -> tuple[BeamTable, ...]:
    """Read measured beams from a CSV file with the columns COLUMNS, one row for every detector and direction.

    Detectors are counted from 0, and each has a grid of its own; rows may come in any order. Offsets are from the
    boresight of each detector, in beamwidths. Without azimuth_beamwidths all rows have azimuth 0.

    Args:
        path: of the file.
        beamwidth: wavelength / antenna diameter along the detector axis, rad.
        azimuth_beamwidth: the same beside the detector axis; None: as `beamwidth`.

    Returns:
        tuple[BeamTable, ...]: the beams of detectors 0, 1, ...

    Raises:
        UserError: the file cannot be read, a column is missing, a value is not a number, a direction is missing or
            given twice, a detector is missing, or BeamTable refuses a beam.
    """
    grids = _grids(path)
    if sorted(grids) != list(range(len(grids))):
        missing = min(set(range(len(grids))) - set(grids))
        raise UserError(f"{path} has beams of {len(grids)} detectors but none of detector {missing}; count from 0.")
    widths = beamwidth, azimuth_beamwidth or beamwidth
    return tuple(_table(path, detector, grids[detector], widths) for detector in range(len(grids)))


def _grids(path: Path) -> dict[int, Grid]:
    grids: dict[int, Grid] = defaultdict(dict)
    for line, row in _rows(path):
        detector, direction, amplitude = _numbers(path, line, row)
        if direction in grids[detector]:
            raise UserError(
                f"{path}, line {line}: elevation {direction[0]:g} and azimuth {direction[1]:g} of detector {detector} "
                f"are already in line {grids[detector][direction][1]}; give every direction once."
            )
        grids[detector][direction] = amplitude, line
    if not grids:
        raise UserError(f"{path} has no rows; at least one detector's beam is needed.")
    return grids


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Return the rows that are not empty, by column, with their line numbers."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header)
            lines = [(reader.line_num, row) for row in reader if row]
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path} is no CSV text; it must be a table with the columns {', '.join(COLUMNS)}.") from error
    for line, row in lines:
        if len(row) != len(header):
            raise UserError(f"{path}, line {line}: there are {len(row)} values; the header has {len(header)} columns.")
    return [(line, dict(zip(header, row, strict=True))) for line, row in lines]


def _check_header(path: Path, header: list[str]) -> None:
    needed = set(COLUMNS) - {"azimuth_beamwidths"}
    if not (needed <= set(header) <= set(COLUMNS) and len(set(header)) == len(header)):
        found = ", ".join(header)[:120] or "nothing"
        raise UserError(f"{path}, line 1: the columns are {found!r}; they must be {', '.join(COLUMNS)}, once each.")


def _numbers(path: Path, line: int, row: dict[str, str]) -> tuple[int, tuple[float, float], complex]:
    """Return detector, elevation and azimuth in beamwidths, and amplitude of a row."""
    values = {}
    for name in COLUMNS:
        text = row.get(name, "0").strip()
        try:
            values[name] = float(int(text)) if name == "detector" else float(text)
        except (ValueError, OverflowError):
            values[name] = np.nan
        least = 0.0 if name == "detector" else -np.inf
        if not (np.isfinite(values[name]) and values[name] >= least):
            allowed = "a whole number of 0 or more" if name == "detector" else "a finite number"
            raise UserError(f"{path}, line {line}: {name} is {text[:40]!r}; it must be {allowed}.")
    detector, elevation, azimuth, real, imaginary = values.values()
    return int(detector), (elevation, azimuth), complex(real, imaginary)


def _table(path: Path, detector: int, grid: Grid, beamwidths: tuple[float, float]) -> BeamTable:
    elevation, azimuth = (sorted(set(angles)) for angles in zip(*grid, strict=True))
    for direction in ((e, a) for e in elevation for a in azimuth):
        if direction not in grid:
            raise UserError(
                f"{path}: detector {detector} has no amplitude at elevation {direction[0]:g} and azimuth "
                f"{direction[1]:g}; its grid must be complete."
            )
    values = [grid[e, a][0] for e in elevation for a in azimuth]
    try:
        return BeamTable(
            tuple(e * beamwidths[0] for e in elevation),
            tuple(a * beamwidths[1] for a in azimuth),
            tuple(value.real for value in values),
            tuple(value.imag for value in values),
        )
    except UserError as error:
        raise UserError(f"{path}, detector {detector}: {str(error)[0].lower()}{str(error)[1:]}") from error


def tabulated_pattern(table: BeamTable, beamwidth: float, azimuth_beamwidth: float | None = None) -> Pattern:
    """Return the pattern that a table holds: the cubic spline through its amplitudes, and the spline's derivatives.

    With a single azimuth the pattern is the same at all azimuths. Beyond the table nothing is received: 0.

    Args:
        table: of one detector's beam.
        beamwidth: wavelength / antenna diameter along the detector axis, rad.
        azimuth_beamwidth: the same beside the detector axis; None: as `beamwidth`.

    Returns:
        Pattern: named "table", known where the table is; float64 where all amplitudes are real, otherwise complex128.
    """
    elevation, azimuth = (
        np.array(table.elevation) / beamwidth,
        np.array(table.azimuth) / (azimuth_beamwidth or beamwidth),
    )
    values = table.values if any(table.imaginary) else table.values.real
    domain = (float(elevation[0]), float(elevation[-1]))
    if azimuth.size == 1:
        surface, azimuths, main_lobe = _line(elevation, values[:, 0]), (-np.inf, np.inf), UNKNOWN_MAIN_LOBE
    else:
        surface, azimuths = spline_surface(elevation, azimuth, values, DEGREE), (float(azimuth[0]), float(azimuth[-1]))
        main_lobe = first_null(_within(domain, azimuths, surface, (0, 0)), max(map(abs, azimuths)))
    amplitude, slope, azimuth_slope = (
        _within(domain, azimuths, surface, orders) for orders in ((0, 0), (1, 0), (0, 1))
    )
    return Pattern("table", amplitude, slope, azimuth_slope, main_lobe, domain)


def _line(elevation: F64, values: Values) -> Surface:
    """Interpolate values over elevation alone."""
    spline = CubicSpline(elevation, values)
    return lambda e, _, orders: np.zeros_like(e, dtype=values.dtype) if orders[1] else spline(e, orders[0])


def _within(
    elevations: tuple[float, float], azimuths: tuple[float, float], surface: Surface, orders: tuple[int, int]
) -> PatternFunction:
    """Return a derivative of the spline as a function of all offsets (beamwidths): 0 beyond the table."""

    def values(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
        e, a = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64))
        scale = np.where(np.isnan(e + a), np.nan, 1.0)
        for offset, (low, high) in ((e, elevations), (a, azimuths)):
            scale[(offset < low - EDGE) | (offset > high + EDGE)] = 0.0
        nearest_e, nearest_a = np.clip(np.nan_to_num(e), *elevations), np.clip(np.nan_to_num(a), *azimuths)
        return scale * surface(nearest_e, nearest_a, orders)

    return values
