"""From the phase history of a dwell to the images of all detectors; for strips see `strip_focus`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height.doubts import Doubt
from sal_height.elevation import AxisResponse, CellResponse
from sal_height.errors import Rejected, UserError
from sal_height.extras import import_extra
from sal_height.geometry import ApertureState, Grid, Trajectory
from sal_height.imaging.air import MEASUREMENTS
from sal_height.imaging.autofocus.gradient import (
    AutofocusSettings,
    Focus,
    apply_phase,
    autofocus,
    is_for_speckle,
    patch_centres,
)
from sal_height.imaging.autofocus.placement import (
    AS_NAVIGATED,
    NavigationPrior,
    Placement,
    place_image,
    placed_by_navigation,
)
from sal_height.imaging.checks import (
    check_doppler_centroid,
    check_dwell,
    describe_unverified_squint,
    doubts_of_odometry,
)
from sal_height.imaging.corrections import CorrectionSettings, with_known_errors
from sal_height.imaging.formers.choice import FORMERS, choose_former
from sal_height.imaging.pixels import (
    Processing,
    azimuth_resolution,
    ground_plane_grid,
    line_of_sight,
    slant_plane_grid,
    slant_plane_size,
    slc_noise_power,
)
from sal_height.numeric import C64, F64, WINDOWS, ShortRepr, broadening, draw_array
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import setting


class ImageSettings(AutofocusSettings, CorrectionSettings):
    """Settings of the image of a dwell or a strip, and known errors."""

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
    azimuth_window: str = setting("taylor", "weighting over the aperture", choices=tuple(sorted(WINDOWS)))
    autofocus: str = setting(
        "auto",
        "whether to estimate and remove the phase error that all channels have in common, and to locate the beams by "
        "their Doppler centroid; auto: if the odometry's covariances of velocity and attitude leave the beams "
        "uncertain by more than autofocus_from_beamwidths, and speckle can locate them",
        choices=("auto", "always", "never"),
    )
    autofocus_from_beamwidths: float = setting(
        0.02,
        "standard deviation of the along-track position of the beams, in beamwidths, from which auto is always",
        minimum=1e-6,
        maximum=1.0,
    )

    def beams_are_uncertain(self, prior: NavigationPrior, sensor: Sensor) -> bool:
        """True if the direction of the beams along the flight is too uncertain by navigation."""
        allowed = self.autofocus_from_beamwidths * sensor.beams.track_beamwidth * prior.flight_speed
        return prior.spread > allowed

    def describes_pixels_of(self, other: ImageSettings) -> bool:
        """True if images with the other settings join these in one strip.

        All are equal but the image former and the measured air, whose delay is continuous from block to block
        (`StripDelay`).
        """
        names = ImageSettings.model_fields.keys() - {"former", *MEASUREMENTS}
        return all(getattr(self, name) == getattr(other, name) for name in names)


@dataclass(frozen=True, eq=False)
class Slc(ShortRepr):
    """Single-look complex images of all detectors.

    Attributes:
        images: pixels, complex64, shape (detectors, rows, cols).
        grid: grid of the pixels.
        aperture: state of the platform in the middle of the aperture, or of the strip's image.
        noise_power: E|n|^2 of a pixel of each channel, shape (channels,).
        saturated_share: greatest fraction of clipped samples in each channel in the dwells that the images are made of,
            shape (channels,).
        azimuth_window: window over the synthetic aperture, a name of `windows.WINDOWS`.
        range_window: window over the bandwidth, a name of `windows.WINDOWS`.
        focus: result of autofocus; None: not requested.
        doubts: reasons to distrust the images.
        placement: offset of the image from odometry.
        residual_phase: standard deviation of the phase of each pulse that autofocus leaves, rad.
    """

    images: C64
    grid: Grid
    aperture: ApertureState
    noise_power: F64
    saturated_share: F64
    azimuth_window: str = "rectangular"
    range_window: str = "rectangular"
    focus: Focus | None = None
    doubts: tuple[Doubt, ...] = ()
    placement: Placement = AS_NAVIGATED
    residual_phase: float = 0.0

    def to_xarray(self) -> Any:
        """The images as an xarray.DataArray with the dimensions channel, row and col, and positions in map.

        Raises:
            UserError: xarray is not installed.
        """
        xarray = import_extra("xarray", "Making labelled arrays")
        position = dict(zip(("x", "y", "z"), np.moveaxis(self.grid.pixels(), -1, 0), strict=True))
        coordinates: dict[str, Any] = {
            name: (("row", "col"), values, {"units": "m", "long_name": f"{name} in the map frame"})
            for name, values in position.items()
        }
        noise = {"units": "1", "long_name": "power of the receiver noise in a pixel"}
        coordinates["noise_power"] = ("channel", self.noise_power, noise)
        attributes = {"units": "1", "long_name": "complex amplitude"}
        return xarray.DataArray(self.images, coordinates, ("channel", "row", "col"), "slc", attributes)

    def plot(self, channel: int = 0, axes: Any = None) -> Any:
        """Draw the power of a channel over the pixels, in dB over its noise if that is known; returns the axes.

        Args:
            channel: number of the channel.
            axes: axes of Matplotlib; None: those of a new figure.
        """
        noise = self.noise_power[channel]
        unit, known = ("dB over its noise", noise) if noise > 0 else ("dB", 1.0)
        power = np.abs(self.images[channel]) ** 2 / known
        level = 10 * np.log10(power, out=np.full(power.shape, np.nan), where=power > 0)
        names = ("along-track distance (m)", "distance in range (m)", f"power of channel {channel} ({unit})")
        return draw_array(level, self.grid.extent, names, "gray", axes)

    @property
    def autofocus_phase(self) -> F64:
        """Phase that was removed from each pulse, rad; empty: none."""
        return self.focus.phase if self.focus and self.focus.trusted else np.zeros(0)


def cell_response(slc: Slc, sensor: Sensor) -> CellResponse:
    """The response of images, by their windows and the spacing of their pixels in range and along the flight.

    A phase error of variance s^2, independent from pulse to pulse, leaves exp(-s^2) of a scatterer's energy in its
    response, and spreads the rest evenly over one cell along azimuth per pulse.

    Args:
        slc: images.
        sensor: sensor of the images.
    """
    grid, aperture = slc.grid, slc.aperture
    sight = grid.middle - aperture.position
    slant_range = float(np.linalg.norm(sight))
    down = grid.row_spacing * abs(float(grid.row_direction @ sight)) / slant_range / sensor.range_resolution
    across = grid.col_spacing / azimuth_resolution(sensor, aperture, slant_range)
    pulses = aperture.length / float(np.linalg.norm(aperture.velocity)) * sensor.pulse_repetition_frequency
    return CellResponse(
        AxisResponse(slc.range_window, round(down, 3)),
        AxisResponse(slc.azimuth_window, round(across, 3)),
        -float(np.expm1(-(slc.residual_phase**2))) * across / pulses,
    )


def focus_dwell(history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: ImageSettings) -> Slc:
    """Images of a spotlight dwell.

    Args:
        history: phase history of all detectors, as fast-time frequencies.
        track: track of the platform, from the first pulse to the last.
        sensor: sensor with waveform "spectrum".
        settings: settings of the image.

    Raises:
        Rejected: pulses or frequencies do not sample the scene, or the direction of the beams is unknown.
        UserError: an image that cannot be made.
    """
    processing = Processing(settings.range_window, settings.azimuth_window)
    track = track.mounted(sensor.mounting)
    antenna = track.positions(history.stamp_ns, history.pulse_times)
    aperture = track.aperture(history.stamp_ns, history.pulse_times)
    reference = float(history.reference_range[len(antenna) // 2])
    check_dwell(history, antenna, sensor, aperture)
    # Phase error, and the direction of the beams along the flight: by navigation and, if necessary, the data.
    sight, grid = line_of_sight(sensor, aperture), _dwell_grid(settings, sensor, aperture, reference, processing)
    velocity_covariance = track.velocity_covariance(history.stamp_ns, history.pulse_times)
    prior = NavigationPrior.of(with_known_errors(aperture, grid.middle, sensor, settings), velocity_covariance, sight)
    focus, placement = _find_beams(history, antenna, sensor, patch_centres(sensor, aperture, grid), prior, settings)
    if focus and focus.trusted:
        history = apply_phase(history, focus.phase)
    seconds = history.pulse_times - (history.pulse_times[0] + history.pulse_times[-1]) / 2
    antenna = placement.moved(antenna, seconds, sight)
    aperture = placement.seen_from(aperture, sight, reference)
    # The image, in the middle of the beams.
    grid = _dwell_grid(settings, sensor, aperture, reference, processing)
    former = choose_former(settings.former, antenna, sensor, processing, grid)
    off_middle = check_doppler_centroid(history, antenna, sensor, aperture, grid)
    images = former(history, antenna, sensor, processing, grid)
    noise_power = slc_noise_power(sensor, processing, len(antenna))
    doubtful = describe_unverified_squint(sensor, aperture)
    if is_for_speckle(sensor, antenna) and not (focus and focus.finds_beams):
        doubtful = doubtful or off_middle
    doubts = doubts_of_odometry(doubtful)
    windows = settings.azimuth_window, settings.range_window
    left = focus.standard_error if focus and focus.trusted else 0.0
    shares = history.shares.max(axis=1)
    return Slc(images, grid, aperture, noise_power, shares, *windows, focus, doubts, placement, left)


def _find_beams(
    history: PhaseHistory, antenna: F64, sensor: Sensor, patches: F64, prior: NavigationPrior, settings: ImageSettings
) -> tuple[Focus | None, Placement]:
    """Estimate the phase error of a dwell, None if not requested, and the placement of the image.

    Raises:
        Rejected: the direction of the beams is too uncertain by navigation, and the data do not determine it.
    """
    uncertain = settings.beams_are_uncertain(prior, sensor) and is_for_speckle(sensor, antenna)
    if settings.autofocus == "never" or (settings.autofocus == "auto" and not uncertain):
        return None, placed_by_navigation(prior)
    focus = autofocus(history, antenna, sensor, patches, settings)
    if uncertain and not focus.finds_beams:
        raise Rejected("autofocus", describe_distrust(focus, prior, settings))
    if not focus.trusted:
        return focus, placed_by_navigation(prior)
    return place_image(focus, history.pulse_times, sensor.wavelength, prior)


def describe_distrust(focus: Focus, prior: NavigationPrior, settings: AutofocusSettings) -> str:
    """Messages on a dwell whose phase error is not known, although navigation is not enough."""
    if not np.isfinite(focus.standard_error):
        why = "finds nothing above the noise"
    elif focus.standard_error > settings.autofocus_max_error_rad:
        why = (
            f"knows the phase to {focus.standard_error:.2g} rad only; autofocus_max_error_rad allows "
            f"{settings.autofocus_max_error_rad:g} rad"
        )
    elif not focus.trusted:
        why = f"makes the image less sharp by more than autofocus_max_blur, {settings.autofocus_max_blur:g}, allows"
    else:
        why = "sees bright targets, which do not determine the direction of the beams"
    return (
        f"Odometry states the velocity along the line of sight to {prior.speed:.2g} m/s and the pointing along the "
        f"flight to {prior.pointing:.2g} rad, so that the dwell needs autofocus, which {why}. Send longer "
        "dwells or more power, or state the odometry as well as it is known; with autofocus set to never the dwell is "
        "taken as the odometry puts it."
    )


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
