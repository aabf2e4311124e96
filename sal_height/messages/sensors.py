"""The sensor's description."""

from __future__ import annotations

import dataclasses

from builtin_interfaces.msg import Time
from sal_height_msgs import msg as messages
from std_msgs.msg import Header

from sal_height.beams import BeamTable
from sal_height.errors import UserError
from sal_height.messages.basics import (
    BODY_FRAME,
)
from sal_height.sensor import Sensor


def sensor_to_message(sensor: Sensor, stamp: Time) -> messages.SensorInfo:
    """SensorInfo of a sensor."""
    return messages.SensorInfo(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        name=sensor.name,
        config_hash=sensor.config_hash,
        calibration_id=sensor.calibration_id,
        look_side=sensor.look_side,
        mode=sensor.mode,
        waveform=sensor.waveform,
        chirp_rate=sensor.chirp_rate,
        pulse_duration=sensor.pulse_duration,
        sampling_rate=sensor.sampling_rate,
        wavelength=sensor.wavelength,
        bandwidth=sensor.bandwidth,
        sample_count=sensor.sample_count,
        pulse_count=sensor.pulse_count,
        pulse_repetition_frequency=sensor.pulse_repetition_frequency,
        aperture=sensor.aperture,
        pattern=sensor.pattern,
        detector_size=list(sensor.detector_size),
        detector_rotation=sensor.detector_rotation,
        beam_tables=[messages.BeamTable(**dataclasses.asdict(table)) for table in sensor.beam_tables],
        elevation_boresights=list(sensor.elevation_boresights),
        noise_power=list(sensor.noise_power),
        channel_matrix_real=[entry.real for row in sensor.channel_matrix for entry in row],
        channel_matrix_imaginary=[entry.imag for row in sensor.channel_matrix for entry in row],
        matrix_in_antenna=sensor.matrix_in_antenna,
        full_scale=sensor.full_scale,
    )


def sensor_from_message(message: messages.SensorInfo) -> Sensor:
    """The sensor a SensorInfo describes.

    Raises:
        UserError: a value out of its range, or no config_hash.
    """
    if not message.config_hash:
        raise UserError(f"SensorInfo {message.name!r} has no config_hash; frames and products need one to refer to.")
    return Sensor(
        name=message.name,
        look_side=int(message.look_side),
        mode=message.mode,
        waveform=message.waveform,
        chirp_rate=message.chirp_rate,
        pulse_duration=message.pulse_duration,
        sampling_rate=message.sampling_rate,
        wavelength=message.wavelength,
        bandwidth=message.bandwidth,
        sample_count=message.sample_count,
        pulse_count=message.pulse_count,
        pulse_repetition_frequency=message.pulse_repetition_frequency,
        aperture=message.aperture,
        pattern=message.pattern,
        detector_size=(float(message.detector_size[0]), float(message.detector_size[1])),
        detector_rotation=message.detector_rotation,
        beam_tables=tuple(
            BeamTable(tuple(table.elevation), tuple(table.azimuth), tuple(table.real), tuple(table.imaginary))
            for table in message.beam_tables
        ),
        elevation_boresights=tuple(message.elevation_boresights),
        noise_power=tuple(message.noise_power),
        channel_matrix=_matrix_from_message(message),
        matrix_in_antenna=message.matrix_in_antenna,
        full_scale=message.full_scale,
        calibration_id=message.calibration_id,
        config_hash=message.config_hash,
    )


def _matrix_from_message(message: messages.SensorInfo) -> tuple[tuple[complex, ...], ...]:
    real, imaginary = message.channel_matrix_real, message.channel_matrix_imaginary
    if len(real) != len(imaginary):
        raise UserError(
            f"SensorInfo {message.name!r} has {len(real)} entries of channel_matrix_real and {len(imaginary)} of "
            "channel_matrix_imaginary; there must be as many."
        )
    entries = [complex(*parts) for parts in zip(real, imaginary, strict=True)]
    width = max(1, len(message.elevation_boresights))
    return tuple(tuple(entries[first : first + width]) for first in range(0, len(entries), width))
