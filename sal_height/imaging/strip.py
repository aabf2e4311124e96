"""The strip: pulses of consecutive stripmap blocks, kept until the apertures of targets are complete, and its pixels.

All images of a strip lie on one lattice of pixels, so that they join without seam or gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, Trajectory
from sal_height.imaging.autofocus.placement import Placement
from sal_height.imaging.formers.backprojection import filled_apertures
from sal_height.imaging.pixels import Processing, line_of_sight, strip_grid
from sal_height.numeric import F64, broadening
from sal_height.sensor import PhaseHistory, Sensor

WIDEST_GAP = 1.5  # pulse intervals from one block to the next, beyond which pulses are missing
GREATEST_DRIFT = 0.1  # of the middle row from the reference range on one lattice, range windows
CLOCK_STEP = 1.0  # greatest delay of a block, s; an older one is of a clock that was restarted, as by a replay
SPARE_PULSES = 16  # kept beyond the aperture of the next column, from which others are interpolated
SPARE_SHARE = 0.25  # of an aperture, kept beyond those for a new lattice in another direction
GREATEST_CRAB = np.pi / 3  # angle between the flight and the body's forward axis, along which columns lie, rad


@dataclass(frozen=True, eq=False)
class Strip:
    """Pulses kept, and the next pixels.

    Attributes:
        history: kept pulses; times count from its stamp.
        antenna: position at each kept pulse, m, shape (pulses, 3).
        track: track of the platform during these pulses.
        lattice: pixels from the next column on, those of one image.
        angle: processed angle, rad.
        placement: placement by the Doppler centroid of the first block, if the phase errors of all pulses are removed;
            None: they are not estimated.
    """

    history: PhaseHistory
    antenna: F64
    track: Trajectory
    lattice: Grid
    angle: float
    placement: Placement | None = None

    @classmethod
    def begun(
        cls,
        history: PhaseHistory,
        antenna: F64,
        track: Trajectory,
        lattice: Grid,
        angle: float,
        placement: Placement | None,
    ) -> Self:
        """A strip of its first block; its first column is the first of the lattice that the pulses can fill."""
        strip = cls(history, antenna, track, lattice, angle, placement)
        return replace(strip, lattice=_moved(lattice, np.ceil(strip._first_column(lattice))))

    def pause_before(self, history: PhaseHistory) -> float:
        """Time (s) from the last kept pulse to the first of a block."""
        since = (history.stamp_ns - self.history.stamp_ns) * 1e-9 + history.pulse_times[0]
        return float(since - self.history.pulse_times[-1])

    def followed_by(self, history: PhaseHistory, antenna: F64, track: Trajectory) -> Self:
        """The strip with the pulses of the next block, and a track of all its pulses."""
        kept = self.history
        later = (history.stamp_ns - kept.stamp_ns) * 1e-9 + history.pulse_times
        joined = PhaseHistory(
            stamp_ns=kept.stamp_ns,
            pulse_times=np.concatenate([kept.pulse_times, later]),
            reference_range=np.concatenate([kept.reference_range, history.reference_range]),
            samples=np.concatenate([kept.samples, history.samples], axis=1),
            saturated_share=np.concatenate([kept.shares, history.shares], axis=1),
        )
        return replace(self, history=joined, antenna=np.concatenate([self.antenna, antenna]), track=track)

    def has_left_lattice(self, sensor: Sensor, aperture: ApertureState) -> bool:
        """True if the flight has drifted from the middle row, or the beams have turned, too far for one lattice.

        The drift is that of the middle row, abeam of the last pulse, from the reference range. The turn is the angle by
        which the middle of the beams points ahead of abeam.
        """
        along = self.lattice.col_direction
        abeam = self.lattice.points((self.lattice.rows - 1) / 2, 0.0) - self.antenna[-1]
        abeam -= (abeam @ along) * along
        drift = float(np.linalg.norm(abeam) - self.history.reference_range[-1])
        turn = float(np.arcsin(line_of_sight(sensor, aperture) @ along))
        return abs(drift) > GREATEST_DRIFT * sensor.range_window or abs(turn) > 0.1 * sensor.beams.track_beamwidth

    def on(self, lattice: Grid) -> Self:
        """The strip on another lattice, from the end of the old one, or from the first column that pulses fill."""
        next_one = float((self.lattice.origin - lattice.origin) @ lattice.col_direction) / lattice.col_spacing
        missing = max(0.0, np.ceil(self._first_column(lattice) - next_one))
        return replace(self, lattice=_moved(lattice, next_one + missing))

    def complete_columns(self) -> int:
        """Number of columns, from the next one on, whose apertures the kept pulses fill."""
        lattice = self.lattice
        last = float((self.antenna[-1] - lattice.origin) @ lattice.col_direction)
        count = int((last - self._reach(lattice, self.antenna[-1])) / lattice.col_spacing) + 1
        while count > 0:
            ends = lattice.points(np.array([0.0, lattice.rows - 1.0]), np.full(2, count - 1.0))
            if filled_apertures(ends, self.antenna, lattice.col_direction, self.angle).all():
                return count
            count -= 1
        return 0

    def lighting(self, grid: Grid) -> tuple[PhaseHistory, F64]:
        """The kept pulses that light some of the columns, with SPARE_PULSES on either side; and the antenna in them."""
        along = grid.points(0.0, np.array([0.0, grid.cols - 1.0])) @ grid.col_direction
        reach = self._reach(grid, self.antenna[-1])
        first, last = np.searchsorted(self.antenna @ grid.col_direction, along + np.array([-reach, reach]))
        lit = slice(max(0, int(first) - SPARE_PULSES), int(last) + SPARE_PULSES)
        return self.history.pulses(lit), self.antenna[lit]

    def after(self, cols: int) -> Self:
        """The strip beyond its next `cols` columns, with the pulses and the track that it still needs."""
        lattice = _moved(self.lattice, cols)
        needed = float(lattice.origin @ lattice.col_direction)
        needed -= (1 + 2 * SPARE_SHARE) * self._reach(lattice, self.antenna[-1])
        first = int(np.searchsorted(self.antenna @ lattice.col_direction, needed)) - SPARE_PULSES
        kept = slice(max(0, first), None)
        dropped_ns = int(self.history.pulse_times[kept][0] * 1e9)
        history = replace(
            self.history,
            stamp_ns=self.history.stamp_ns + dropped_ns,
            pulse_times=self.history.pulse_times[kept] - dropped_ns * 1e-9,
            reference_range=self.history.reference_range[kept],
            samples=self.history.samples[:, kept],
            saturated_share=self.history.shares[:, kept],
        )
        return replace(self, history=history, antenna=self.antenna[kept], lattice=lattice)

    def abeam_time(self, grid: Grid) -> float:
        """Time (s after the stamp of the history) at which the antenna is abeam of the middle column of `grid`."""
        middle = float(grid.points(0.0, (grid.cols - 1) / 2) @ grid.col_direction)
        return float(np.interp(middle, self.antenna @ grid.col_direction, self.history.pulse_times))

    def _first_column(self, lattice: Grid) -> float:
        """Fractional column from which on the first pulse is not too late for the aperture of any row."""
        place = float((self.antenna[0] - lattice.origin) @ lattice.col_direction)
        rounding = 1e-6  # columns added to an aperture so that rounding does not leave its ends unfilled
        return (place + self._reach(lattice, self.antenna[0])) / lattice.col_spacing + rounding

    def _reach(self, lattice: Grid, position: F64) -> float:
        """Half the aperture of the farthest row, m, as `filled_apertures` measures it: between sines."""
        far = lattice.points(lattice.rows - 1.0, 0.0) - position
        across = far - (far @ lattice.col_direction) * lattice.col_direction
        return float(np.linalg.norm(across) * np.tan(np.arcsin(self.angle / 2)))


def lay_lattice(
    sensor: Sensor,
    processing: Processing,
    aperture: ApertureState,
    antenna: F64,
    reference_range: float,
    shape: tuple[int, int],
) -> Grid:
    """Pixels abeam of an aperture, spaced along the flight by the whole number of pulses nearest to the resolution.

    Nearest, so that a gust that spreads the pulses by a little does not halve the spacing.

    Args:
        sensor: sensor with wavelength, bandwidth and beams.
        processing: windows and processed angle.
        aperture: state of the platform.
        antenna: position at each pulse, m, shape (pulses, 3).
        reference_range: slant range of the middle row, m.
        shape: rows (0: all of the range window) and columns of an image (0: as long as the pulses' path).

    Raises:
        Rejected: the platform flies sideways or backwards.
        UserError: too many pixels.
    """
    flown = antenna[-1] - antenna[0]
    way = float(flown @ aperture.forward) / (len(antenna) - 1)
    crab = float(np.arccos(np.clip(flown @ aperture.forward / np.linalg.norm(flown), -1.0, 1.0)))
    if crab > GREATEST_CRAB:
        raise Rejected(
            "flight not forward",
            f"The platform flies {crab:.3g} rad off the forward axis of base_link; stripmap allows "
            f"{GREATEST_CRAB:.3g} rad.",
        )
    broadened = broadening(processing.range_weights(sensor.sample_count))
    steps = max(1, round(sensor.wavelength / (2 * processing.angle) / way))
    spacing = (sensor.range_resolution * broadened, steps * way)
    rows, cols = shape
    rows = rows or max(1, int(sensor.sample_count / broadened))
    return strip_grid(sensor, aperture, reference_range, (rows, cols or max(1, len(antenna) // steps)), spacing)


def _moved(lattice: Grid, columns: float) -> Grid:
    """The lattice from another column on."""
    return replace(lattice, origin=lattice.points(0.0, columns))
