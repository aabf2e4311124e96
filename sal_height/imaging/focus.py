"""From the phase history of a dwell, or of the blocks of a strip, to the images of all detectors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState, Grid, Trajectory
from sal_height.imaging.autofocus.gradient import AutofocusSettings, Focus, apply_phase, autofocus, patch_centres
from sal_height.imaging.checks import (
    check_doppler_centroid,
    check_dwell,
    describe_strip_centroid,
    describe_unverified_squint,
)
from sal_height.imaging.formers.choice import FORMERS, choose_former
from sal_height.imaging.pixels import ground_plane_grid, slant_plane_grid, slant_plane_size, slc_noise_power
from sal_height.imaging.strip import (
    GREATEST_DRIFT,
    GREATEST_TURN,
    Strip,
    abeam_time,
    begin_strip,
    complete_columns,
    drift,
    extend_strip,
    follows,
    is_later,
    lay_anew,
    lay_lattice,
    next_image,
    starts_anew,
    turn,
)
from sal_height.imaging.weighting import Processing
from sal_height.numeric import C64, F64, WINDOWS, broadening
from sal_height.sensor import PhaseHistory, Sensor, aperture_length, processed_angle
from sal_height.settings import setting


class ImageSettings(AutofocusSettings):
    """What image is wanted of a dwell or a strip."""

    former: str = setting(
        "auto",
        "image former; auto: a fast one where it is as accurate as backprojection",
        choices=("auto", *FORMERS),
    )
    image_plane: str = setting(
        "slant",
        "plane of the image: slant (range and Doppler) or ground (horizontal, spotlight only)",
        choices=("slant", "ground"),
    )
    rows: int = setting(0, "pixels in range; 0: the whole range window (slant plane)", minimum=0, maximum=65536)
    cols: int = setting(
        0,
        "pixels in azimuth; 0: one beamwidth (spotlight) or the distance flown during a block (stripmap)",
        minimum=0,
        maximum=65536,
    )
    ground_spacing_m: float = setting(1.0, "pixel spacing in the ground plane", unit="m", minimum=1e-6, maximum=1e6)
    range_window: str = setting("taylor", "weighting over the bandwidth", choices=tuple(sorted(WINDOWS)))
    azimuth_window: str = setting("rectangular", "weighting over the aperture", choices=tuple(sorted(WINDOWS)))
    autofocus: bool = setting(
        default=False,
        description="whether to estimate and remove the phase error that all channels share (spotlight only)",
    )

    def describes_pixels_of(self, other: ImageSettings) -> bool:
        """Whether images with the other settings join on to these: all are equal but the former that makes them."""
        names = ImageSettings.model_fields.keys() - {"former"}
        return all(getattr(self, name) == getattr(other, name) for name in names)


@dataclass(frozen=True, eq=False)
class Slc:
    """Single-look complex images of all detectors.

    Attributes:
        images: complex64, shape (detectors, rows, cols).
        grid: pixels.
        aperture: state of the platform in the middle of the aperture, or of the strip's image.
        noise_power: E|n|^2 of a pixel of each channel, shape (channels,).
        saturated_share: greatest share of clipped samples in each channel in the dwells that the images are made of,
            shape (channels,).
        azimuth_window: over the synthetic aperture, a name of `windows.WINDOWS`.
        focus: what autofocus found; None: it was not asked for.
        doubt: a sentence on what of the odometry the data cannot confirm; empty: nothing.
    """

    images: C64
    grid: Grid
    aperture: ApertureState
    noise_power: F64
    saturated_share: F64
    azimuth_window: str = "rectangular"
    focus: Focus | None = None
    doubt: str = ""

    @property
    def autofocus_phase(self) -> F64:
        """Phase that was removed from each pulse, rad; empty: none."""
        return self.focus.phase if self.focus and self.focus.trusted else np.zeros(0)


def focus_dwell(history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: ImageSettings) -> Slc:
    """Images of a spotlight dwell.

    Args:
        history: of all detectors, as fast-time frequencies.
        track: of the platform, from the first pulse to the last.
        sensor: with waveform "spectrum".
        settings: what image is wanted.

    Raises:
        Rejected: pulses or frequencies do not sample the scene.
        UserError: an image that cannot be made.
    """
    processing = Processing(settings.range_window, settings.azimuth_window)
    track = track.mounted(sensor.mounting)
    antenna = track.positions(history.stamp_ns, history.pulse_times)
    aperture = track.aperture(history.stamp_ns, history.pulse_times)
    reference = float(history.reference_range[len(antenna) // 2])
    check_dwell(history, antenna, sensor, aperture)
    grid = _dwell_grid(settings, sensor, aperture, reference, processing)
    former = choose_former(settings.former, antenna, sensor, processing, grid)
    focus = None
    if settings.autofocus:
        focus = autofocus(history, antenna, sensor, patch_centres(sensor, aperture, grid), settings)
        history = apply_phase(history, focus.phase) if focus.trusted else history
    check_doppler_centroid(history, antenna, sensor, aperture, grid)
    images = former(history, antenna, sensor, processing, grid)
    noise_power = slc_noise_power(sensor, processing, len(antenna))
    doubt = describe_unverified_squint(sensor, aperture)
    return Slc(images, grid, aperture, noise_power, history.shares.max(axis=1), settings.azimuth_window, focus, doubt)


def _dwell_grid(
    settings: ImageSettings, sensor: Sensor, aperture: ApertureState, reference: float, processing: Processing
) -> Grid:
    if settings.image_plane == "ground":
        if not (settings.rows and settings.cols):
            raise UserError("Parameters rows and cols are 0; in the ground plane they must be given.")
        shape = settings.rows, settings.cols
        return ground_plane_grid(sensor, aperture, reference, *shape, settings.ground_spacing_m)
    broadened = broadening(processing.range_weights(sensor.sample_count))
    all_rows, all_cols = slant_plane_size(sensor, aperture, reference, broadened)
    rows, cols = settings.rows or all_rows, settings.cols or all_cols
    return slant_plane_grid(sensor, aperture, reference, rows, cols, broadened)


class StripFocuser:
    """Images of a strip, as its blocks come; holds the pulses, and their track, that the next ones need.

    Attributes:
        shortfall: why the block that has begun a strip completed no image, a sentence; empty: it did, or another block
            came last.
    """

    def __init__(self) -> None:
        """Begin without a strip."""
        self.shortfall = ""
        self._doubt = ""
        self._strip: Strip | None = None
        self._track: Trajectory | None = None
        self._settings = ImageSettings()

    def focus_block(
        self, history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: ImageSettings
    ) -> Slc | None:
        """Images of the columns that a block completes, a multiple of the settings' `cols`; None: not that many yet.

        A block that does not follow the last one, or of which another image is wanted, begins a new strip; so does one
        of a clock that has begun anew.

        Args:
            history: of all detectors, as fast-time frequencies.
            track: of the platform, from the first pulse of the block to its last.
            sensor: with waveform "spectrum".
            settings: what image is wanted.

        Raises:
            Rejected: pulses or frequencies do not sample the scene, or the block is older than the last one.
            UserError: an image that cannot be made in stripmap.
        """
        if settings.image_plane != "slant" or settings.autofocus:
            raise UserError(
                f"Parameters image_plane {settings.image_plane} and autofocus {str(settings.autofocus).lower()} were "
                "set; stripmap allows only slant and false."
            )
        processing = Processing(settings.range_window, settings.azimuth_window, processed_angle(sensor))
        track = self._track_with_held_pulses(history, track, sensor)
        antenna_track = track.mounted(sensor.mounting)
        antenna = antenna_track.positions(history.stamp_ns, history.pulse_times)
        aperture = antenna_track.aperture(history.stamp_ns, history.pulse_times)
        reference = float(history.reference_range[len(antenna) // 2])
        check_dwell(history, antenna, sensor, aperture)
        self._doubt = describe_strip_centroid(history, antenna, sensor, aperture) or self._doubt
        shape = settings.rows, settings.cols
        lattice = lay_lattice(sensor, processing, aperture, antenna, reference, shape)
        strip = self._strip if self._strip and not starts_anew(history, self._strip) else None
        if strip and not is_later(history, strip):
            raise Rejected(
                "out of order", "A block of the strip is not later than the last one; blocks must come in order."
            )
        goes_on = strip and settings.describes_pixels_of(self._settings) and follows(history, strip, sensor)
        continued = strip if goes_on else None
        if continued:
            strip = extend_strip(continued, history, antenna)
        else:
            strip = begin_strip(history, antenna, lattice, processing)
        drifted = abs(drift(strip)) > GREATEST_DRIFT * sensor.range_window
        if drifted or abs(turn(strip, sensor, aperture)) > GREATEST_TURN * sensor.beams.track_beamwidth:
            strip = lay_anew(strip, lattice, processing)
        self._strip, self._track, self._settings = strip, track, settings
        complete = complete_columns(strip, processing)
        # Without a stated width the first image has the columns that there are, so that a single block has an image.
        cols = complete if not (continued or settings.cols) else complete // lattice.cols * lattice.cols
        self.shortfall = "" if cols or continued else _describe_shortfall(strip, lattice, complete)
        if not cols:
            return None
        grid, self._strip = next_image(strip, cols, processing)
        former = choose_former(settings.former, strip.antenna, sensor, processing, grid)
        images = former(strip.history, strip.antenna, sensor, processing, grid)
        around = abeam_time(strip, grid) + np.array([-0.5, 0.5]) / sensor.pulse_repetition_frequency
        abeam = antenna_track.aperture(strip.history.stamp_ns, around)
        length = aperture_length(sensor, reference)
        pulses = round(length * len(antenna) / aperture.length)
        noise_power = slc_noise_power(sensor, processing, pulses)
        shares = strip.history.shares.max(axis=1)
        abeam = replace(abeam, length=length, sliding=True)
        doubt, self._doubt = describe_unverified_squint(sensor, aperture) or self._doubt, ""
        return Slc(images, grid, abeam, noise_power, shares, settings.azimuth_window, doubt=doubt)

    def _track_with_held_pulses(self, history: PhaseHistory, track: Trajectory, sensor: Sensor) -> Trajectory:
        """The track of a block, from the first pulse that the strip holds on if the block continues the strip."""
        if self._strip is None or self._track is None or not follows(history, self._strip, sensor):
            return track
        first_ns = self._strip.history.stamp_ns
        return self._track.followed_by(track).between(first_ns, history.stamp_of_last_pulse_ns)


def _describe_shortfall(strip: Strip, lattice: Grid, complete: int) -> str:
    reach = float(np.linalg.norm(strip.antenna[-1] - strip.antenna[0]))
    return (
        f"The first block of the strip reaches over {reach:.4g} m and fills the synthetic apertures of {complete} of "
        f"{lattice.cols} columns; the first image comes with a later block."
    )
