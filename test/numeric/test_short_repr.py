"""Objects with arrays as texts of one screen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sal_height.elevation import ESTIMATORS, MlSettings
from sal_height.imaging import ImageSettings
from sal_height.numeric import ShortRepr
from sal_height.pipeline import Compressor, heights
from sal_height.simulation import flight_of, load_preset


@dataclass(frozen=True, eq=False)
class Inner(ShortRepr):
    """A part.

    Attributes:
        name: name of the part.
        values: numbers of the part, s.
    """

    name: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Whole(ShortRepr):
    """A thing of many parts.

    Attributes:
        height: height above the
            sphere, m; NaN where it is absent.
        image: pixels, complex64.
        rate: rate of the pulses, Hz.
        covariance: covariance of the position, m^2, shape (2, 2).
        counts: numbers of things.
        inner: a part.
        parts: all parts.
        note: a text; empty: none.
        secret: not shown.
    """

    height: np.ndarray
    image: np.ndarray
    rate: float
    covariance: np.ndarray
    counts: np.ndarray
    inner: Inner
    parts: tuple[Inner, ...] = ()
    note: str = ""
    secret: int = field(default=0, repr=False)


PART = Inner("left", np.zeros(3))
WHOLE = Whole(
    height=np.array([[1.0, np.nan], [2.5, -3.0]]),
    image=np.array([3 + 4j, 0], np.complex64),
    rate=2000.0,
    covariance=np.full((2, 2), np.nan),
    counts=np.zeros(0, np.uint8),
    inner=PART,
    parts=(PART, PART),
)


def test_a_line_says_type_shape_range_nan_and_unit() -> None:
    assert repr(WHOLE).splitlines() == [
        "Whole",
        "  height      float64 (2, 2), -3 to 2.5 m, 25 % NaN",
        "  image       complex64 (2,), magnitude 0 to 5",
        "  rate        2000.0 Hz",
        "  covariance  float64 (2, 2), 100 % NaN",
        "  counts      uint8 (0,)",
        "  inner       Inner(name='left')",
        "  parts       2 of Inner",
    ]


def test_a_long_line_is_cut() -> None:
    longest = repr(replace(WHOLE, note="x" * 500)).splitlines()[-1]
    assert len(longest) == 100
    assert longest.endswith("…")


def test_what_a_dwell_becomes_fits_a_screen_of_24_lines() -> None:
    flight = flight_of(load_preset("small"), seed=1)
    history = flight.phase_history(0)
    slc = Compressor().add(history, flight.track(0), flight.sensor, ImageSettings(cols=12))
    assert slc is not None
    field = heights(slc, flight.sensor, ESTIMATORS["ml"], MlSettings())
    texts = [repr(one) for one in (flight, history, slc, field, field.first, flight.sensor.beams, slc.grid)]
    assert max(len(text.splitlines()) for text in texts) <= 24
    assert "height" in texts[4]
    assert " m" in next(line for line in texts[4].splitlines() if line.startswith("  height "))
