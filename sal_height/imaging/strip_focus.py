"""From the phase history of the blocks of a strip to the images of all detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.errors import Rejected, UserError
from sal_height.geometry import Grid, Trajectory
from sal_height.imaging.autofocus.placement import NavigationPrior, placed_by_navigation
from sal_height.imaging.checks import check_dwell, describe_strip_centroid, describe_unverified_squint
from sal_height.imaging.focus import ImageSettings, Slc
from sal_height.imaging.formers.choice import choose_former
from sal_height.imaging.pixels import line_of_sight, slc_noise_power
from sal_height.imaging.strip import CLOCK_STEP, WIDEST_GAP, Strip, lay_lattice
from sal_height.imaging.weighting import Processing
from sal_height.sensor import PhaseHistory, Sensor, aperture_length, processed_angle


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
        if settings.image_plane != "slant" or settings.autofocus == "always":
            raise UserError(
                f"Parameters image_plane {settings.image_plane} and autofocus {settings.autofocus} were set; stripmap "
                "allows only slant, and auto or never."
            )
        processing = Processing(settings.range_window, settings.azimuth_window, processed_angle(sensor))
        # The strip that the block continues, and a track from the first pulse that it holds.
        continued = self._continued(history, sensor, settings)
        if continued:
            first_ns, last_ns = continued.history.stamp_ns, history.stamp_of_last_pulse_ns
            track = continued.track.followed_by(track).between(first_ns, last_ns)
        # The block alone: where the antenna was, whether it can be focused, and which pixels suit it.
        mounted = track.mounted(sensor.mounting)
        antenna = mounted.positions(history.stamp_ns, history.pulse_times)
        aperture = mounted.aperture(history.stamp_ns, history.pulse_times)
        reference = float(history.reference_range[len(antenna) // 2])
        check_dwell(history, antenna, sensor, aperture)
        self._doubt = describe_strip_centroid(history, antenna, sensor, aperture) or self._doubt
        lattice = lay_lattice(sensor, processing, aperture, antenna, reference, (settings.rows, settings.cols))
        # The strip with the block, on the pixels that it had as long as the flight stays with them.
        if continued:
            strip = continued.followed_by(history, antenna, track)
        else:
            strip = Strip.begun(history, antenna, track, lattice, processing.angle)
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
        # Their image, and the state of the platform abeam of its middle.
        grid = replace(strip.lattice, cols=cols)
        pulses, sent_from = strip.lighting(grid)
        former = choose_former(settings.former, sent_from, sensor, processing, grid)
        images = former(pulses, sent_from, sensor, processing, grid)
        around = strip.abeam_time(grid) + np.array([-0.5, 0.5]) / sensor.pulse_repetition_frequency
        abeam = mounted.aperture(strip.history.stamp_ns, around)
        length = aperture_length(sensor, reference)
        noise_power = slc_noise_power(sensor, processing, round(length * len(antenna) / aperture.length))
        shares = strip.history.shares.max(axis=1)
        # What navigation does not know of the velocity is an error along the flight.
        sight = line_of_sight(sensor, abeam)
        velocity_covariance = mounted.velocity_covariance(strip.history.stamp_ns, around)
        prior = NavigationPrior.of(abeam, velocity_covariance, sight)
        abeam = placed_by_navigation(prior).seen_from(abeam, sight, reference)
        abeam = replace(abeam, length=length, sliding=True)
        doubt, self._doubt = describe_unverified_squint(sensor, aperture) or self._doubt, ""
        windows = settings.azimuth_window, settings.range_window
        return Slc(images, grid, abeam, noise_power, shares, *windows, doubt=doubt)

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
                "out of order", "A block of the strip is not later than the last one; blocks must come in order."
            )
        follows = pause * sensor.pulse_repetition_frequency < WIDEST_GAP
        return strip if follows and settings.describes_pixels_of(self._settings) else None


def _describe_shortfall(strip: Strip, lattice: Grid, complete: int) -> str:
    reach = float(np.linalg.norm(strip.antenna[-1] - strip.antenna[0]))
    return (
        f"The first block of the strip reaches over {reach:.4g} m and fills the synthetic apertures of {complete} of "
        f"{lattice.cols} columns; the first image comes with a later block."
    )
