"""The strip: pulses of consecutive stripmap blocks, held until the apertures of targets are complete, and its pixels.

All images of a strip lie on one lattice of pixels, so that they join without seam or gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, look_direction
from sal_height.imaging.formers.backprojection import filled_apertures
from sal_height.imaging.pixels import strip_grid
from sal_height.imaging.weighting import Processing
from sal_height.numeric import F64, broadening
from sal_height.sensor import PhaseHistory, Sensor

WIDEST_GAP = 1.5
"""Pulse intervals from one block to the next, beyond which pulses are missing."""

GREATEST_DRIFT = 0.1
"""Greatest distance of the middle row from the reference range, over the range window, on one lattice."""

GREATEST_TURN = 0.1
"""Beamwidths by which the beams may point ahead of or behind abeam of the lattice before that is laid anew."""

CLOCK_STEP = 1.0
"""Greatest delay of a block, s; an older one belongs to a clock that has started again, as when a bag is replayed."""

SPARE_PULSES = 16
"""Pulses held beyond the aperture of the next column, from which others are interpolated."""

SPARE_SHARE = 0.25
"""Share of an aperture that is held beyond those: the pulses that a lattice laid anew in another direction needs."""

GREATEST_CRAB = np.pi / 3
"""Greatest angle between the flight and the body's forward axis, to which columns run and beams are square, rad."""


ROUNDING = 1e-6
"""Columns added to the length of an aperture so that rounding does not leave its ends unfilled."""


@dataclass(frozen=True)
class Strip:
    """Pulses held, and the pixels that come next.

    Attributes:
        history: pulses held; times count from its stamp.
        antenna: position at each pulse held, m, shape (pulses, 3).
        lattice: pixels from the next column on, as many as one image has.
    """

    history: PhaseHistory
    antenna: F64
    lattice: Grid


def lay_lattice(
    sensor: Sensor,
    processing: Processing,
    aperture: ApertureState,
    antenna: F64,
    reference_range: float,
    shape: tuple[int, int],
) -> Grid:
    """Pixels abeam of an aperture, as many whole pulses apart along the flight as come nearest to the resolution.

    Nearest, so that a gust that spreads the pulses by a little does not halve the spacing.

    Args:
        sensor: wavelength, bandwidth and beams.
        processing: windows and processed angle.
        aperture: state of the platform.
        antenna: position at each pulse, m, shape (pulses, 3).
        reference_range: slant range of the middle row, m.
        shape: rows (0: all of the range window) and columns of an image (0: as long as the pulses' way).

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
    broad = [broadening(processing.range_weights(sensor.sample_count)), broadening(processing.azimuth_weights(1024))]
    resolved = sensor.wavelength / (2 * processing.angle) * broad[1]
    steps = max(1, round(resolved / way))
    spacing = (sensor.range_resolution * broad[0], steps * way)
    rows, cols = shape
    rows = rows or max(1, int(sensor.sample_count / broad[0]))
    return strip_grid(sensor, aperture, reference_range, (rows, cols or max(1, len(antenna) // steps)), spacing)


def begin_strip(history: PhaseHistory, antenna: F64, lattice: Grid, processing: Processing) -> Strip:
    """A strip of the pulses of its first block, whose first column is the first that they can fill.

    Args:
        history: of the block.
        antenna: position at each pulse, m, shape (pulses, 3).
        lattice: of pixels abeam of the block (`lay_lattice`).
        processing: the processed angle.
    """
    return Strip(history, antenna, _moved(lattice, np.ceil(_first_column(lattice, antenna, processing))))


def is_later(history: PhaseHistory, strip: Strip) -> bool:
    """Whether the first pulse of a block comes after those that the strip holds."""
    return _pause(history, strip) > 0


def starts_anew(history: PhaseHistory, strip: Strip) -> bool:
    """Whether a block is so much older than the strip that its clock has begun anew, as of a bag played again."""
    return _pause(history, strip) < -CLOCK_STEP


def follows(history: PhaseHistory, strip: Strip, sensor: Sensor) -> bool:
    """Whether the first pulse of a block is the next after those that the strip holds."""
    return 0 < _pause(history, strip) * sensor.pulse_repetition_frequency < WIDEST_GAP


def _pause(history: PhaseHistory, strip: Strip) -> float:
    """Time (s) from the last pulse that the strip holds to the first of a block."""
    since = (history.stamp_ns - strip.history.stamp_ns) * 1e-9 + history.pulse_times[0]
    return float(since - strip.history.pulse_times[-1])


def extend_strip(strip: Strip, history: PhaseHistory, antenna: F64) -> Strip:
    """The strip with the pulses of the next block."""
    held = strip.history
    later = (history.stamp_ns - held.stamp_ns) * 1e-9 + history.pulse_times
    return replace(
        strip,
        history=PhaseHistory(
            stamp_ns=held.stamp_ns,
            pulse_times=np.concatenate([held.pulse_times, later]),
            reference_range=np.concatenate([held.reference_range, history.reference_range]),
            samples=np.concatenate([held.samples, history.samples], axis=1),
            saturated_share=np.concatenate([held.shares, history.shares], axis=1),
        ),
        antenna=np.concatenate([strip.antenna, antenna]),
    )


def drift(strip: Strip) -> float:
    """Distance (m) by which the middle row, abeam of the last pulse, is off the reference range."""
    lattice = strip.lattice
    middle = lattice.points((lattice.rows - 1) / 2, 0.0)
    sight = middle - strip.antenna[-1]
    sight -= (sight @ lattice.col_direction) * lattice.col_direction
    return float(np.linalg.norm(sight) - strip.history.reference_range[-1])


def turn(strip: Strip, sensor: Sensor, aperture: ApertureState) -> float:
    """Angle (rad) by which the middle of the beams points ahead of abeam of the lattice."""
    sight = aperture.rotation @ look_direction(np.mean(sensor.beams.span), 0.0, sensor.look_side)
    return float(np.arcsin(sight @ strip.lattice.col_direction))


def lay_anew(strip: Strip, lattice: Grid, processing: Processing) -> Strip:
    """The strip on another lattice, which goes on where the old one ends, or at the first column that pulses fill."""
    next_one = float((strip.lattice.origin - lattice.origin) @ lattice.col_direction) / lattice.col_spacing
    missing = max(0.0, np.ceil(_first_column(lattice, strip.antenna, processing) - next_one))
    return replace(strip, lattice=_moved(lattice, next_one + missing))


def complete_columns(strip: Strip, processing: Processing) -> int:
    """Number of columns, from the next one on, whose apertures the pulses held fill."""
    lattice = strip.lattice
    last = float((strip.antenna[-1] - lattice.origin) @ lattice.col_direction)
    count = int((last - _reach(lattice, strip.antenna[-1], processing)) / lattice.col_spacing) + 1
    while count > 0:
        ends = lattice.points(np.array([0.0, lattice.rows - 1.0]), np.full(2, count - 1.0))
        if filled_apertures(ends, strip.antenna, lattice.col_direction, processing.angle).all():
            return count
        count -= 1
    return 0


def next_image(strip: Strip, cols: int, processing: Processing) -> tuple[Grid, Strip]:
    """The pixels of the next `cols` columns, and the strip beyond them with the pulses that it still needs."""
    grid, lattice = replace(strip.lattice, cols=cols), _moved(strip.lattice, cols)
    needed = float(lattice.origin @ lattice.col_direction)
    needed -= (1 + 2 * SPARE_SHARE) * _reach(lattice, strip.antenna[-1], processing)
    first = int(np.searchsorted(strip.antenna @ lattice.col_direction, needed)) - SPARE_PULSES
    held = slice(max(0, first), None)
    dropped_ns = int(strip.history.pulse_times[held][0] * 1e9)
    history = replace(
        strip.history,
        stamp_ns=strip.history.stamp_ns + dropped_ns,
        pulse_times=strip.history.pulse_times[held] - dropped_ns * 1e-9,
        reference_range=strip.history.reference_range[held],
        samples=strip.history.samples[:, held].copy(),
        saturated_share=strip.history.shares[:, held],
    )
    return grid, Strip(history, strip.antenna[held], lattice)


def abeam_time(strip: Strip, grid: Grid) -> float:
    """Time (s after the stamp of the history held) at which the antenna is abeam of the middle column of `grid`."""
    middle = float(grid.points(0.0, (grid.cols - 1) / 2) @ grid.col_direction)
    return float(np.interp(middle, strip.antenna @ grid.col_direction, strip.history.pulse_times))


def _first_column(lattice: Grid, antenna: F64, processing: Processing) -> float:
    """Fractional column from which on the first pulse is not too late for the aperture of any row."""
    place = float((antenna[0] - lattice.origin) @ lattice.col_direction) + _reach(lattice, antenna[0], processing)
    return place / lattice.col_spacing + ROUNDING


def _reach(lattice: Grid, position: F64, processing: Processing) -> float:
    """Half the aperture of the farthest row, m, as `filled_apertures` measures it: between sines."""
    far = lattice.points(lattice.rows - 1.0, 0.0) - position
    across = far - (far @ lattice.col_direction) * lattice.col_direction
    return float(np.linalg.norm(across) * np.tan(np.arcsin(processing.angle / 2)))


def _moved(lattice: Grid, columns: float) -> Grid:
    """The lattice from another column on."""
    return replace(lattice, origin=lattice.points(0.0, columns))
