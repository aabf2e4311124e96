"""From the phase history of the blocks of a strip to the images of all detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState, Grid, Trajectory
from sal_height.imaging.autofocus.gradient import Focus, apply_phase, hidden_trend
from sal_height.imaging.autofocus.phase_error import course_of, turns_slowly
from sal_height.imaging.autofocus.placement import (
    NavigationPrior,
    Placement,
    centroid_of,
    placed_by_beams,
    placed_by_centroid,
    placed_by_navigation,
    speed_of_a_radian,
)
from sal_height.imaging.autofocus.strip_phase import link_block, stays_in_range_cell
from sal_height.imaging.checks import (
    check_dwell,
    describe_strip_centroid,
    describe_unverified_squint,
    doubts_of_odometry,
)
from sal_height.imaging.corrections import with_known_errors
from sal_height.imaging.focus import ImageSettings, Slc, describe_distrust
from sal_height.imaging.formers.choice import choose_former
from sal_height.imaging.pixels import Processing, aim_point, line_of_sight, slc_noise_power
from sal_height.imaging.strip import CLOCK_STEP, WIDEST_GAP, Strip, lay_lattice
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor, aperture_length, processed_angle


class StripFocuser:
    """Forms images of a strip as its blocks arrive; keeps the pulses, and their track, that the next ones need.

    Attributes:
        shortfall: message on the block that has started a strip without completing an image; empty: it did, or another
            block was last.
    """

    def __init__(self) -> None:
        """Start without a strip."""
        self.shortfall = ""
        self._doubt = ""
        self._strip: Strip | None = None
        self._settings = ImageSettings()

    def focus_block(
        self, history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: ImageSettings
    ) -> Slc | None:
        """Form images of the columns that a block completes, a multiple of the settings' `cols`; None: too few yet.

        A block that does not follow the last one, or with other settings of the image, starts a new strip; so does one
        of a clock that was restarted.

        Args:
            history: phase history of all detectors, as fast-time frequencies.
            track: track of the platform, from the first pulse of the block to its last.
            sensor: sensor with waveform "spectrum".
            settings: settings of the image.

        Raises:
            Rejected: pulses or frequencies do not sample the scene, or the block is older than the last one.
            UserError: an image that cannot be made in stripmap.
        """
        if settings.image_plane != "slant":
            raise UserError(f"Parameter image_plane is {settings.image_plane}; stripmap allows only slant.")
        processing = Processing(settings.range_window, settings.azimuth_window, processed_angle(sensor))
        # The strip that the block continues, and a track from its first pulse.
        continued = self._continued(history, sensor, settings)
        if continued:
            first_ns, last_ns = continued.history.stamp_ns, history.stamp_of_last_pulse_ns
            track = continued.track.followed_by(track).between(first_ns, last_ns)
        # The block alone: position of the antenna, checks, and suitable pixels.
        mounted = track.mounted(sensor.mounting)
        antenna = mounted.positions(history.stamp_ns, history.pulse_times)
        aperture = mounted.aperture(history.stamp_ns, history.pulse_times)
        reference = float(history.reference_range[len(antenna) // 2])
        check_dwell(history, antenna, sensor, aperture)
        # Phase error, and the direction of the beams along the flight: by navigation or, if necessary, the data.
        velocity_covariance = mounted.velocity_covariance(history.stamp_ns, history.pulse_times)
        flown = with_known_errors(aperture, aim_point(sensor, aperture, reference), sensor, settings)
        prior = NavigationPrior.of(flown, velocity_covariance, line_of_sight(sensor, aperture))
        history, focus, placement = _in_focus(history, antenna, aperture, prior, continued, sensor, settings)
        if placement:
            aperture = placement.pointed(aperture, line_of_sight(sensor, aperture))
        self._doubt = describe_strip_centroid(history, antenna, sensor, aperture) or self._doubt
        shape = settings.rows, settings.cols
        lattice = lay_lattice(sensor, processing, aperture, antenna, reference, shape)
        # The strip with the block, on the pixels that it had as long as the flight stays with them.
        if continued:
            strip = continued.followed_by(history, antenna, track)
        else:
            strip = Strip.started(history, antenna, track, lattice, processing.angle, placement)
        if strip.has_left_lattice(sensor, aperture):
            strip = strip.on(lattice)
        self._strip, self._settings = strip, settings
        # Columns that are complete. Without a stated width the first image has all that there are, so that a single
        # block has an image.
        complete = strip.complete_columns()
        cols = complete if not (continued or settings.cols) else complete // lattice.cols * lattice.cols
        self.shortfall = "" if cols or continued else _describe_shortfall(strip, lattice, complete)
        if not cols:
            return None
        self._strip = strip.after(cols)
        # Their image.
        grid = replace(strip.lattice, cols=cols)
        pulses = round(aperture_length(sensor, reference) * len(antenna) / aperture.length)
        slc = _image(strip, grid, mounted, pulses, reference, sensor, settings)
        doubtful, self._doubt = describe_unverified_squint(sensor, aperture) or self._doubt, ""
        return replace(slc, focus=focus, doubts=doubts_of_odometry(doubtful))

    def _continued(self, history: PhaseHistory, sensor: Sensor, settings: ImageSettings) -> Strip | None:
        """The strip, if the block is its next and of the same image.

        Raises:
            Rejected: the block is not later than the last one.
        """
        strip = self._strip
        if strip is None or (pause := strip.pause_before(history)) < -CLOCK_STEP:
            return None
        if pause <= 0:
            raise Rejected(
                "out of order", "A block of the strip is not later than the last one; blocks must arrive in order."
            )
        follows = pause * sensor.pulse_repetition_frequency < WIDEST_GAP
        return strip if follows and settings.describes_pixels_of(self._settings) else None


def _in_focus(
    history: PhaseHistory,
    antenna: F64,
    aperture: ApertureState,
    prior: NavigationPrior,
    strip: Strip | None,
    sensor: Sensor,
    settings: ImageSettings,
) -> tuple[PhaseHistory, Focus | None, Placement | None]:
    """The block without its phase error, that error, and the placement of the strip; None for both if not estimated.

    It is estimated in all blocks of a strip or in none, or they would not join. The first determines the direction of
    the beams, and all of the phase beyond that is movement of the antenna.

    Args:
        history: phase history of a block.
        antenna: position at each of its pulses, m, shape (pulses, 3).
        aperture: aperture of the block by navigation.
        prior: uncertainty of navigation.
        strip: strip that the block continues; None: it starts one.
        sensor: sensor of the block.
        settings: settings of the image.

    Raises:
        Rejected: the direction of the beams is too uncertain by navigation, and the data do not determine it, or
            contradict it.
        UserError: a phase error is requested that cannot be estimated.
    """
    uncertain = settings.beams_are_uncertain(prior, sensor)
    if not _is_wanted(strip, uncertain, float(history.reference_range[0]), sensor, settings):
        return history, None, None
    placement, sight = strip.placement if strip else None, line_of_sight(sensor, aperture)
    if placement:
        sight = line_of_sight(sensor, placement.pointed(aperture, sight))
    before = (strip.history, strip.antenna) if strip else None
    focus = link_block(history, antenna, before, sight, aperture.direction, sensor, settings)
    if not focus.trusted:
        if uncertain:
            raise Rejected("autofocus", describe_distrust(focus, prior, settings))
        return history, replace(focus, phase=np.zeros(len(antenna))), placement or placed_by_navigation(prior)
    # The offset of the middle of the beams, if the course of the phase is known; the rest is movement.
    times, phase, slow = history.pulse_times, focus.phase, turns_slowly(focus.phase)
    error = float(np.hypot(focus.trend_error, hidden_trend(sensor, antenna, settings)))
    of_a_radian = speed_of_a_radian(times, sensor.wavelength)
    if slow:
        course, trend = course_of(phase)
        apart = replace(focus, phase=course, trend=trend, trend_error=error)
        centroid = centroid_of(apart, times, sensor.wavelength, prior)
    if placement is None:
        if slow:
            placement = placed_by_centroid(centroid, prior, 2 * np.pi * of_a_radian)
        else:
            placement = placed_by_beams(prior, of_a_radian * error)
        placement = replace(placement, beams_error=of_a_radian * error)
        phase = phase - prior.flight_speed * placement.pointing / of_a_radian * np.arange(len(phase))
    return apply_phase(history, phase), replace(focus, phase=phase), placement


def _is_wanted(
    strip: Strip | None, uncertain: bool, slant_range: float, sensor: Sensor, settings: ImageSettings
) -> bool:
    """True if the phase error of a block is estimated: as in the strip that it continues, or else by the settings.

    Raises:
        UserError: it is requested but cannot be estimated.
    """
    if strip:
        return strip.placement is not None
    can_be_told = stays_in_range_cell(sensor, slant_range)
    if settings.autofocus == "always" and not can_be_told:
        raise UserError(
            "Parameter autofocus is always, which in stripmap needs known noise powers and a beam so narrow that all "
            "that it lights abeam stays in its range cell; set auto or never."
        )
    return can_be_told and (settings.autofocus == "always" or (settings.autofocus == "auto" and uncertain))


def _image(
    strip: Strip,
    grid: Grid,
    track: Trajectory,
    pulses: int,
    slant_range: float,
    sensor: Sensor,
    settings: ImageSettings,
) -> Slc:
    """The image of columns that are complete.

    Args:
        strip: strip of the columns.
        grid: grid of the columns.
        track: track of the antenna.
        pulses: number of pulses of an aperture.
        slant_range: slant range at which an aperture has its stated length, m.
        sensor: sensor of the strip.
        settings: settings of the image.
    """
    processing = Processing(settings.range_window, settings.azimuth_window, processed_angle(sensor))
    history, sent_from = strip.lighting(grid)
    former = choose_former(settings.former, sent_from, sensor, processing, grid)
    images = former(history, sent_from, sensor, processing, grid)
    noise_power = slc_noise_power(sensor, processing, pulses)
    shares = strip.history.shares.max(axis=1)
    # The state of the platform abeam of the middle; the error of its velocity is an error along the flight.
    around = strip.abeam_time(grid) + np.array([-0.5, 0.5]) / sensor.pulse_repetition_frequency
    abeam = track.aperture(strip.history.stamp_ns, around)
    sight, placement = line_of_sight(sensor, abeam), strip.placement
    if placement is None:
        velocity_covariance = track.velocity_covariance(strip.history.stamp_ns, around)
        placement = placed_by_navigation(NavigationPrior.of(abeam, velocity_covariance, sight))
    abeam = replace(abeam, length=aperture_length(sensor, slant_range), sliding=True)
    abeam = placement.seen_from(abeam, sight, slant_range)
    windows = settings.azimuth_window, settings.range_window
    return Slc(images, grid, abeam, noise_power, shares, *windows, placement=placement)


def _describe_shortfall(strip: Strip, lattice: Grid, complete: int) -> str:
    reach = float(np.linalg.norm(strip.antenna[-1] - strip.antenna[0]))
    return (
        f"The first block of the strip reaches over {reach:.4g} m and fills the synthetic apertures of {complete} of "
        f"{lattice.cols} columns; the first image follows with a later block."
    )
