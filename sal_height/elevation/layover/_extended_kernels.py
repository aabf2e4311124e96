"""Compiled loops of the fit of extended surfaces.

Each has a twin in plain NumPy in the tests. Matrices are real or complex, as the beams are; positions and spreads are
in steps of the table of unit responses, `SearchTables.unit_pieces`. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sal_height.elevation.array._beside_kernels import inner, multiply
from sal_height.elevation.layover._several_kernels import invert_positive, product, solve
from sal_height.numeric import F32, F64, Index, compiled

Numbers = npt.NDArray[Any]
Table = tuple[Numbers, F32, F64, F64, F64]
"""Pieces of unit responses and of |a|^2, at one squint or at all; for each quadrature the positions of its nodes (in
spreads) and their weights, (quadratures, nodes), those of few nodes first and padded with zeros; and the greatest
spread of each."""


class SurfacePrior(NamedTuple):
    """Prior density of surfaces: uniform over t and ln p within a range, and falling with a power of the spread.

    Attributes:
        position: range of t, steps of the table.
        spread: range of ln s.
        power: range of ln p.
        steepness: power of s with which the density of ln s falls.
        density: logarithm of the density of ln s over a uniform one, where s is one step of the table.
    """

    position: float
    spread: float
    power: float
    steepness: float
    density: float


GREATEST_STEPS = (0.5, 0.5, 1.0)  # of t over s, ln s and ln p
RIDGE = 1e-3  # added to the information of a look on each parameter, so that it can be inverted


@compiled
def climb_surfaces(
    matrices: Numbers,
    squints: Index,
    looks: F64,
    least: F64,
    tables: Table,
    spreads: tuple[float, float],
    prior: SurfacePrior,
    found: tuple[F64, F64, F64, F64],
) -> None:
    """Climb the likelihood of extended surfaces by Fisher's scoring; the best point passed is kept.

    Args:
        matrices: R, (pixels, M, M), double precision.
        squints: number of the squint of each pixel, (pixels,).
        looks: K, (pixels,).
        least: log-evidence of interest, (pixels,); the climb ends in pixels that seem unable to reach it.
        tables: unit responses at all squints, and the quadratures.
        spreads: least and greatest spread.
        prior: prior of the surfaces.
        found: t, s and p of the start, replaced by those of the maximum, (3, pixels); and to fill: the log-likelihood
            and the log-evidence, (pixels,), and the information there, (pixels, 3, 3).
    """
    surfaces, likelihoods, evidences, informations = found
    pieces, kind, count = tables[0], matrices.dtype, tables[2].shape[1]
    vectors, squares = np.empty((3, count, pieces.shape[3]), kind), np.empty((7, count, count), kind)
    place, gradient, information = np.empty(3), np.empty(3), np.empty((3, 3))
    damped, right, move = np.empty((3, 3)), np.empty(3), np.empty(3)
    last = float(pieces.shape[1])
    for i in range(len(matrices)):
        table = at_squint(tables, squints[i])
        for k in range(3):
            place[k] = surfaces[k, i]
        likelihoods[i] = -np.finfo(np.float64).max
        for step in range(12):  # few pixels need more than five; those of high CNR do
            likelihood = likelihood_at(matrices[i], looks[i], place, table, (vectors, squares), gradient, information)
            if likelihood > likelihoods[i]:
                likelihoods[i] = likelihood
                for k in range(3):
                    surfaces[k, i] = place[k]
                informations[i] = information
                evidences[i] = likelihood + occam_factor(information, place[1], prior, damped)
            damped[:] = information
            for k in range(3):
                damped[k, k] += RIDGE * looks[i]
            right[:] = gradient
            solve(damped, right, move)
            rise = gradient[0] * move[0] + gradient[1] * move[1] + gradient[2] * move[2]
            # A rise of 0.1 is not worth a step; the evidence to come is 60 / steps times the next rise at most.
            if not (rise > 0.1 and evidences[i] + 60.0 / (step + 1) * rise > least[i]):
                break
            for k in range(3):
                move[k] = min(max(move[k], -GREATEST_STEPS[k]), GREATEST_STEPS[k])
            place[0] += move[0] * place[1]
            place[1] = min(max(place[1] * np.exp(move[1]), spreads[0]), spreads[1])
            place[0] = min(max(place[0], -place[1]), last + place[1])
            place[2] *= np.exp(move[2])


@compiled
def occam_factor(information: F64, spread: float, prior: SurfacePrior, work: F64) -> float:
    """Logarithm of the fraction of the prior that looks with this information leave; see `order`. `work` is (3, 3)."""
    ranges = prior.position / spread, prior.spread, prior.power
    for k in range(3):
        for n in range(3):
            work[k, n] = information[k, n] * ranges[k] * ranges[n] / (2 * np.pi)
        work[k, k] += 1
    return prior.density - prior.steepness * np.log(spread) - 0.5 * invert_positive(work, 3)


@compiled
def likelihood_at(
    matrix: Numbers,
    looks: float,
    place: F64,
    table: Table,
    work: tuple[Numbers, Numbers],
    gradient: F64,
    information: F64,
) -> float:
    """Log-likelihood of a surface, and to fill: its gradient over t / s, ln s and ln p, and the information on these.

    With B of `extended`, its slopes T over t / s, and A = I + B^H B, C^-1 = I - B A^-1 B^H: all terms are products of
    the columns of B and T. The derivatives of C are T B^H + B T^H, the same with T diag(x), and B B^H.
    """
    vectors, squares = work
    responses, turns, outputs = vectors[0], vectors[1], vectors[2]
    inverse, seen, cross, along, rest = squares[0], squares[1], squares[2], squares[3], squares[4]
    rule, count = quadrature(place[1], table)
    nodes = table[2][rule]
    fill_responses(place, table, rule, responses[:count], turns[:count])
    for i in range(count):
        multiply(matrix, responses[i], outputs[i])
    for i in range(count):
        for j in range(count):
            cross[i, j] = inner(responses[i], turns[j])
            along[i, j] = inner(outputs[i], turns[j])
        for j in range(i + 1):
            inverse[i, j] = inner(responses[i], responses[j])
            seen[i, j] = inner(responses[i], outputs[j])
            rest[i, j] = inner(turns[i], turns[j])
            inverse[j, i] = np.conj(inverse[i, j])
            seen[j, i] = np.conj(seen[i, j])
            rest[j, i] = np.conj(rest[i, j])
        inverse[i, i] += 1
    logarithm = invert_positive(inverse, count)
    product(inverse, cross, squares[5], count)  # B^H C^-1 T
    product(seen, inverse, squares[6], count)  # B^H R C^-1 B
    subtract_product(cross, squares[5], rest, count)  # T^H C^-1 T
    explained = sum_up(looks, nodes[:count], squares, gradient, information)
    return explained - looks * logarithm


@compiled
def sum_up(looks: float, nodes: F64, squares: Numbers, gradient: F64, information: F64) -> float:
    """Gradient and information as sums of traces, from the products of `likelihood_at`; returns tr(R - C^-1 R)."""
    inverse, seen, along, rest = squares[0], squares[1], squares[3], squares[4]
    whitened, left = squares[5], squares[6]
    explained = 0.0
    gradient[:] = 0
    information[:] = 0
    for i in range(len(nodes)):
        by_node = -looks * whitened[i, i]
        gradient[2] -= looks
        for j in range(len(nodes)):
            explained += (inverse[i, j] * seen[j, i]).real
            by_node += inverse[i, j] * along[j, i] - np.conj(left[j, i]) * whitened[j, i]
            inside, across = -inverse[i, j], -inverse[j, i]  # B^H C^-1 B = I - A^-1
            if i == j:
                inside += 1
                across += 1
                gradient[2] += looks * inverse[i, i].real
            gradient[2] += (inverse[i, j] * left[j, i]).real
            both = (whitened[i, j] * whitened[j, i] + inside * rest[j, i]).real
            mixed = (inside * whitened[j, i]).real
            information[0, 0] += both
            information[0, 1] += nodes[j] * both
            information[1, 1] += nodes[i] * nodes[j] * both
            information[0, 2] += mixed
            information[1, 2] += nodes[i] * mixed
            information[2, 2] += 0.5 * (inside * across).real
        gradient[0] += 2 * by_node.real
        gradient[1] += 2 * nodes[i] * by_node.real
    for k in range(3):
        for n in range(k, 3):
            information[k, n] *= 2 * looks
            information[n, k] = information[k, n]
    return explained


@compiled
def quadrature(spread: float, table: Table) -> tuple[int, int]:
    """Number of the quadrature for a surface, and the number of its nodes."""
    weights, rule = table[3], 0
    while rule < len(weights) - 1 and spread > table[4][rule]:
        rule += 1
    count = 0
    while count < weights.shape[1] and weights[rule, count] > 0:
        count += 1
    return rule, count


@compiled
def fill_responses(place: F64, table: Table, rule: int, responses: Numbers, turns: Numbers) -> None:
    """Rows of B and of its slopes over t / s, (nodes, M), with the nodes of a quadrature; 0 beyond the table."""
    pieces, power, nodes, weights = table[0], table[1], table[2][rule], table[3][rule]
    last = len(pieces)
    for i in range(len(responses)):
        position = place[0] + place[1] * nodes[i]
        if position < 0 or position > last:
            responses[i] = 0
            turns[i] = 0
            continue
        node = min(int(position), last - 1)
        piece, cubic, t = pieces[node], power[node], position - node
        square = cubic[0] + t * (cubic[1] + t * (cubic[2] + t * cubic[3]))
        amplitude = np.sqrt(max(weights[i] * square * place[2], 0.0))
        turn = amplitude * place[1]
        for m in range(responses.shape[1]):
            responses[i, m] = amplitude * (piece[0, m] + t * (piece[1, m] + t * (piece[2, m] + t * piece[3, m])))
        for m in range(responses.shape[1]):
            turns[i, m] = turn * (piece[1, m] + t * (2 * piece[2, m] + 3 * t * piece[3, m]))


@compiled
def subtract_product(left: Numbers, right: Numbers, result: Numbers, count: int) -> None:
    """Subtract left^H right, of the first rows and columns."""
    for i in range(count):
        for k in range(count):
            factor = np.conj(left[k, i])
            for j in range(count):
                result[i, j] -= factor * right[k, j]


@compiled
def at_squint(tables: Table, squint: int) -> Table:
    """The tables with the unit responses at one squint."""
    return tables[0][squint], tables[1][squint], tables[2], tables[3], tables[4]


@compiled
def all_responses(surfaces: F64, squints: Index, tables: Table, responses: Numbers) -> None:
    """Rows of B of every pixel, (pixels, nodes, M), for t, s and p, (3, pixels); zeros where nodes are fewer.

    `squints` are the numbers of the pixels' squints, `tables` those of all squints.
    """
    turns, place = np.empty(responses.shape[1:], responses.dtype), np.empty(3)
    for i in range(len(responses)):
        for k in range(3):
            place[k] = surfaces[k, i]
        table = at_squint(tables, squints[i])
        rule, count = quadrature(place[1], table)
        fill_responses(place, table, rule, responses[i, :count], turns[:count])
        responses[i, count:] = 0
