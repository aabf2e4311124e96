"""The receive beams of a detector array: the response of every channel to a target in a given direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from sal_height.beams.pattern import Pattern
from sal_height.beams.pupil import aberrated_pattern
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid, aperture_at, squint_on_cone
from sal_height.numeric import C128, F64, Index, ShortRepr


@dataclass(frozen=True, eq=False)
class Beams(ShortRepr):
    """The receive beams of a detector array.

    Detectors lie on an axis through the middle of the array that is turned by `rotation` (SAL paper, figure 8). A
    target at elevation x above that middle and squint y has the coordinate x cos psi + y sin psi along the axis, and
    -x sin psi + y cos psi across it.

    Attributes:
        patterns: amplitude pattern of every detector, or the one common to all.
        boresights: angle of each beam along the detector axis in rad from nadir, shape (detectors,), increasing.
        beamwidth: wavelength / antenna diameter along the detector axis, rad.
        rotation: psi, angle of the detector axis from elevation towards the direction of flight, rad.
        aspects: angles along the flight, relative to the squint, under which a target was observed while its image was
            synthesised; a single 0 where the antenna was pointed at the target; rad.
        weights: weights of the aspects in the image; their sum is 1, unless the beams are scaled to the peak of such a
            mean.
        middle: point of the axis about which it is turned, from nadir, rad; None: half way between the first and the
            last boresight.
        matrix: channels from detectors, shape (channels, detectors), square; None: the channels are the detectors
            (`combined`).
        azimuth_beamwidth: wavelength / antenna diameter across the detector axis, rad; None: `beamwidth`.
        uncertainty: standard deviation of the error of a channel's complex amplitude, over the greatest amplitude of a
            beam, root mean square over channels; 0: the beams are known.
        pitch_uncertainty: relative standard deviation of the angles between the beams, an error of elevation in
            proportion to the angle from the middle of the array (`axis_middle`); 0: they are known.
    """

    patterns: tuple[Pattern, ...]
    boresights: F64
    beamwidth: float
    rotation: float = 0.0
    aspects: F64 = field(default_factory=lambda: np.zeros(1))
    weights: F64 = field(default_factory=lambda: np.ones(1))
    middle: float | None = None
    matrix: F64 | C128 | None = None
    azimuth_beamwidth: float | None = None
    uncertainty: float = 0.0
    pitch_uncertainty: float = 0.0

    def response(self, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
        """Return the amplitude of every channel for targets at `elevation` and `squint` (rad): shape (..., channels).

        Float64, or complex128 if a pattern or the matrix is complex.
        """
        return self._in_channels(self._amplitude, elevation, squint)

    def slope(self, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
        """Return the derivative of `response` with respect to elevation, per rad: shape (..., channels)."""
        return self._in_channels(self._slope, elevation, squint)

    def power(self, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
        """Return the sum of |response|^2 over the channels, for targets at `elevation` and `squint` (rad)."""
        return np.sum(np.abs(self.response(elevation, squint)) ** 2, axis=-1)

    def averaged(self, aspects: F64, weights: F64) -> Self:
        """Return the beams of an image whose targets were observed under `aspects` (rad), weighted by `weights`."""
        return replace(self, aspects=aspects, weights=weights / np.sum(weights))

    def uncertainty_by(self, channel_variances: F64 | float, width_sigma: float, width_factor: float = 1.0) -> float:
        """The `uncertainty` that follows from errors of channels and of the width of the beams.

        A relative error of a channel is one of the beam's greatest amplitude; an error of the width w changes the
        amplitude by dh / d ln w, whose mean square is that over all directions between the boresights.

        Args:
            channel_variances: variances of the relative errors of channels, shape (channels,), or one for all.
            width_sigma: standard deviation of the width factor.
            width_factor: width over that of these beams.
        """
        step, directions = 1e-3, np.linspace(*self.span, 8 * self.count)
        narrow, wide = (self.widened(factor).response(directions, 0.0) for factor in (1 - step, 1 + step))
        change = np.abs(wide - narrow) / (2 * step) * width_sigma / width_factor
        return float(np.sqrt(np.mean(channel_variances) + np.mean(change**2)))

    def scaled(self, gains: npt.NDArray[Any]) -> Self:
        """Return the beams of channels that are multiplied by `gains`, real or complex, shape (channels,)."""
        if self.matrix is not None:
            return replace(self, matrix=gains[:, None] * self.matrix)
        if np.all(gains == gains[0]):
            return replace(self, patterns=tuple(pattern.scaled(gains[0]) for pattern in self.patterns))
        patterns = self.patterns if len(self.patterns) > 1 else self.patterns * self.count
        pairs = zip(patterns, gains, strict=True)
        return replace(self, patterns=tuple(pattern.scaled(gain) for pattern, gain in pairs))

    def widened(self, factor: float) -> Self:
        """Return beams `factor` times as wide, around the same boresights."""
        return replace(self, beamwidth=self.beamwidth * factor, azimuth_beamwidth=self.beamwidth_beside * factor)

    def aberrated(self, coefficients: tuple[float, ...]) -> Self:
        """Return these beams behind a pupil with aberrations, common to all detectors.

        Args:
            coefficients: coefficients of the terms of `pupil.ZERNIKE` in their order, waves rms; empty or 0: no change.

        Raises:
            UserError: the aperture is not circular ("jinc"), or there are not as many finite coefficients as terms.
        """
        if not any(coefficients):
            return self
        names = {pattern.name for pattern in self.patterns}
        if names != {"jinc"}:
            raise UserError(
                f"The pupil has aberrations, and beam patterns {', '.join(sorted(names))}; only those of circular "
                'apertures, "jinc", can have them.'
            )
        bent = (aberrated_pattern(tuple(coefficients), one.size).scaled(one.gain) for one in self.patterns)
        return self.patterned(tuple(bent))

    def patterned(self, patterns: tuple[Pattern, ...]) -> Self:
        """Return beams of other patterns, one for each detector or one for all, on the same axis."""
        return replace(self, patterns=patterns)

    def combined(self, matrix: F64 | C128) -> Self:
        """Return the beams of channels that are `matrix` times these, shape (channels, channels).

        If the result mixes no detectors, because the matrix is diagonal or inverts a hybrid, the beams are `scaled`.
        Entries and imaginary parts below 1e-6 (-120 dB) of the greatest one are rounding of complex64 samples: 0.
        """
        product = matrix if self.matrix is None else matrix @ self.matrix
        least = 1e-6 * np.abs(product).max()
        kept = np.where(np.abs(product) > least, product, 0)
        matrix = kept if np.any(np.abs(kept.imag) > least) else kept.real
        mixed = np.any(matrix != np.diag(np.diag(matrix)))
        return replace(self, matrix=matrix) if mixed else replace(self, matrix=None).scaled(np.diag(matrix))

    def detectors(self, indices: Index) -> Self:
        """Return the beams of some detectors, in increasing order and on the same axis.

        Raises:
            UserError: the channels are mixtures of detectors.
        """
        if self.matrix is not None:
            raise UserError("The channels are mixtures of detectors; single detectors cannot be picked from them.")
        patterns = self.patterns if len(self.patterns) == 1 else tuple(self.patterns[i] for i in indices)
        return replace(self, patterns=patterns, boresights=self.boresights[indices], middle=self.axis_middle)

    def pair(self, lower: int) -> Self:
        """Return the beams of detectors `lower` and `lower` + 1, on the same axis; errors as in `detectors`."""
        return self.detectors(np.array([lower, lower + 1]))

    @property
    def beamwidth_beside(self) -> float:
        """Beamwidth across the detector axis, rad."""
        return self.beamwidth if self.azimuth_beamwidth is None else self.azimuth_beamwidth

    @property
    def track_beamwidth(self) -> float:
        """Beamwidth along the flight, rad.

        With the detector axis turned by psi it is the half width of the ellipse with the axes beamwidth and
        beamwidth_beside: sqrt((beamwidth sin psi)^2 + (beamwidth_beside cos psi)^2).
        """
        along, beside = (width * width for width in (self.beamwidth, self.beamwidth_beside))
        return math.sqrt(beside + (along - beside) * math.sin(self.rotation) ** 2)  # exact where both are equal

    @property
    def count(self) -> int:
        """Number of detectors."""
        return self.boresights.size

    @cached_property
    def is_complex(self) -> bool:
        """True if `response` is complex, so that estimators need the phases between channels (`looks.covariance`)."""
        return np.iscomplexobj(self.response(self.domain(0.0)[0], 0.0))

    @property
    def span(self) -> tuple[float, float]:
        """Angles of the first and the last boresight (rad)."""
        return float(self.boresights[0]), float(self.boresights[-1])

    def domain(self, guard: float) -> tuple[float, float]:
        """Return the elevations (rad) of the search: the span of the boresights, half a pitch and `guard` (rad) more.

        The interval ends earlier where the pattern of a detector is not known.

        Raises:
            UserError: no elevation lies within the patterns of all detectors.
        """
        first, last = self.span
        margin = (last - first) / max(1, self.count - 1) / 2 + guard
        low, high = self.known
        return max(first - margin, low), min(last + margin, high)

    @property
    def known(self) -> tuple[float, float]:
        """Angles along the axis (rad) between which the patterns of all detectors are known.

        Raises:
            UserError: there is no such angle.
        """
        ends = np.array([pattern.domain for pattern in self.patterns]) * self.beamwidth
        low, high = float(np.max(self.boresights + ends[:, 0])), float(np.min(self.boresights + ends[:, 1]))
        if low > high:
            raise UserError(
                f"The patterns of the {self.count} detectors have no elevation in common: they must overlap."
            )
        return low, high

    @property
    def mean_aspect(self) -> float:
        """Mean of the aspects with their weights, rad."""
        return float(np.average(self.aspects, weights=self.weights))

    @property
    def axis_middle(self) -> float:
        """Point of the axis about which it is turned, rad from nadir."""
        return float(np.mean(self.span)) if self.middle is None else self.middle

    def _in_channels(self, function: Callable[[F64, F64], F64], elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
        """Return the mean over the aspects of a function of the offsets from the boresights, in the channels."""
        seen = (function(*self._offsets(elevation, np.asarray(squint) + aspect)) for aspect in self.aspects.tolist())
        weighted = (weight * value for weight, value in zip(self.weights.tolist(), seen, strict=True))
        mean = reduce(np.add, weighted)
        return mean if self.matrix is None else np.asarray(mean @ self.matrix.T)

    def _amplitude(self, e: F64, a: F64) -> F64:
        return self._by_detector([pattern.amplitude for pattern in self.patterns], e, a)

    def _slope(self, e: F64, a: F64) -> F64:
        along = self._by_detector([pattern.slope for pattern in self.patterns], e, a)
        if self.rotation:
            beside = self._by_detector([pattern.azimuth_slope for pattern in self.patterns], e, a)
            beside = beside * (self.beamwidth / self.beamwidth_beside)
            along = along * math.cos(self.rotation) - beside * math.sin(self.rotation)
        return along / self.beamwidth

    def _by_detector(self, functions: list[Callable[..., F64]], e: F64, a: F64) -> F64:
        if len(functions) == 1:
            return functions[0](e, a)
        e, a = np.broadcast_arrays(e, a)
        return np.stack([function(e[..., i], a[..., i]) for i, function in enumerate(functions)], axis=-1)

    def _offsets(self, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> tuple[F64, F64]:
        """Return the offsets from each boresight in beamwidths, along and across the detector axis."""
        x, y = np.asarray(elevation)[..., None] - self.axis_middle, np.asarray(squint)[..., None]
        cosine, sine = math.cos(self.rotation), math.sin(self.rotation)
        e = (x * cosine + y * sine - (self.boresights - self.axis_middle)) / self.beamwidth  # differences first: exact
        a = (y * cosine - x * sine) / self.beamwidth_beside
        return e, a


def column_squint(grid: Grid, aperture: ApertureState, beams: Beams, look_side: int) -> F64:
    """Return the squint (rad) of each column of an image, shape (cols,).

    It is computed at the image's middle row, for a target in the middle of the beams. Other rows of a column have the
    same Doppler but another elevation, hence a slightly different squint, which is neglected.
    """
    points = grid.points((grid.rows - 1) / 2, np.arange(grid.cols))
    sight = points - aperture_at(points, aperture).position
    cone = sight @ aperture.direction / np.linalg.norm(sight, axis=-1)
    return squint_on_cone(np.mean(beams.span), cone, aperture, look_side)
