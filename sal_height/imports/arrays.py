"""Arrays of anybody's sensor, with its description in YAML, become a bag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.array_files import named_arrays
from sal_height.errors import UserError
from sal_height.geometry import Altitudes, Origin
from sal_height.imports.assumed_attitudes import with_assumed_attitudes
from sal_height.imports.collection import Collection, Description, read_description, write_collection
from sal_height.imports.track import PlatformTrack, read_recorded_track, read_track
from sal_height.sensor import PhaseHistory

NEEDED = ("samples", "pulse_times", "reference_range")
BAGS = (".mcap", ".db3")
OF_TRACK = ("times", "positions", "velocities", "attitudes")


def import_arrays(description: Path, data: Path, out: Path, track: Path | None = None) -> int:
    """Write a bag from a file of arrays and the description of the sensor; returns the number of dwells.

    Args:
        description: YAML file of the sensor.
        data: .npz, .mat or .h5 file of arrays; names and shapes are in `collection_of`.
        out: folder of the bag, new or empty.
        track: track of the platform, a CSV or SBET file or a bag; None: it is among the arrays.

    Raises:
        UserError: a file cannot be read, parts are missing or do not fit each other, or the bag cannot be written.
    """
    described, arrays = read_description(description), named_arrays(data)
    flown = _read_track(track, described.place, described.altitudes) if track else None
    collection = collection_of(described, arrays, flown)
    write_collection(collection, out)
    return len(collection.histories)


def _read_track(path: Path, origin: Origin | None, altitudes: Altitudes) -> PlatformTrack:
    """The track in a bag or in another file.

    Raises:
        UserError: it cannot be read, or has no track.
    """
    is_bag = path.is_dir() or path.suffix.lower() in BAGS
    return read_recorded_track(path, origin, altitudes) if is_bag else read_track(path, origin, altitudes)


def collection_of(
    description: Description, arrays: Mapping[str, Any], track: PlatformTrack | None = None
) -> Collection:
    """The collection of arrays.

    Args:
        description: description of the sensor.
        arrays: samples, complex, of the shape (dwells, channels, pulses, samples), where dwells, or dwells and
            channels, may be left out if there is one; pulse_times, s, (dwells, pulses) or (pulses,); reference_range,
            m, of the same shape, or one number; and, without a track: times, s, (n,), positions, m, (n, 3), and
            maybe velocities, m/s, (n, 3), and attitudes (x, y, z, w), (n, 4), as in `PlatformTrack`. All times count
            from the same start, which is start_ns, ns since 1970, if it is present.
        track: track of the platform; None: it is among the arrays.

    Raises:
        UserError: arrays are missing, or do not fit each other or the description.
    """
    if missing := [name for name in NEEDED if name not in arrays]:
        raise UserError(f"The arrays lack {', '.join(missing)}; there are {', '.join(sorted(arrays))}.")
    samples = np.asarray(arrays["samples"])
    if not np.iscomplexobj(samples) or not 2 <= samples.ndim <= 4:
        raise UserError(
            f"Array samples has the type {samples.dtype} and the shape {samples.shape}; it must be complex, of dwells, "
            "channels, pulses and samples."
        )
    four = samples.reshape((1,) * (4 - samples.ndim) + samples.shape)
    samples = np.ascontiguousarray(four, dtype=np.complex64)
    shape = samples.shape[0], samples.shape[2]
    times, ranges = (_per_pulse(name, arrays[name], shape) for name in NEEDED[1:])
    start_ns = int(np.ravel(arrays["start_ns"])[0]) if "start_ns" in arrays else 0
    intervals = np.diff(times, axis=1)
    if shape[1] < 2 or not np.all(np.isfinite(times)) or not intervals.mean() > 0:
        raise UserError(
            "Array pulse_times must have two or more pulses in each dwell, with finite times that increase."
        )
    sensor = description.sensor(shape[1], samples.shape[3], float(1 / intervals.mean()))
    histories = [
        PhaseHistory(start_ns + round(float(first) * 1e9), here - first, reference, of_dwell)
        for first, here, reference, of_dwell in zip(times[:, 0], times, ranges, samples, strict=True)
    ]
    if track is None:
        if missing := [name for name in OF_TRACK[:2] if name not in arrays]:
            raise UserError(
                f"The arrays lack {', '.join(missing)} of the track; add them, or give a file of the track."
            )
        seconds, positions, velocities, attitudes = (
            np.asarray(arrays[name], dtype=np.float64) if name in arrays else None for name in OF_TRACK
        )
        track = PlatformTrack(np.ravel(seconds), positions, velocities, attitudes)  # type: ignore[arg-type]  # looked for above
    states = track.states(start_ns)
    collection = Collection(sensor, histories, states, description.place, description.processing)
    if track.attitudes is not None:
        return collection
    collection.check()
    return replace(collection, states=with_assumed_attitudes(states, histories, sensor, description))


def _per_pulse(name: str, values: Any, shape: tuple[int, int]) -> Any:
    """Values of each pulse of each dwell.

    Raises:
        UserError: their number does not fit.
    """
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.size == 1:
        numbers = numbers.ravel()[0]
    elif numbers.size == shape[1]:
        numbers = numbers.ravel()
    try:
        return np.broadcast_to(numbers, shape)
    except ValueError as error:
        raise UserError(
            f"Array {name} has the shape {numbers.shape}; it must be {shape} (dwells and pulses), or {shape[1:]}."
        ) from error
