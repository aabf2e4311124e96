"""Beam tables as a measurement would give them, and files of them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sal_height.beams import BeamTable, Pattern
from sal_height.beams.table_files import COLUMNS


def sample_pattern(pattern: Pattern, elevation: npt.ArrayLike, azimuth: npt.ArrayLike, beamwidth: float) -> BeamTable:
    """Tabulate a pattern at offsets from boresight in rad, increasing; `beamwidth` in rad."""
    x, y = np.atleast_1d(elevation), np.atleast_1d(azimuth)
    values = pattern.amplitude(x[:, None] / beamwidth, y / beamwidth)
    real, imaginary = values.real.ravel(), values.imag.ravel()
    return BeamTable(tuple(x.tolist()), tuple(y.tolist()), tuple(real.tolist()), tuple(imaginary.tolist()))


def write_beam_tables(path: Path, tables: Sequence[BeamTable], beamwidth: float) -> None:
    """Write what `read_beam_tables` reads; `beamwidth` in rad."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for detector, table in enumerate(tables):
            angles = [(e / beamwidth, a / beamwidth) for e in table.elevation for a in table.azimuth]
            parts = zip(angles, table.real, table.imaginary, strict=True)
            writer.writerows((detector, e, a, real, imaginary) for (e, a), real, imaginary in parts)
