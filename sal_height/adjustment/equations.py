"""Sparse linear least squares: linear forms of unknowns, equations with an information matrix, and their solution.

Unknowns have numbers, with gaps: they are added and removed with the dwells of a flight. Before they are removed, the
information of their equations on the others is kept (`without`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from sal_height.numeric import F64, Index


@dataclass(frozen=True, eq=False)
class Form:
    """Numbers that depend linearly on the unknowns: values x[columns] + constant.

    Attributes:
        columns: numbers of the unknowns, shape (terms,).
        values: factors of the unknowns, shape (numbers, terms).
        constant: constant part, shape (numbers,).
    """

    columns: Index
    values: F64
    constant: F64

    def minus(self, others: Sequence[tuple[float, Form]]) -> Form:
        """This form less a weighted sum of others."""
        columns = np.concatenate([self.columns, *(form.columns for _, form in others)])
        values = np.hstack([self.values, *(-weight * form.values for weight, form in others)])
        constant = self.constant - sum((weight * form.constant for weight, form in others), np.zeros(1))
        return Form(columns, values, constant)

    def equals(self, right: F64, information: F64) -> Equation:
        """The equation that sets the form equal to a right side, with its information."""
        return Equation(self.columns, self.values, right - self.constant, information)


def mean_form(weights: Mapping[int, float], forms: Mapping[int, Form]) -> Form:
    """The weighted mean of some forms of three numbers, by their own numbers; numbers below 0 stand for a form of 0."""
    zero = Form(np.empty(0, np.int64), np.empty((3, 0)), np.zeros(3))
    return zero.minus([(-weight, forms[number]) for number, weight in weights.items() if number >= 0])


@dataclass(frozen=True, eq=False)
class Equation:
    """values x[columns] = right, but for an error whose inverse covariance is `information`, positive definite."""

    columns: Index
    values: F64
    right: F64
    information: F64

    @cached_property
    def whitened(self) -> tuple[Index, F64, F64]:
        """The same number of equations with independent errors of variance 1: unknowns, values and right sides.

        Unknowns and values are those of one equation after the other.
        """
        root = np.linalg.cholesky(self.information).T
        return np.tile(self.columns, len(self.right)), (root @ self.values).ravel(), root @ self.right


class System:
    """Equations whose errors are made independent and of variance 1, ready to be solved with changing weights."""

    def __init__(self, equations: Sequence[Equation]) -> None:
        """Stores equations that determine all of their unknowns."""
        rows, values, self.columns, self._right = _whitened(equations)
        self._sizes = np.array([len(one.right) for one in equations])
        self._matrix = csr_array((values, rows), (len(self._right), len(self.columns)))

    def solved(self, weights: F64) -> Solution:
        """Solves for the unknowns that fit best, with a weight of each equation."""
        return Solution(self.columns, self._matrix, np.repeat(weights, self._sizes), self._right)

    def mismatches(self, solution: Solution) -> F64:
        """Square of the error of each equation over its variance."""
        errors = (self._matrix @ solution.of(self.columns) - self._right) ** 2
        return np.add.reduceat(errors, np.append(0, np.cumsum(self._sizes)[:-1]))


def _whitened(equations: Sequence[Equation]) -> tuple[tuple[Index, Index], F64, Index, F64]:
    """Scales equations to independent errors of variance 1.

    Returns:
        Rows and columns of all entries, the entries, the number of the unknown of each column, and the right sides.
    """
    numbers, values, right = map(np.concatenate, zip(*(one.whitened for one in equations), strict=True))
    lengths = np.repeat([len(one.columns) for one in equations], [len(one.right) for one in equations])
    columns, indices = np.unique(numbers, return_inverse=True)
    return (np.repeat(np.arange(len(right)), lengths), indices), values, columns, right


def without(equations: Sequence[Equation], gone: Index) -> list[Equation]:
    """Eliminates unknowns: the information of their equations on the others becomes one equation.

    By a triangular decomposition whose first columns are these unknowns: the rows after them are free of them (Bierman,
    Factorization Methods for Discrete Sequential Estimation, 1977, chapter II).
    """
    has_gone = [bool(np.isin(one.columns, gone).any()) for one in equations]
    if not any(has_gone):
        return list(equations)
    (rows, indices), values, columns, right = _whitened(
        [one for one, has in zip(equations, has_gone, strict=True) if has]
    )
    stays = ~np.isin(columns, gone)
    order = np.argsort(stays, kind="stable")
    dense = np.zeros((len(right), len(columns) + 1))
    np.add.at(dense, (rows, np.argsort(order)[indices]), values)
    dense[:, -1] = right
    triangle = np.asarray(np.linalg.qr(dense, mode="r"))
    first, count = int(np.count_nonzero(~stays)), int(np.count_nonzero(stays))
    left = triangle[first : first + count]
    others = [one for one, has in zip(equations, has_gone, strict=True) if not has]
    if not left.size:
        return others
    return [*others, Equation(columns[stays], left[:, first:-1], left[:, -1], np.eye(len(left)))]


class Solution:
    """Unknowns that fit all equations best, and their covariance."""

    def __init__(self, columns: Index, matrix: csr_array, weights: F64, right: F64) -> None:
        """Solves equations of variance 1 with a weight of each row; `columns`: number of the unknown of each column."""
        weighed = csr_array(matrix.multiply(weights[:, None]))
        normal = csc_array(matrix.T @ weighed)
        # Unknowns of very different units: each in units in which its own equation has the factor 1.
        scale = 1 / np.sqrt(normal.diagonal())
        scaled = csc_array(normal.multiply(scale[:, None]).multiply(scale[None, :]))
        symmetric = {"SymmetricMode": True}
        self._solver = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
        self._columns, self._scale = columns, scale
        self._unknowns = scale * self._solver.solve(scale * (weighed.T @ right))

    def of(self, columns: Index) -> F64:
        """The unknowns with these numbers."""
        return np.asarray(self._unknowns[np.searchsorted(self._columns, columns)])

    def at(self, form: Form) -> F64:
        """The numbers of a form."""
        return np.asarray(form.values @ self.of(form.columns) + form.constant)

    def mismatch(self, equation: Equation) -> float:
        """Square of the error of an equation over its variance."""
        error = equation.values @ self.of(equation.columns) - equation.right
        return float(error @ equation.information @ error)

    def covariance(self, forms: Sequence[Form]) -> list[F64]:
        """Covariance of the numbers of each form; all forms have the same number of them."""
        found: list[F64] = []
        size = len(forms[0].constant)
        at_once = max(1, 512 // size)  # of 512 right sides, which bounds memory
        for first in range(0, len(forms), at_once):
            part = forms[first : first + at_once]
            rows = np.repeat(np.arange(size * len(part)), [len(form.columns) for form in part for _ in range(size)])
            columns = np.searchsorted(self._columns, np.concatenate([np.tile(form.columns, size) for form in part]))
            values = np.concatenate([form.values.ravel() for form in part])
            sides = csr_array((values * self._scale[columns], (rows, columns)), (size * len(part), len(self._scale)))
            solved = self._solver.solve(sides.toarray().T)
            for number in range(len(part)):
                own = slice(size * number, size * (number + 1))
                found.append(np.asarray(sides[own] @ solved[:, own]))
        return found
