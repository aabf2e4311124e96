"""Phases and positions of passes against each other, from bright points of unknown height.

Pass p of point i has the phase

    psi_ip = phi_p(e_i) + c_i + b_p + k (l_p(x_i) - l_p(x_0)) d_p

phi_p the response (`array`), c_i the phase of the point, b_p a phase of the pass, l_p the line of sight, d_p an error
of position of its antenna across that of the middle x_0. Unknown are b, d and, for each point, e and c. Adding the
phases of one height to all b_p raises all points alike: that offset is the gauge. Points of known height fix it;
without them the median height of the points is that of the ground. A common tilt of all points can be separated from
position errors only through their prior.

The solution is one of least squares. It starts from the best of several bright points as anchors: at the phases of one
of them, each other point has the elevation at which most of its power is in phase.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.elevation import AMBIGUOUS_RATIO
from sal_height.errors import UserError
from sal_height.numeric import C64, C128, F64, MEDIAN_ERROR, Bool, ShortRepr, vertex
from sal_height.passes.array import PassArray, Steering
from sal_height.passes.boxes import Box, Registered, brightest
from sal_height.passes.settings import PassSettings

LEAST_TIES = 5
"""Least number of points that agree."""

ROUNDS = 25
"""Number of times that phases and elevations are adjusted in turn."""

LEAST_AGREEMENT = 0.7
"""Least fraction of the power of a point in phase for it to tie."""

FIXED = 1e9
"""Weight that fixes undetermined parameters."""

CONFUSED = np.log(AMBIGUOUS_RATIO)
"""Least log-likelihood ratio of points of known height being in phase there, against another height."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Bright points that may tie the passes.

    Attributes:
        samples: samples of the passes, shape (points, passes), amplitudes of the background.
        positions: positions of their pixels in map, shape (points, 3), m.
        coefficients: coefficients of the phases about each, as in `Steering`, shape (points, passes, n).
        elevations: elevations at which the coefficients are 0, (points,), rad.
        beamwidths: beamwidths, (points,), rad.
        known: offset of a point of known height, NaN for others, (points,), beamwidths.
        known_sigma: standard deviation of that, beamwidths.
    """

    samples: C128
    positions: F64
    coefficients: F64
    elevations: F64
    beamwidths: F64
    known: F64
    known_sigma: F64

    @classmethod
    def of(cls, seen: Registered, settings: PassSettings) -> Self:
        """The brightest points of the images on the ground that all passes see.

        Raises:
            UserError: too few points are bright.
        """
        found: list[tuple[float, C128, F64, Steering]] = []
        for box, image in zip(seen.boxes, seen.images, strict=True):
            bright, margin = _bright_in(box, image, settings), settings.tie_reach_m
            found += [one for one in bright if seen.lattice.covers(one[2][None], margin)[0]]
        if len(found) < LEAST_TIES:
            raise UserError(
                f"The scene has {len(found)} points that all passes see {settings.least_power_db:g} dB above the "
                f"background; {LEAST_TIES} are needed to tie the phases of the passes: a larger side_m or a lower "
                "least_power_db finds more."
            )
        found.sort(key=lambda one: -one[0])
        _, samples, positions, steering = zip(*found[: settings.most_ties], strict=True)
        nowhere = np.full(len(samples), np.nan)
        return cls(
            np.array(samples, np.complex128),
            np.array(positions),
            np.array([one.coefficients for one in steering]),
            np.array([one.elevation for one in steering]),
            np.array([one.beamwidth for one in steering]),
            nowhere,
            nowhere,
        )

    def of_points(self, some: Bool) -> Candidates:
        """Some of the points."""
        return Candidates(**{name: values[some] for name, values in vars(self).items()})

    def of_passes(self, some: Bool) -> Candidates:
        """The points in some of the passes."""
        return replace(self, samples=self.samples[:, some], coefficients=self.coefficients[:, some])

    @property
    def power(self) -> F64:
        """Mean over the passes, over the background, (points,)."""
        return np.asarray(np.mean(np.abs(self.samples) ** 2, axis=1))

    def phases(self, offset: F64) -> F64:
        """Phases (rad) at one offset of each point (beamwidths), shape (points, passes)."""
        powers = offset[:, None] ** np.arange(self.coefficients.shape[2])
        return np.einsum("ipn,in->ip", self.coefficients, powers)

    def slopes(self, offset: F64) -> F64:
        """Their derivatives, rad per beamwidth."""
        number = np.arange(1, self.coefficients.shape[2])
        return np.einsum("ipn,in->ip", self.coefficients[..., 1:], number * offset[:, None] ** (number - 1))

    def in_phase(self, turned: C128, offsets: F64) -> F64:
        """Power of each point, sum over the passes, that is in phase at offsets, (points, offsets).

        Args:
            turned: samples without the phases of the passes, (points, passes).
            offsets: offsets of each point, (points, offsets), beamwidths.
        """
        powers = offsets[..., None] ** np.arange(self.coefficients.shape[2])
        phases = np.einsum("ipn,ijn->ijp", self.coefficients, powers)
        found = np.abs(np.einsum("ijp,ip->ij", np.exp(-1j * phases), turned)) ** 2
        return np.asarray(found / turned.shape[1])

    def best_offsets(self, turned: C128, reach: F64) -> tuple[F64, F64]:
        """Offsets (beamwidths) at which most of each point's power is in phase, and its fraction; both (points,).

        Args:
            turned: samples without the phases of the passes, (points, passes).
            reach: largest offset to each side, (points,), beamwidths.
        """
        steps = np.linspace(-1.0, 1.0, 2 * int(np.ceil(reach.max() / 0.1)) + 1)  # a tenth of a beamwidth
        offsets = reach[:, None] * steps
        share = self.in_phase(turned, offsets) / np.sum(np.abs(turned) ** 2, axis=1)[:, None]
        at = np.clip(np.argmax(share, axis=1), 1, len(steps) - 2)
        every = np.arange(len(at))
        off, _ = vertex(share[every, at - 1], share[every, at], share[every, at + 1])
        return offsets[every, at] + off * reach * (steps[1] - steps[0]), share[every, at]


def _bright_in(box: Box, image: C64, settings: PassSettings) -> list[tuple[float, C128, F64, Steering]]:
    power = np.mean(np.abs(image) ** 2, axis=0)
    rows, cols = brightest(power, box, 10 ** (settings.least_power_db / 10))
    found = []
    for row, col in zip(rows, cols, strict=True):
        samples = image[:, round(row), round(col)]
        each = np.abs(samples) ** 2
        # A point that has faded in a pass has a random phase there.
        if np.all(np.isfinite(samples)) and each.min() >= 0.05 * each.mean():
            found.append((float(each.mean()), samples.astype(np.complex128), box.grid.points(row, col), box.steering))
    return found


@dataclass(frozen=True, eq=False)
class Tie(ShortRepr):
    """Phases and positions of the passes.

    Attributes:
        phase: phase of each pass, shape (passes,), rad.
        offset: error of position of each across the line of sight, along the flight and upwards, (passes, 2), m.
        covariance: covariance of phases, then of offsets, shape (3 passes, 3 passes), without the gauge.
        uncertainty: root mean square of the relative error of a point's amplitude in a pass, in addition to noise.
        coherence: fraction of the power of the points that each pass has in the phase of the others, (passes,).
        points: number of points that tie.
        references: number of points of known height among them.
        positions: positions of the points in map, (points, 3), m.
        range_sigma: standard deviation of the range that all points share, as the images are aligned to the median of
            the passes' errors along the line of sight, which phases cannot correct, m.
        elsewhere: other height of all points that fits those of known height as well, which are not used then; NaN:
            these determine the height, m.
    """

    phase: F64
    offset: F64
    covariance: F64
    uncertainty: float
    coherence: F64
    points: int
    references: int
    positions: F64
    range_sigma: float = 0.0
    elsewhere: float = np.nan

    def placed(self, array: PassArray) -> tuple[PassArray, Tie]:
        """The passes with their antennas at the estimated positions, and the tie with the remaining phases."""
        moved = self.offset @ array.axes[1:]
        sight = array.centre - array.middles
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        # An antenna that is nearer by d to the middle of the scene adds k d.
        phase = self.phase - array.wavenumbers * np.sum(sight * moved, axis=-1)
        return array.moved(moved), replace(self, phase=phase)

    def variance(self, point: F64, slope: F64, array: PassArray) -> float:
        """Variance that the tie adds to the offset of a point, beamwidths squared; points near each other share it.

        Args:
            point: point in map, shape (3,), m.
            slope: slope of the phases there, (passes,), rad per beamwidth.
            array: passes.
        """
        turning = slope - slope.mean()
        pull = turning / np.sum(turning**2)
        by = np.concatenate([pull, (pull[:, None] * sensitivity(array, point[None])[0]).ravel()])
        return float(by @ self.covariance @ by)


def sensitivity(array: PassArray, points: F64) -> F64:
    """Phase (rad) that an error of position of a pass adds, per m along the flight and upwards, (points, passes, 2)."""

    def sight(point: F64) -> F64:
        line = point[..., None, :] - array.middles
        return np.asarray(line / np.linalg.norm(line, axis=-1, keepdims=True))

    turned = sight(points) - sight(array.centre)
    return array.wavenumbers[:, None] * (turned @ array.axes[1:].T)


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """State of the adjustment: phases, offsets of the antennas, and of each point its offset in elevation."""

    phase: F64
    offset: F64
    elevation: F64

    def turned(self, points: Candidates, sensitive: F64) -> C128:
        """Samples without the phases of the passes."""
        return points.samples * np.exp(-1j * (self.phase + np.einsum("ipn,pn->ip", sensitive, self.offset)))


def loosest(points: Candidates, array: PassArray, settings: PassSettings) -> tuple[int, float, int]:
    """The least coherent pass, its coherence over the median of all, and the number of points.

    One pass of random phases makes points disagree that otherwise tie; so it is searched before these are chosen, on
    all points that are in phase in most passes, with 0.4 of their power.
    """
    sensitive, reach = sensitivity(array, points.positions), _reach(points, array, settings)
    state, share = _by_turns(_anchored(points, reach), points, sensitive, reach, settings)
    some = share >= 0.4
    turned = state.turned(points, sensitive) * np.exp(-1j * points.phases(state.elevation))
    coherence = _coherences(turned[some])
    return int(np.argmin(coherence)), float(coherence.min() / np.median(coherence)), int(some.sum())


def _reach(points: Candidates, array: PassArray, settings: PassSettings) -> F64:
    """Largest offsets of the elevation of each point, (points,), beamwidths."""
    return settings.tie_reach_m / _climb(points, array)


def _climb(points: Candidates, array: PassArray) -> F64:
    """Height for a beamwidth of elevation, m, (points,)."""
    return np.asarray(array.seen(points.positions)[0] * points.beamwidths * np.sin(points.elevations))


def tie_passes(points: Candidates, array: PassArray, settings: PassSettings) -> Tie:
    """Tie the passes by bright points; those of known height are not used if ambiguous (`Tie.elsewhere`).

    Raises:
        UserError: too few points agree.
    """
    sensitive = sensitivity(array, points.positions)
    reach = _reach(points, array, settings)
    state, _ = _by_turns(_anchored(points, reach), points, sensitive, reach, settings)
    if np.any(np.isfinite(points.known)):
        state = _levelled(state, points, sensitive, reach)
    _, share = points.best_offsets(state.turned(points, sensitive), reach)
    state, covariance, agree = _agreed(state, points, sensitive, share >= LEAST_AGREEMENT, settings)
    kept, references = points.of_points(agree), np.isfinite(points.known[agree])
    turned = state.turned(points, sensitive)[agree] * np.exp(-1j * kept.phases(state.elevation[agree]))
    uncertainty = _uncertainty(turned)
    if not references.any():
        state = _on_ground(state, points, agree, array, settings)
    elif np.isfinite(rival := _rival(state, kept.of_points(references), array, settings, uncertainty)):
        free = replace(points, known=np.full(len(points.known), np.nan))
        return replace(tie_passes(free, array, settings), elsewhere=rival)
    return Tie(
        state.phase,
        state.offset,
        covariance,
        uncertainty,
        _coherences(turned),
        int(agree.sum()),
        int(references.sum()),
        kept.positions,
        MEDIAN_ERROR * settings.position_sigma_m / np.sqrt(len(array.passes)),
    )


def _agreed(
    state: _Adjusted, points: Candidates, sensitive: F64, agree: Bool, settings: PassSettings
) -> tuple[_Adjusted, F64, Bool]:
    """The solution of least squares by the points that agree, its covariance, and which points these are.

    Two scatterers in a pixel can be nearly in phase as one; their residuals are larger than the usual errors of points
    in addition to noise, as long as most are single.

    Raises:
        UserError: too few agree.
    """
    agree, error = agree.copy(), 0.3  # rad, at first
    for _ in range(ROUNDS):
        if agree.sum() < LEAST_TIES:
            raise UserError(
                f"Of {len(points.samples)} bright points {int(agree.sum())} agree on the phases of the passes; "
                f"{LEAST_TIES} are needed."
            )
        kept, of_kept = points.of_points(agree), sensitive[agree]
        part = replace(state, elevation=state.elevation[agree])
        for _ in range(3):
            part, covariance, residual, _ = _solved(part, kept, of_kept, error, settings)
        elevation = state.elevation.copy()
        elevation[agree] = part.elevation
        state = replace(part, elevation=elevation)
        # Error of points in addition to noise, in the median; 0.02 rad at least, as no target is exactly a point.
        passes = residual.shape[1]
        free = passes - 2 - 3 * (passes - 1) / len(residual)
        noise = 0.5 / np.maximum(np.abs(kept.samples) ** 2, 1e-6)
        excess = np.sum(residual**2, axis=1) / max(free, 0.5) - noise.mean(axis=1)
        settled = np.sqrt(max(0.02**2, float(np.median(excess))))
        off = np.mean(residual**2 / (noise + settled**2), axis=1) > 3
        if not off.any() and abs(settled - error) < 0.1 * error:
            break
        error = settled
        agree[np.flatnonzero(agree)[off]] = False
    return state, covariance, agree


def _anchored(points: Candidates, reach: F64) -> _Adjusted:
    """The phases of that of the 20 brightest points at which most of the others' power is in phase."""
    best = -1.0, 0
    for number in range(min(20, len(points.samples))):
        anchor = points.samples[number] / np.abs(points.samples[number])
        _, share = points.best_offsets(points.samples * anchor.conj(), reach)
        best = max(best, (float(np.sum(share)), number))
    phase = np.angle(points.samples[best[1]])
    offset, _ = points.best_offsets(points.samples * np.exp(-1j * phase), reach)
    return _Adjusted(phase, np.zeros((len(phase), 2)), offset)


def _by_turns(
    state: _Adjusted, points: Candidates, sensitive: F64, reach: F64, settings: PassSettings
) -> tuple[_Adjusted, F64]:
    """Adjust phases to elevations, and elevations to phases, in turn until they converge."""
    share = np.zeros(len(points.samples))
    for _ in range(ROUNDS):
        offset, share = points.best_offsets(state.turned(points, sensitive), reach)
        state = replace(state, elevation=offset)
        some = share >= min(LEAST_AGREEMENT, float(np.median(share)))
        part = replace(state, elevation=offset[some])
        free = replace(points.of_points(some), known=np.full(int(some.sum()), np.nan))
        part, *_ = _solved(part, free, sensitive[some], 0.3, settings)
        moved = float(np.abs(part.phase - state.phase).max())
        state = replace(part, elevation=offset)
        if moved < 1e-4:
            break
    return state, share


def _solved(
    state: _Adjusted, points: Candidates, sensitive: F64, error: float, settings: PassSettings
) -> tuple[_Adjusted, F64, F64, F64]:
    """One step of Gauss and Newton.

    Args:
        state: state before the step.
        points: points that tie.
        sensitive: sensitivity at these (`sensitivity`), rad/m.
        error: standard deviation of phases in addition to noise, rad.
        settings: settings with the prior of positions.

    Returns:
        The state after it, the covariance of phases and offsets, residuals (rad) and their weights (points, passes).
    """
    passes, slope = points.samples.shape[1], points.slopes(state.elevation)
    weight = 1 / (0.5 / np.maximum(np.abs(points.samples) ** 2, 1e-6) + error**2)
    turned = state.turned(points, sensitive) * np.exp(-1j * points.phases(state.elevation))
    mean = np.sum(weight * turned / np.abs(turned), axis=1, keepdims=True)
    residual = np.angle(turned * mean.conj())
    # Unknowns of the passes: phases, then offsets two by two.
    design = np.zeros((len(residual), passes, 3 * passes))
    every = np.arange(passes)
    design[:, every, every] = 1.0
    for axis in (0, 1):
        design[:, every, passes + 2 * every + axis] = sensitive[..., axis]
    # Of each point: phase and elevation, which are eliminated.
    own = np.stack([np.ones_like(slope), slope], axis=-1)
    known = np.isfinite(points.known)
    prior = np.where(known, 1 / np.where(known, points.known_sigma, 1.0) ** 2, 0.0)
    heavy = weight[..., None] * own
    inner = np.swapaxes(own, 1, 2) @ heavy
    inner[:, 1, 1] += prior
    pull = np.einsum("ipn,ip->in", heavy, residual)
    pull[:, 1] += prior * np.where(known, points.known - state.elevation, 0.0)
    cross = np.swapaxes(design, 1, 2) @ heavy
    through = cross @ np.linalg.inv(inner)
    normal = np.einsum("ipm,ip,ipn->mn", design, weight, design, optimize=True)
    normal -= np.einsum("imn,ikn->mk", through, cross)
    right = np.einsum("ipm,ip->m", design, weight * residual) - np.einsum("imn,in->m", through, pull)
    variance = max(settings.position_sigma_m, 1e-6) ** 2
    normal[passes:, passes:] += np.eye(2 * passes) / variance
    right[passes:] -= state.offset.ravel() / variance
    # The gauge: a phase that all passes share and, without known points, a height that all points share.
    fixed = [np.ones(passes)] + ([] if known.any() else [np.mean(slope - slope.mean(axis=1, keepdims=True), axis=0)])
    for vector in fixed:
        unit = vector / np.linalg.norm(vector)
        normal[:passes, :passes] += FIXED * np.outer(unit, unit)
    covariance = np.linalg.inv(normal)
    for vector in fixed:
        unit = vector / np.linalg.norm(vector)
        covariance[:passes, :passes] -= np.outer(unit, unit) / FIXED
    step = covariance @ right
    of_points = np.einsum("inm,im->in", np.linalg.inv(inner), pull - np.einsum("imn,m->in", cross, step))
    moved = _Adjusted(
        state.phase + step[:passes],
        state.offset + step[passes:].reshape(-1, 2),
        state.elevation + np.clip(of_points[:, 1], -0.5, 0.5),
    )
    left = residual - design @ step - np.einsum("ipn,in->ip", own, of_points)
    return moved, covariance, left, weight


def _levelled(state: _Adjusted, points: Candidates, sensitive: F64, reach: F64) -> _Adjusted:
    """The state raised so that most of the power of the points of known height is in phase at these heights."""
    known = np.isfinite(points.known)
    some = points.of_points(known)
    lifts = _lifts(reach)
    power = some.in_phase(state.turned(points, sensitive)[known], some.known[:, None] - lifts)
    share = power / np.sum(np.abs(some.samples) ** 2, axis=1)[:, None]
    return _lifted(state, points, float(lifts[np.argmax(share.sum(axis=0))]))


def _rival(state: _Adjusted, known: Candidates, array: PassArray, settings: PassSettings, uncertainty: float) -> float:
    """Other height of all points, relative to this one, that fits those of known height as well, m; NaN: none does.

    Errors of amplitudes, by `uncertainty`, count as noise.
    """
    lifts = _lifts(_reach(known, array, settings))
    power = known.in_phase(state.turned(known, sensitivity(array, known.positions)), known.known[:, None] - lifts)
    likelihood = np.sum(power / (1 + uncertainty**2 * known.power)[:, None], axis=0)
    here = np.abs(lifts) <= 0.5  # beamwidths: the same height
    elsewhere = np.where(here, -np.inf, likelihood)
    if likelihood[here].max() - elsewhere.max() >= CONFUSED:
        return np.nan
    return float(lifts[np.argmax(elsewhere)] * np.mean(_climb(known, array)))


def _lifts(reach: F64) -> F64:
    """Lifts of all points that are tried, beamwidths: from one end of their reach to the other."""
    most = float(reach.max())
    return np.arange(-2 * most, 2 * most, 0.05)


def _lifted(state: _Adjusted, points: Candidates, lift: float) -> _Adjusted:
    """The state with all points higher by `lift` (beamwidths), and phases that make it so."""
    added = points.phases(state.elevation) - points.phases(state.elevation + lift)
    change = np.median(added - added.mean(axis=1, keepdims=True), axis=0)
    return _Adjusted(state.phase + change, state.offset, state.elevation + lift)


def _on_ground(
    state: _Adjusted, points: Candidates, agree: Bool, array: PassArray, settings: PassSettings
) -> _Adjusted:
    """The state in which the median height of the points that tie is that of the ground."""
    metres = _climb(points, array)
    heights = points.positions[:, 2] + state.elevation * metres
    lift = settings.ground_m - float(np.median(heights[agree]))
    return _lifted(state, points, lift / float(np.median(metres)))


def _uncertainty(turned: C128) -> float:
    """Root mean square of the relative error of amplitudes in addition to noise, in the median over points.

    Args:
        turned: samples without the phases of passes and heights, (points, passes), amplitudes of the noise.
    """
    passes = turned.shape[1]
    explained = np.abs(turned.sum(axis=1)) ** 2 / passes
    left = np.sum(np.abs(turned) ** 2, axis=1) - explained
    free = passes - 1.5
    return float(np.sqrt(max(0.0, np.median((left / free - 1) / (explained / passes)))))


def _coherences(turned: C128) -> F64:
    """Fraction of each pass's power in the phase of the others, over points of equal weight, (passes,)."""
    unit = turned / np.sqrt(np.mean(np.abs(turned) ** 2, axis=1, keepdims=True))
    others = unit.sum(axis=1, keepdims=True) - unit
    phasor = unit * others.conj() / np.abs(others)
    return np.asarray(np.abs(np.mean(phasor, axis=0)) ** 2 / np.mean(np.abs(unit) ** 2, axis=0))
