"""The phase history of one channel and dwell, as a frame has it: checks, samples, and the history of all channels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sal_height.engine.provenance import Same
from sal_height.engine.results import DwellKey
from sal_height.errors import Rejected
from sal_height.numeric import C64, F32, F64, U8
from sal_height.sensor import PhaseHistory, Sensor

LONGEST_DWELL = 3600.0
"""Greatest time from the stamp of a frame to its last pulse, s."""

GREATEST_RANGE = 1e8
"""Greatest reference range of a frame, m."""

GREATEST_SCALE = 1e30
"""Greatest scale of integer samples, with which all of them are within single precision."""

COMPLEX_FLOAT32, COMPLEX_INT16 = "complex_float32", "complex_int16"

SAMPLE_BYTES = {COMPLEX_FLOAT32: 8, COMPLEX_INT16: 4}
"""Bytes per complex sample by encoding."""

_FLOAT32 = np.dtype("<f4")

Fault: TypeAlias = tuple[str, str]
"""Reason for which an item is rejected, and the message without the item that it is about."""


class Frame(NamedTuple):
    """Samples of one channel in one dwell.

    Attributes:
        key: sensor, number and stamp of the dwell.
        frame_id: name of the sensor's frame of coordinates.
        channel: number of the channel.
        pulse_count: number of pulses.
        sample_count: samples in each pulse.
        pulse_time: time of every pulse after the stamp, s, shape (pulses,); never changed.
        reference_range: range to which each pulse's phase refers, m, shape (pulses,); never changed.
        encoding: name of the encoding, one of SAMPLE_BYTES.
        scale: unit of the receiver per integer step.
        samples: bytes of the samples, in the encoding.
        size: size of the message, bytes.
    """

    key: DwellKey
    frame_id: str
    channel: int
    pulse_count: int
    sample_count: int
    pulse_time: F64
    reference_range: F64
    encoding: str
    scale: float
    samples: U8
    size: int = 0

    @property
    def end_ns(self) -> int:
        """Time of the last pulse, ns."""
        return self.key.stamp_ns + round(float(self.pulse_time[-1]) * 1e9)

    def blank(self, channel: int) -> Frame:
        """A frame of zeros for a channel that is missing: estimators leave such a channel out as dead."""
        return self._replace(channel=channel, samples=np.zeros_like(self.samples))


def frames_of(history: PhaseHistory, sensor: Sensor, dwell: int, stamp_ns: int | None = None) -> list[Frame]:
    """The frames of all channels of a dwell, with samples encoded as "complex_float32".

    Args:
        history: phase history of all channels.
        sensor: sensor that recorded it.
        dwell: number of the dwell.
        stamp_ns: time of the first pulse, ns; None: that of the history.
    """
    key = DwellKey(sensor.config_hash, dwell, history.stamp_ns if stamp_ns is None else stamp_ns)
    return [
        Frame(
            key,
            sensor.mounting.frame_id,
            channel,
            samples.shape[0],
            samples.shape[1],
            history.pulse_times,
            history.reference_range,
            COMPLEX_FLOAT32,
            0.0,
            np.ascontiguousarray(samples, dtype="<c8").reshape(-1).view(np.uint8),
            samples.nbytes,
        )
        for channel, samples in enumerate(history.samples)
    ]


def check_frame(frame: Frame, sensor: Sensor) -> None:
    """Check that a frame has the sizes that its sensor states, and values that can be processed.

    Raises:
        Rejected: it has not; the message names the field, its value and what is allowed.
    """
    if fault := _fault_of_frame(frame, sensor):
        raise Rejected(fault[0], f"ChannelFrame of dwell {frame.key.number}, channel {frame.channel}: {fault[1]}")


def _fault_of_frame(frame: Frame, sensor: Sensor) -> Fault | None:
    """Fault of a frame of a sensor, if it has one."""
    pulses, samples = sensor.pulse_count, sensor.sample_count
    if fault := fault_of_channel(frame.channel, sensor):
        return fault
    if (frame.pulse_count, frame.sample_count) != (pulses, samples):
        sizes = f"{frame.pulse_count} pulses of {frame.sample_count} samples; SensorInfo states {pulses} of {samples}"
        return "contradicts sensor info", f"the frame has {sizes}."
    if frame.encoding not in SAMPLE_BYTES:
        return "unknown encoding", f"encoding is {frame.encoding!r}; allowed are {', '.join(SAMPLE_BYTES)}."
    size = SAMPLE_BYTES[frame.encoding] * pulses * samples
    if fault := (
        _fault_of_size("samples", frame.samples, size)
        or _fault_of_size("pulse_time", frame.pulse_time, pulses)
        or _fault_of_size("reference_range", frame.reference_range, pulses)
    ):
        return fault
    return _fault_of_samples(frame) or _fault_of_pulses(Same(frame.pulse_time), Same(frame.reference_range))


def _fault_of_samples(frame: Frame) -> Fault | None:
    """Fault of the values of a frame's samples, if they have one."""
    if frame.encoding == COMPLEX_INT16 and not 0 < frame.scale <= GREATEST_SCALE:
        return "wrong scale", f"scale is {frame.scale}; it must be greater than 0 and at most {GREATEST_SCALE:g}."
    if frame.encoding == COMPLEX_FLOAT32 and not _are_finite(frame.samples.view(_FLOAT32)):
        return "not finite", "samples has NaN or infinite entries; all must be finite."
    return None


def _fault_of_size(field: str, values: F64 | U8, count: int) -> Fault | None:
    """Fault of the values of a field that must be so many, if they are not."""
    return None if len(values) == count else ("wrong size", f"{field} has {len(values)} entries; it must have {count}.")


def fault_of_channel(channel: int, sensor: Sensor) -> Fault | None:
    """Fault of the number of a channel that the sensor does not have."""
    if 0 <= channel < sensor.detector_count:
        return None
    return "unknown channel", f"SensorInfo has channels 0 to {sensor.detector_count - 1}."


def samples_of(frame: Frame) -> C64:
    """The samples of a frame in the unit of the receiver, complex64, shape (pulses, samples).

    Of "complex_float32" they are a view, of "complex_int16" a copy multiplied by the scale.
    """
    shape = frame.pulse_count, frame.sample_count
    if frame.encoding == COMPLEX_FLOAT32:
        return np.frombuffer(frame.samples, "<c8").reshape(shape)
    scaled = np.frombuffer(frame.samples, "<i2") * np.float32(frame.scale)
    return scaled.view(np.complex64).reshape(shape)


def history_of(frames: Sequence[Frame], samples: C64 | None = None) -> PhaseHistory:
    """The phase history of a dwell from the frames of all channels, in order, that `check_frame` has passed.

    Args:
        frames: frames of all channels.
        samples: samples of all channels, shape (channels, pulses, samples); None: they are copied from the frames.

    Raises:
        Rejected: the channels differ in pulse times or reference ranges.
    """
    first = frames[0]
    for frame in frames[1:]:
        if not (
            _are_same(frame.pulse_time, first.pulse_time) and _are_same(frame.reference_range, first.reference_range)
        ):
            raise Rejected(
                "channels disagree",
                f"Dwell {first.key.number}: channel {frame.channel} has other pulse times or reference ranges than "
                f"channel {first.channel}; those of all channels must be equal.",
            )
    return PhaseHistory(
        stamp_ns=first.key.stamp_ns,
        pulse_times=np.array(first.pulse_time),
        reference_range=np.array(first.reference_range),
        samples=stacked_samples(frames) if samples is None else samples,
    )


def stacked_samples(frames: Sequence[Frame], into: C64 | None = None) -> C64:
    """The samples of all channels, complex64, shape (channels, pulses, samples).

    Args:
        frames: frames of all channels, in order.
        into: array to be filled; None: a new one.
    """
    return np.stack([samples_of(frame) for frame in frames], out=into)


def samples_in_line(frames: Sequence[Frame]) -> C64 | None:
    """The samples of all channels, where they lie one after the other in memory, as the host of workers puts them.

    Returns:
        A view, complex64, shape (channels, pulses, samples), that is as the frames only as long as their memory is not
        used again; None: they lie elsewhere, or are encoded as integers.
    """
    first = frames[0]
    start, size = address_of(first.samples), first.samples.nbytes
    for place, frame in enumerate(frames):
        in_line = address_of(frame.samples) == start + place * size and frame.samples.nbytes == size
        if not in_line or frame.encoding != COMPLEX_FLOAT32:
            return None
    whole = np.lib.stride_tricks.as_strided(first.samples, (len(frames) * size,), writeable=False)
    return whole.view("<c8").reshape(len(frames), first.pulse_count, first.sample_count)


def address_of(array: np.ndarray[Any, Any]) -> int:
    """Address of the first byte of an array."""
    return int(array.__array_interface__["data"][0])


def _are_same(one: F64, other: F64) -> bool:
    """True if two arrays have the same bytes."""
    return one is other or one.tobytes() == other.tobytes()


def _are_finite(numbers: F32) -> bool:
    """True if all numbers are finite, as they are if the sum of their squares is, which takes less time to find."""
    return math.isfinite(np.vdot(numbers, numbers)) or bool(np.isfinite(numbers).all())


@functools.lru_cache(maxsize=2)
def _fault_of_pulses(pulse_time: Same[F64], reference_range: Same[F64]) -> Fault | None:
    """Fault of the times and ranges of a dwell's pulses, which all its frames share, if they have one."""
    times, ranges = pulse_time.one, reference_range.one
    for field, numbers in (("pulse_time", times), ("reference_range", ranges)):
        if not np.isfinite(numbers).all():
            return "not finite", f"{field} has NaN or infinite entries; all must be finite."
    if (times[1:] < times[:-1]).any() or times[0] < 0 or not times[0] < times[-1] <= LONGEST_DWELL:
        return (
            "wrong pulse times",
            (
                f"pulse_time runs from {times[0]:g} to {times[-1]:g} s; it must not decrease, must not be constant, "
                f"and must lie between 0 and {LONGEST_DWELL:g} s."
            ),
        )
    if not (ranges.min() > 0 and ranges.max() <= GREATEST_RANGE):
        return (
            "wrong reference range",
            (
                f"reference_range runs from {ranges.min():g} to {ranges.max():g} m; it must be greater than 0 and at "
                f"most {GREATEST_RANGE:g} m."
            ),
        )
    return None
