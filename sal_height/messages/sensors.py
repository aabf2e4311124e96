"""Conversion of the description of a sensor, and of its calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import numpy.typing as npt

from sal_height.beams import BeamTable
from sal_height.calibration import Calibration
from sal_height.engine.frames import BODY_FRAME
from sal_height.errors import UserError
from sal_height.geometry import Mounting
from sal_height.messages.basics import complex_pairs, from_complex_pairs
from sal_height.messages.types import BeamModel, ChannelModel, Header, Quaternion, SensorInfo, Time, Vector3, Waveform
from sal_height.messages.types import BeamTable as TableMessage
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import Mounting as MountingMessage
from sal_height.messages.types import SensorUncertainty as UncertaintyMessage
from sal_height.sensor import Sensor, SensorUncertainty


def sensor_to_message(sensor: Sensor, stamp: Time) -> SensorInfo:
    """Return the SensorInfo that describes a sensor."""
    x, y, z = sensor.mounting.lever_arm
    return SensorInfo(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        contract_version=SensorInfo.CONTRACT_VERSION,
        name=sensor.name,
        config_hash=sensor.config_hash,
        calibration_id=sensor.calibration_id,
        look_side=sensor.look_side,
        mode=sensor.mode,
        pulse_count=sensor.pulse_count,
        pulse_repetition_frequency=sensor.pulse_repetition_frequency,
        waveform=Waveform(
            kind=sensor.waveform,
            wavelength=sensor.wavelength,
            bandwidth=sensor.bandwidth,
            sample_count=sensor.sample_count,
            chirp_rate=sensor.chirp_rate,
            pulse_duration=sensor.pulse_duration,
            sampling_rate=sensor.sampling_rate,
        ),
        beams=BeamModel(
            elevation_diameter=sensor.elevation_diameter,
            azimuth_diameter=sensor.azimuth_diameter,
            pattern=sensor.pattern,
            elevation_boresights=list(sensor.elevation_boresights),
            detector_size=list(sensor.detector_size),
            detector_rotation=sensor.detector_rotation,
            tables=[
                TableMessage(elevation=table.elevation, azimuth=table.azimuth, amplitude=complex_pairs(table.values))
                for table in sensor.beam_tables
            ],
        ),
        channels=ChannelModel(
            matrix=complex_pairs(np.array(sensor.channel_matrix, dtype=np.complex128)),
            matrix_in_antenna=sensor.matrix_in_antenna,
            noise_power=list(sensor.noise_power),
            full_scale=sensor.full_scale,
            blanked_channels=[channel for channel, *_ in sensor.blanked_ranges],
            blanked_ranges=[edge for _, *edges in sensor.blanked_ranges for edge in edges],
        ),
        beam_uncertainty=sensor.beam_uncertainty,
        mounting=MountingMessage(
            frame_id=sensor.mounting.frame_id,
            lever_arm=Vector3(x=x, y=y, z=z),
            lever_arm_covariance=list(sensor.mounting.lever_arm_covariance or ()),
            rotation=Quaternion(**dict(zip("xyzw", sensor.mounting.rotation, strict=True))),
            rotation_covariance=list(sensor.mounting.rotation_covariance or ()),
        ),
        uncertainty=UncertaintyMessage(
            **{name: [] if value is None else [value] for name, value in vars(sensor.uncertainty).items()}
        ),
    )


def sensor_from_message(message: SensorInfo) -> Sensor:
    """Return the sensor that a SensorInfo describes.

    Raises:
        UserError: the message has another contract_version, no config_hash, or a value out of its range.
    """
    if message.contract_version != SensorInfo.CONTRACT_VERSION:
        raise UserError(
            f"SensorInfo {message.name!r} has contract_version {message.contract_version}; this version of sal_height "
            f"reads {SensorInfo.CONTRACT_VERSION}."
        )
    if not message.config_hash:
        raise UserError(
            f"SensorInfo {message.name!r} has no config_hash; it must have one, to which frames and products refer."
        )
    waveform, beams, channels = message.waveform, message.beams, message.channels
    return Sensor(
        name=message.name,
        look_side=int(message.look_side),
        mode=message.mode,
        waveform=waveform.kind,
        chirp_rate=waveform.chirp_rate,
        pulse_duration=waveform.pulse_duration,
        sampling_rate=waveform.sampling_rate,
        wavelength=waveform.wavelength,
        bandwidth=waveform.bandwidth,
        sample_count=waveform.sample_count,
        pulse_count=message.pulse_count,
        pulse_repetition_frequency=message.pulse_repetition_frequency,
        elevation_diameter=beams.elevation_diameter,
        azimuth_diameter=beams.azimuth_diameter,
        pattern=beams.pattern,
        detector_size=(float(beams.detector_size[0]), float(beams.detector_size[1])),
        detector_rotation=beams.detector_rotation,
        beam_tables=tuple(_table_from_message(table) for table in beams.tables),
        elevation_boresights=_numbers(beams.elevation_boresights),
        noise_power=_numbers(channels.noise_power),
        channel_matrix=_matrix_from_message(message),
        matrix_in_antenna=channels.matrix_in_antenna,
        full_scale=channels.full_scale,
        mounting=_mounting_from_message(message.mounting),
        beam_uncertainty=message.beam_uncertainty,
        uncertainty=SensorUncertainty(
            **{one.name: _one_or_none(getattr(message.uncertainty, one.name)) for one in fields(SensorUncertainty)}
        ),
        blanked_ranges=_blanked_ranges_from_message(message),
        calibration_id=message.calibration_id,
        config_hash=message.config_hash,
    )


def _numbers(values: npt.ArrayLike) -> tuple[float, ...]:
    """Numbers of a list as floats of Python, whose texts distinguish sensors."""
    return tuple(np.asarray(values, np.float64).tolist())


def _one_or_none(values: npt.ArrayLike) -> float | None:
    """The number of a list of one; None: the list is empty."""
    numbers = _numbers(values)
    return numbers[0] if numbers else None


def _table_from_message(table: TableMessage) -> BeamTable:
    values = from_complex_pairs(table.amplitude, "BeamTable.amplitude")
    return BeamTable(
        _numbers(table.elevation), _numbers(table.azimuth), tuple(values.real.tolist()), tuple(values.imag.tolist())
    )


def _matrix_from_message(message: SensorInfo) -> tuple[tuple[complex, ...], ...]:
    entries = from_complex_pairs(message.channels.matrix, f"SensorInfo {message.name!r}: channels.matrix").tolist()
    width = max(1, len(message.beams.elevation_boresights))
    return tuple(tuple(entries[first : first + width]) for first in range(0, len(entries), width))


def _blanked_ranges_from_message(message: SensorInfo) -> tuple[tuple[int, float, float], ...]:
    channels, edges = message.channels.blanked_channels, _numbers(message.channels.blanked_ranges)
    if len(edges) != 2 * len(channels):
        raise UserError(
            f"SensorInfo {message.name!r} has {len(edges)} channels.blanked_ranges for {len(channels)} "
            "channels.blanked_channels; there must be two ranges, the first and the last, for each of them."
        )
    return tuple(zip(map(int, channels), edges[::2], edges[1::2], strict=True))


def _mounting_from_message(message: MountingMessage) -> Mounting:
    arm, turn = message.lever_arm, message.rotation
    return Mounting(
        message.frame_id,
        (arm.x, arm.y, arm.z),
        (turn.x, turn.y, turn.z, turn.w),
        _numbers(message.lever_arm_covariance) or None,
        _numbers(message.rotation_covariance) or None,
    )


def calibration_to_message(
    calibration: Calibration, stamp: Time, undetermined: Sequence[str] = ()
) -> CalibrationMessage:
    """Return the Calibration message; `undetermined` has a text for each part that could not be determined."""
    channels, frequencies = calibration.response.shape
    return CalibrationMessage(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        id=calibration.id,
        config_hash=calibration.config_hash,
        dwells=calibration.dwells,
        channels=channels,
        frequencies=frequencies,
        response=complex_pairs(calibration.response),
        response_sigma=calibration.response_sigma,
        gain_sigma=calibration.gain_sigma,
        phase_sigma=calibration.phase_sigma,
        width_factor=calibration.width_factor,
        width_sigma=calibration.width_sigma,
        pupil=calibration.pupil,
        pupil_sigma=calibration.pupil_sigma,
        pupil_misfit=calibration.pupil_misfit,
        pupil_p_value=calibration.pupil_p_value,
        undetermined=list(undetermined),
    )


def calibration_from_message(message: CalibrationMessage) -> Calibration:
    """Return the calibration in a message.

    Raises:
        UserError: the message has no id, the number of its values contradicts its channels and frequencies, or a value
            is out of its range.
    """
    if not message.id:
        raise UserError("A Calibration has no id; it must have one, to which products refer.")
    response = from_complex_pairs(message.response, f"Calibration {message.id!r}: response")
    shape = message.channels, message.frequencies
    if response.size != shape[0] * shape[1]:
        raise UserError(
            f"Calibration {message.id!r} has {response.size} complex entries of response; {shape[0]} channels of "
            f"{shape[1]} frequencies need {shape[0] * shape[1]}."
        )
    return Calibration(
        config_hash=message.config_hash,
        response=response.reshape(shape),
        response_sigma=np.array(message.response_sigma),
        gain_sigma=np.array(message.gain_sigma),
        phase_sigma=np.array(message.phase_sigma),
        width_factor=message.width_factor,
        width_sigma=message.width_sigma,
        pupil=np.array(message.pupil),
        pupil_sigma=np.array(message.pupil_sigma),
        pupil_misfit=message.pupil_misfit,
        pupil_p_value=message.pupil_p_value,
        dwells=message.dwells,
        id=message.id,
    )
