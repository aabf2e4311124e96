"""AFRL Gotcha phase history (MATLAB files) becomes a bag of one dwell, or of several that follow each other."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light
from scipy.io import loadmat

from sal_height.errors import UserError
from sal_height.imaging import UNKNOWN_AIR
from sal_height.imports.collection import Collection, write_collection
from sal_height.imports.followed_point import boresight_to, focusing, side_of, states_towards
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor

FIELDS = ("fp", "freq", "x", "y", "z", "r0")

SPEED = 100.0
"""Speed of flight (m/s) from which pulse times are made; the files have positions only."""

PLAUSIBLE = {"freq": (1e9, 1e11), "r0": (1e3, 1e6)}
"""Values of an airborne radar in Hz and m; others are of other units."""

PULSE_STEP = (0.5, 1.5)
"""Distance from the last pulse of a file to the first of the next, over the median distance between pulses."""


def import_gotcha(files: list[Path], out: Path, dwells: int = 1) -> int:
    """Write sensor info, odometry and phase history of files, in the order of flight, as dwells of a bag.

    The bag has the parameters that focus the scene.

    Args:
        files: files of one pass and polarisation, in any order.
        out: folder of the bag.
        dwells: number of dwells into which the pulses are split.

    Returns:
        The number of pulses of all dwells.

    Raises:
        UserError: an error of `read_gotcha`, or the bag cannot be written.
    """
    collection = read_gotcha(files, dwells)
    write_collection(collection, out)
    return dwells * collection.sensor.pulse_count


def read_gotcha(files: list[Path], dwells: int = 1) -> Collection:
    """Read sensor, track and phase history of files, in the order of flight, as dwells of the same number of pulses.

    Pulse times follow from the recorded antenna positions at constant SPEED; base_link is level and looks at the
    scene's centre, which is the map's origin. The parameters are those that focus the scene.

    Args:
        files: files of one pass and polarisation, in any order.
        dwells: number of dwells into which the pulses are split; remaining pulses are left out at the end.

    Raises:
        UserError: a file is not Gotcha phase history, or the files differ in frequency or polarisation, overlap or have
            a gap between them; or there are too few pulses for this number of dwells.
    """
    polarisation = _common_polarisation(files)
    parts = {path: _load(path) for path in files}
    frequency = parts[files[0]]["freq"].ravel()
    for path, part in parts.items():
        if part["freq"].size != frequency.size or not np.allclose(part["freq"].ravel(), frequency, rtol=1e-9):
            raise UserError(f"File {path} has other frequencies than {files[0]}; all must have the same.")
    ordered = _in_order_of_flight(files, parts)
    antenna: F64 = np.concatenate([_positions(part) for part in ordered])
    samples = np.concatenate([part["fp"].T for part in ordered]).astype(np.complex64)[None]
    steps = np.linalg.norm(np.diff(antenna, axis=0), axis=-1)
    times_ns = np.rint(np.concatenate([[0.0], np.cumsum(steps)]) / SPEED * 1e9).astype(np.int64)
    if not np.all(np.diff(times_ns) > 0):
        raise UserError("Two pulses were taken at the same antenna position; name each file once.")
    times: F64 = times_ns * np.float64(1e-9)
    velocity = np.asarray(np.gradient(antenna, times, axis=0), dtype=np.float64)
    reference = np.concatenate([part["r0"].ravel() for part in ordered])
    count = _pulses_of_a_dwell(len(antenna), dwells)
    sensor = _sensor(frequency, antenna, velocity, times, polarisation, count)
    histories = []
    for first in range(0, dwells * count, count):
        own = slice(first, first + count)
        since = (times_ns[own] - times_ns[first]) * np.float64(1e-9)
        histories.append(PhaseHistory(int(times_ns[first]), since, reference[own], samples[:, own]))
    states = states_towards(times_ns, antenna, velocity, np.zeros(3), sensor.look_side)
    middle = antenna[len(antenna) // 2]
    scene = 100.0  # side of the square of the scene that is imaged, m
    # Greatest pixel spacing of the image, m: of range cells of 0.34 m on the ground; 6 files or less resolve no
    # more.
    widest_spacing = 0.2
    image = focusing(sensor, antenna[:count], float(np.linalg.norm(middle)), scene, widest_spacing, UNKNOWN_AIR)
    return Collection(sensor, histories, states, parameters=image)


def _pulses_of_a_dwell(pulses: int, dwells: int) -> int:
    """The number of pulses of each dwell.

    Raises:
        UserError: there are too few pulses for this number of dwells, or no dwell is requested.
    """
    if not 1 <= dwells <= pulses // 2:
        raise UserError(
            f"The files have {pulses} pulses, which cannot be split into {dwells} dwells; allowed are 1 to "
            f"{pulses // 2} dwells."
        )
    return pulses // dwells


def _common_polarisation(files: list[Path]) -> str:
    """The polarisation in the names of files (HH, HV, VH or VV); empty: not in the names.

    Raises:
        UserError: the files differ in it, or a file is named twice.
    """
    for path in files:
        if files.count(path) > 1:
            raise UserError(f"File {path} is named twice; name each file once.")
    named = {path: match[1] if (match := re.search(r"_([HV]{2})$", path.stem)) else "" for path in files}
    for path, polarisation in named.items():
        if polarisation != named[files[0]]:
            raise UserError(
                f"File {path} has the polarisation {polarisation or 'of no name'}, {files[0]} "
                f"{named[files[0]] or 'of no name'}; all files must have the same."
            )
    return named[files[0]]


def _positions(part: dict[str, Any]) -> F64:
    """Antenna positions, m, shape (pulses, 3)."""
    return np.stack([part[axis].ravel() for axis in "xyz"], axis=-1)


def _in_order_of_flight(files: list[Path], parts: dict[Path, dict[str, Any]]) -> list[dict[str, Any]]:
    """The parts in the order in which they were flown on the circle around the scene.

    Raises:
        UserError: pulses are missing between two parts, or they overlap.
    """
    azimuth = {path: np.unwrap(np.arctan2(*_positions(parts[path])[:, 1::-1].T)) for path in files}
    turn = np.sign(azimuth[files[0]][-1] - azimuth[files[0]][0]) or 1.0
    middles = np.sort(np.mod([turn * azimuth[path].mean() for path in files], 2 * np.pi))
    # The flight begins behind the widest gap of the circle.
    begin = middles[np.argmax(np.diff(middles, prepend=middles[-1] - 2 * np.pi))]
    ordered = sorted(files, key=lambda path: np.mod(turn * azimuth[path].mean() - begin + 1e-9, 2 * np.pi))
    for path, following in pairwise(ordered):
        before, after = _positions(parts[path]), _positions(parts[following])
        usual = float(np.median(np.linalg.norm(np.diff(before, axis=0), axis=-1)))
        step = after[0] - before[-1]
        ahead = float(np.linalg.norm(step)) * float(np.sign(step @ (before[-1] - before[0])))
        if not PULSE_STEP[0] < ahead / usual < PULSE_STEP[1]:
            raise UserError(
                f"File {following} begins {ahead:.4g} m after the last pulse of {path}, which has one every "
                f"{usual:.4g} m; name consecutive files of one pass, without a gap and each once."
            )
    return [parts[path] for path in ordered]


def _load(path: Path) -> dict[str, Any]:
    """The FIELDS of a file.

    Raises:
        UserError: it does not have them, or their sizes or values cannot be those of phase history.
    """
    try:
        data = loadmat(path)["data"][0][0]
        is_complex = np.iscomplexobj(data["fp"])
        part = {name: np.asarray(data[name], dtype="c8" if name == "fp" else "f8") for name in FIELDS}
    except Exception as error:  # scipy, zlib and numpy each have their own for a damaged file
        raise UserError(
            f"File {path} is not AFRL Gotcha phase history; expected is a MATLAB file with data.{', .'.join(FIELDS)}."
        ) from error
    frequencies, pulses = part["freq"].size, part["x"].size
    if frequencies < 2 or pulses < 2:
        raise UserError(
            f"File {path} has {frequencies} frequencies and {pulses} antenna positions; 2 or more of each are needed."
        )
    if part["fp"].shape != (frequencies, pulses):
        raise UserError(f"File {path} has .fp of shape {part['fp'].shape}; it must be {(frequencies, pulses)}.")
    for name in ("y", "z", "r0"):
        if part[name].size != pulses:
            raise UserError(f"File {path} has {part[name].size} values of .{name}; they must be {pulses}, as of .x.")
    for name, values in part.items():
        if not np.all(np.isfinite(values)):
            raise UserError(f"File {path} has values of .{name} that are not finite; all must be finite numbers.")
    frequency = part["freq"].ravel()
    even, step = np.linspace(frequency[0], frequency[-1], frequencies, retstep=True)
    if not (frequency[0] > 0 and step > 0 and np.abs(frequency - even).max() <= 0.01 * step):
        raise UserError(f"File {path} has uneven .freq; it must rise from above 0 in equal steps, to 1 % of a step.")
    if not is_complex:
        raise UserError(f"File {path} has real samples .fp; phase history is complex.")
    _check_units(path, part)
    return part


def _check_units(path: Path, part: dict[str, Any]) -> None:
    """Make sure that frequencies are in Hz, distances in m, and r0 is the distance to the scene's centre.

    Raises:
        UserError: they are not.
    """
    for name, unit in (("freq", "Hz"), ("r0", "m")):
        low, high = PLAUSIBLE[name]
        if not (low <= part[name].min() and part[name].max() <= high):
            raise UserError(
                f"File {path} has .{name} from {part[name].min():.4g} to {part[name].max():.4g}; in {unit} it must be "
                f"between {low:g} and {high:g}."
            )
    off = float(np.abs(np.linalg.norm(_positions(part), axis=-1) - part["r0"].ravel()).max())
    tolerance = 0.01  # m: ten times the rounding of float32 at 10 km
    if off > tolerance:
        raise UserError(
            f"File {path} has .r0 up to {off:.4g} m off the distance of .x, .y, .z from the scene's centre; they must "
            f"agree to {tolerance:g} m."
        )


def _sensor(frequency: F64, antenna: F64, velocity: F64, times: F64, polarisation: str, pulses_of_dwell: int) -> Sensor:
    """One receiver with its boresight on the map's origin, seen from the middle of the track."""
    middle = len(antenna) // 2
    wavelength = speed_of_light / float(np.mean(frequency))
    # Beamwidth (rad) put into the sensor info; the files do not state the antenna. As wide as the pulses sample: 147 m.
    beamwidth = 0.0145
    return Sensor(
        name=f"afrl_gotcha_{polarisation}".rstrip("_"),
        look_side=side_of(antenna[middle], velocity[middle], np.zeros(3)),
        wavelength=wavelength,
        bandwidth=float(frequency[-1] - frequency[0]) * len(frequency) / (len(frequency) - 1),
        sample_count=len(frequency),
        pulse_count=pulses_of_dwell,
        pulse_repetition_frequency=(len(times) - 1) / float(times[-1]),
        elevation_diameter=wavelength / beamwidth,
        azimuth_diameter=wavelength / beamwidth,
        pattern="sinc",
        elevation_boresights=(boresight_to(antenna[middle], np.zeros(3)),),
        noise_power=(0.0,),
    )
