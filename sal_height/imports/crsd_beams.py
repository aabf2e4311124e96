"""Channels of a CRSD file that are the beams of one antenna: their boresights and their patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from sal_height.beams import BeamTable
from sal_height.geometry import Origin
from sal_height.numeric import F64

FARTHEST = 0.5
"""Largest offset from the boresight at which a pattern is searched, rad."""

DIRECTIONS = 4001
"""Number of offsets at which the extent of a pattern is searched."""

NODES = 129
"""Number of offsets in the table of a beam."""

GRID = ("X0", "Y0", "XSS", "YSS")
"""Elements that state the first direction cosines of a pattern and the steps between them."""

QUANTITIES = ("Gain", "Phase")
"""Quantities in an array of gains (dB) and phases (cycles)."""


@dataclass(frozen=True, eq=False)
class Beam:
    """The beam of a channel.

    Attributes:
        channel: identifier of the channel.
        boresight: angle from nadir, rad.
        width: beamwidth between the angles of half the power, rad.
        table: table of the amplitude over elevation.
    """

    channel: str
    boresight: float
    width: float
    table: BeamTable


def beams_of(reader: Any, channels: Sequence[str], origin: Origin) -> list[Beam]:
    """The beams of channels, by increasing boresight; empty if the channels are not beams of one antenna.

    They are if they receive the same pulses at the same times and positions, with boresights at different elevations in
    their electrical steering (RcvEB) and real patterns that are known around them.

    Args:
        reader: sarkit's reader of the file.
        channels: identifiers of the channels.
        origin: origin of the map.
    """
    tree, vectors = reader.metadata.xmltree, {name: reader.read_pvps(name) for name in channels}
    described = {name: tree.find(f"{{*}}Channel/{{*}}Parameters[{{*}}Identifier='{name}']") for name in channels}
    if len(channels) < 2 or not all(_receive_together(vectors, described, name) for name in channels[1:]):
        return []
    beams = [_beam(reader, name, described[name], vectors[name], origin) for name in channels]
    found = sorted((beam for beam in beams if beam), key=lambda beam: beam.boresight)
    # Least difference of the boresights of two beams, rad; those of channels of one beam differ by rounding.
    least_pitch = 1e-4
    apart = all(second.boresight - first.boresight > least_pitch for first, second in pairwise(found))
    return found if len(found) == len(channels) and apart else []


def _receive_together(vectors: dict[str, Any], described: dict[str, Any], name: str) -> bool:
    """True if a channel receives the pulses of the first one, at the same times and positions, in the same band."""
    first = next(iter(vectors))
    same = ("RcvAPCId", "Fs", "SARImage/{*}TxId", *(f"RcvRefPoint/{{*}}ECF/{{*}}{axis}" for axis in "XYZ"))
    if any(described[name].findtext(f"{{*}}{path}") != described[first].findtext(f"{{*}}{path}") for path in same):
        return False
    return vectors[name].shape == vectors[first].shape and all(
        np.array_equal(vectors[name][key], vectors[first][key])
        for key in ("RcvStart", "RcvPos", "RefFreq", "SIGNAL", "TxPulseIndex")
    )


def _beam(reader: Any, name: str, described: Any, vectors: Any, origin: Origin) -> Beam | None:
    """The beam of a channel at its reference vector; None if its pattern has phases or does not fall by half."""
    vector = vectors[int(described.findtext("{*}RefVectorIndex"))]
    point = np.array([float(described.findtext(f"{{*}}RcvRefPoint/{{*}}ECF/{{*}}{axis}")) for axis in "XYZ"])
    x, y, steering = vector["RcvACX"], vector["RcvACY"], vector["RcvEB"]
    ahead = origin.axes @ np.array([x, y, np.cross(x, y)]).T @ [*steering, np.sqrt(1 - steering @ steering)]
    towards = origin.axes @ (point - vector["RcvPos"])
    towards[2] = 0.0
    towards /= np.linalg.norm(towards)
    boresight = float(np.arctan2(ahead @ towards, -ahead[2]))

    def pattern(offsets: F64) -> tuple[F64, F64]:
        angles = boresight + offsets
        directions = np.sin(angles)[:, None] * towards - np.cos(angles)[:, None] * np.array([0.0, 0.0, 1.0])
        cosines = directions @ origin.axes @ np.array([x, y]).T
        return _pattern(reader, described.findtext("{*}RcvAPATId"), cosines, steering)

    offsets = np.linspace(-FARTHEST, FARTHEST, DIRECTIONS)
    gain, phase = pattern(offsets)
    lowest_db = -40.0  # gain against that of the boresight below which a pattern ends
    lobe = _around_middle(gain >= lowest_db)
    half = offsets[_around_middle(gain >= -10 * np.log10(2))]
    if len(half) == DIRECTIONS or len(half) < 2 or np.any(np.abs(phase[lobe] - phase[DIRECTIONS // 2]) > 1e-3):
        return None
    nodes = np.linspace(offsets[lobe][0], offsets[lobe][-1], NODES)
    amplitude = 10 ** (pattern(nodes)[0] / 20)
    table = BeamTable(tuple(nodes.tolist()), (0.0,), tuple(amplitude.tolist()), (0.0,) * NODES)
    return Beam(name, boresight, float(half[-1] - half[0]), table)


def _pattern(reader: Any, identifier: str, cosines: F64, steering: F64) -> tuple[F64, F64]:
    """Gain (dB) and phase (cycles) of an antenna pattern at direction cosines, (n, 2); NaN where it is not known.

    The pattern of the array is one of the offsets from the electrical boresight, that of its elements one of direction.
    """
    antenna = f"{{*}}Antenna/{{*}}AntPattern[{{*}}Identifier='{identifier}']"
    parts = (("ArrayGPId", cosines - steering), ("ElemGPId", cosines))
    named = [(reader.metadata.xmltree.findtext(f"{antenna}/{{*}}{part}"), places) for part, places in parts]
    gain, phase = (sum(_stated(reader, name, quantity, places) for name, places in named) for quantity in QUANTITIES)
    return np.asarray(gain), np.asarray(phase)


def _stated(reader: Any, name: str, quantity: str, places: F64) -> F64:
    """A quantity of an array of gains and phases at positions in it, (n, 2); NaN beyond it."""
    from sarkit.crsd import interpolate_support_array  # noqa: PLC0415 (an extra)

    described = reader.metadata.xmltree.find(f"{{*}}SupportArray/{{*}}GainPhaseArray[{{*}}Identifier='{name}']")
    first_x, first_y, step_x, step_y = (float(described.findtext(f"{{*}}{key}")) for key in GRID)
    values = reader.read_support_array(name, masked=False)[quantity].astype(np.float64)
    x, y = places[:, 0], places[:, 1]
    return np.asarray(interpolate_support_array(x, y, first_x, first_y, step_x, step_y, values)[0])


def _around_middle(holds: Any) -> slice:
    """The contiguous indices around the middle one where a condition is true."""
    middle, misses = len(holds) // 2, np.flatnonzero(~holds)
    before, after = misses[misses < middle], misses[misses >= middle]
    return slice(int(before[-1]) + 1 if before.size else 0, int(after[0]) if after.size else len(holds))
