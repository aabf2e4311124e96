"""The measured responses and beams of a sensor: how they correct its data, and their settings."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from sal_height.beams import ZERNIKE, Beams
from sal_height.elevation import MISFIT_FRACTION
from sal_height.errors import UserError
from sal_height.numeric import C64, C128, F64, ShortRepr, window
from sal_height.response import PointTargetSettings
from sal_height.sensor import KNOWN_BEAMS, MAX_SHARE, BeamErrors, PhaseHistory, Sensor
from sal_height.settings import setting


@dataclass(frozen=True, eq=False)
class Calibration(ShortRepr):
    """Measured responses of receivers and beams of a sensor, relative to its description.

    Attributes:
        config_hash: hash of the sensor's description.
        response: of each channel at the fast-time frequencies, gain included: complex128, shape (channels,
            frequencies), those of waveform "spectrum" (`waveform.spectrum_sensor`); 1: as described.
        response_sigma: standard error of the shape of a channel's response, at a frequency, shape (channels,); NaN: not
            measured.
        gain_sigma: standard error of ln |gain| of each channel, shape (channels,); NaN: not measured.
        phase_sigma: standard error of the gain's phase, shape (channels,), rad.
        width_factor: width of the beams over that described.
        width_sigma: standard error of the width factor; NaN: not measured.
        pupil: coefficients of the aberrations of the pupil, as of `Beams.aberrated`, waves rms; empty: not measured.
        pupil_sigma: standard errors of the coefficients, waves rms.
        pupil_misfit: power that one scatterer leaves in a pixel over that of the noise, with this pupil; NaN: as above.
        pupil_p_value: probability of this misfit or a greater one if the calibration is right.
        dwells: number of dwells that it was made of.
        id: identity, any text; empty: the first 16 hexadecimal digits of the SHA-256 of all values.
    """

    config_hash: str
    response: C128
    response_sigma: F64
    gain_sigma: F64
    phase_sigma: F64
    width_factor: float = 1.0
    width_sigma: float = np.nan
    pupil: F64 = field(default_factory=lambda: np.zeros(0))
    pupil_sigma: F64 = field(default_factory=lambda: np.zeros(0))
    pupil_misfit: float = np.nan
    pupil_p_value: float = np.nan
    dwells: int = 0
    id: str = ""

    def __post_init__(self) -> None:
        if not self.config_hash:
            raise UserError("The calibration has no config_hash; it must be that of the sensor it belongs to.")
        sigmas = self.response_sigma, self.gain_sigma, self.phase_sigma
        if self.response.ndim != 2 or any(sigma.shape != self.response.shape[:1] for sigma in sigmas):
            raise UserError(
                f"The calibration has responses of shape {self.response.shape} and standard errors of shapes "
                f"{', '.join(str(sigma.shape) for sigma in sigmas)}; they must be (channels, frequencies) and "
                "(channels,)."
            )
        amplitude = np.abs(self.response)
        if not (np.all(np.isfinite(amplitude)) and np.all(amplitude.max(axis=1, initial=0) > 0)):
            raise UserError(
                "The calibration has responses that are not finite or a channel without any; all must be finite, and "
                "those of a channel not all 0."
            )
        if not 0.5 <= self.width_factor <= 2.0:
            raise UserError(
                f"The calibration's width factor of the beams is {self.width_factor}; allowed are 0.5 to 2.0."
            )
        if self.pupil.shape != self.pupil_sigma.shape or self.pupil.shape not in {(0,), (len(ZERNIKE),)}:
            raise UserError(
                f"The calibration has a pupil of {self.pupil.size} coefficients and {self.pupil_sigma.size} standard "
                f"errors; both must have {len(ZERNIKE)}, or none."
            )
        if not np.all(np.abs(self.pupil) <= 1):
            raise UserError("The calibration has coefficients of the pupil that are not between -1 and 1 waves.")
        errors = np.concatenate([*sigmas, [self.width_sigma], self.pupil_sigma])
        if np.any(np.isinf(errors) | (errors < 0)):
            raise UserError(
                "The calibration has standard errors that are negative or infinite; all must be 0 or more, or NaN "
                "where nothing was measured."
            )
        if not self.id:
            values = (np.asarray(getattr(self, one.name)) for one in fields(self))
            digest = hashlib.sha256(b"".join(value.tobytes() for value in values)).hexdigest()
            object.__setattr__(self, "id", digest[:16])

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Function and arguments that restore the calibration in another process, where equal ones are one object."""
        return _calibration_of, tuple(_hashable(getattr(self, one.name)) for one in fields(self))

    @cached_property
    def equaliser(self) -> C64:
        """Weights of the channels' frequencies that give all channels the same response, flat where possible.

        The inverse of the responses, regularised: a frequency has the weight w = a^4 / (a^4 + 0.1^4), with a the
        amplitude of the weakest channel there, in all channels. So ratios between channels are right at any
        frequency; w is 1 within .2 % down to a = 0.5, and 1/2 at a = 0.1.

        Returns:
            complex64, shape (channels, frequencies).
        """
        weakest = np.min(np.abs(self.response), axis=0) ** 4
        weight = weakest / (weakest + 0.1**4)
        safe = np.where(self.response == 0, 1, self.response)
        return np.asarray(weight / safe, dtype=np.complex64)

    def beams(self, described: Beams) -> Beams:
        """The beams as wide as measured, behind the measured pupil."""
        return described.aberrated(tuple(self.pupil.tolist())).widened(self.width_factor)

    def beam_uncertainty(self, beams: Beams, described: BeamErrors = KNOWN_BEAMS) -> float:
        """Root mean square error that the calibration leaves to the beams' amplitudes, as of `Beams.uncertainty`.

        Args:
            beams: beams of the sensor, as described.
            described: errors of the description, which count where nothing was measured.
        """
        gain = np.where(np.isnan(self.gain_sigma), described.gain, self.gain_sigma)
        phase = np.where(np.isnan(self.phase_sigma), described.phase, self.phase_sigma)
        variances = gain**2 + phase**2
        if np.isnan(self.width_sigma):
            return beams.uncertainty_by(variances, described.width)
        return beams.uncertainty_by(variances, self.width_sigma, self.width_factor)

    def check(self, sensor: Sensor) -> None:
        """Check that the calibration is of this sensor, whose waveform is "spectrum".

        Raises:
            UserError: it is not.
        """
        if self.config_hash != sensor.config_hash:
            raise UserError(
                f"Calibration {self.id} is of sensor {self.config_hash!r}; the frames are of {sensor.config_hash!r}."
            )
        shape = sensor.detector_count, sensor.sample_count
        if self.response.shape != shape:
            raise UserError(
                f"Calibration {self.id} has responses of {self.response.shape} channels and frequencies; the sensor "
                f"has {shape}."
            )

    def equalised(self, history: PhaseHistory) -> PhaseHistory:
        """Return the phase history (waveform "spectrum") with equal responses in all channels."""
        return replace(history, samples=history.samples * self.equaliser[:, None])

    def noise_gains(self, range_window: str) -> F64:
        """Return the factor by which equalising raises the noise power of images, shape (channels,).

        Args:
            range_window: range window of the images, a name of `windows.WINDOWS`.
        """
        power = window(range_window, self.response.shape[1]) ** 2
        return np.abs(self.equaliser) ** 2 @ power / np.sum(power)


class _Bytes(NamedTuple):
    """A number or an array, whose NaN are equal to themselves."""

    content: bytes
    kind: str
    shape: tuple[int, ...] | None


def _hashable(value: Any) -> Any:
    if isinstance(value, str | int):
        return value
    array = np.asarray(value)
    return _Bytes(array.tobytes(), array.dtype.str, array.shape if isinstance(value, np.ndarray) else None)


def _restored(value: Any) -> Any:
    if not isinstance(value, _Bytes):
        return value
    array = np.frombuffer(value.content, value.kind)
    return array[0].item() if value.shape is None else array.reshape(value.shape).copy()


@lru_cache(maxsize=16)
def _calibration_of(*values: Any) -> Calibration:
    """The calibration with these values of its fields; the same object for the same values."""
    return Calibration(*map(_restored, values))


class CalibrationSettings(PointTargetSettings):
    """Criteria for the data that a calibration is measured from, and its greatest error."""

    azimuth_looks: int = setting(
        4,
        "columns averaged to a pixel for gains and width of the beams; rows are not averaged, because on slopes they "
        "differ in elevation",
        minimum=1,
        maximum=64,
    )
    pixels_per_dwell: int = setting(
        256,
        "least number of pixels kept of each dwell for gains and width; 8000 of 15 dB give the width within 0.1 %",
        minimum=1,
        maximum=65_536,
    )
    min_energy: float = setting(
        50.0,
        "lowest energy of a pixel that is used for gains and width, summed over its looks and all detectors, over the "
        "noise power of one sample",
        minimum=1.0,
        maximum=1e9,
    )
    misfit_fraction: float = setting(
        MISFIT_FRACTION,
        "fraction of a pixel's power that one scatterer may leave beyond the noise; pixels with more are not used",
        minimum=0.0,
        maximum=1.0,
    )
    first_misfit_fraction: float = setting(
        0.15, "misfit_fraction of the first two steps, while gains and width are not known", minimum=0.0, maximum=1.0
    )
    pixels_per_parameter: int = setting(
        20, "least number of usable pixels for each gain, phase and width", minimum=1, maximum=1_000_000
    )
    max_uncertainty: float = setting(
        0.05,
        "greatest standard deviation of ln width, ln gain or phase, or of any combination of them (a unit vector); "
        "above it, gains and width stay as described",
        minimum=1e-6,
        maximum=1.0,
    )
    pupil_prior_waves: float = setting(
        0.0,
        "standard deviation that aberrations of the pupil are assumed to have, each Zernike term; such as 0.1; 0: the "
        "pupil is as described, and not measured",
        unit="waves rms",
        minimum=0.0,
        maximum=1.0,
    )
    echo_significance: float = setting(
        3.5,
        "standard errors above which an echo in the response of a receiver counts as real; of Gaussian noise one echo "
        "in exp(3.5^2) = 200000 is",
        minimum=0.0,
        maximum=100.0,
    )
    target_reach: int = setting(
        2, "pixels around its expected position in which the reference target is searched", minimum=0, maximum=1000
    )
    target_over_image_db: float = setting(
        20.0,
        "lowest power of the reference target, all channels together, over the median of the image",
        unit="dB",
        minimum=0.0,
        maximum=200.0,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel of a dwell that is used",
        minimum=0.0,
        maximum=1.0,
    )


DEFAULTS = CalibrationSettings()
