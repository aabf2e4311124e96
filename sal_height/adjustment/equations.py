"""Sparse linear least squares: linear forms of unknowns, equations with an information matrix, and their solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from sal_height.numeric import F64, Index

COLUMNS = 512
"""Right sides that are solved at once."""


@dataclass(frozen=True, eq=False)
class Form:
    """Numbers that depend linearly on the unknowns: values x[columns] + constant.

    Attributes:
        columns: of the unknowns, shape (terms,).
        values: shape (numbers, terms).
        constant: shape (numbers,).
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

    def at(self, unknowns: F64) -> F64:
        """Its numbers."""
        return np.asarray(self.values @ unknowns[self.columns] + self.constant)

    def equals(self, right: F64, information: F64) -> Equation:
        """The equation by which it is so much."""
        return Equation(self.columns, self.values, right - self.constant, information)


def mean_form(shares: Mapping[int, float], forms: Sequence[Form]) -> Form:
    """The mean of some forms, by their numbers, with weights; numbers below 0 stand for nothing."""
    nothing = Form(np.empty(0, np.int64), np.empty((len(forms[0].constant), 0)), np.zeros(len(forms[0].constant)))
    return nothing.minus([(-share, forms[number]) for number, share in shares.items() if number >= 0])


@dataclass(frozen=True, eq=False)
class Equation:
    """values x[columns] = right, but for an error whose inverse covariance is `information`, positive definite."""

    columns: Index
    values: F64
    right: F64
    information: F64


class System:
    """Equations whose errors are made independent and of variance 1, ready to be solved with changing weights."""

    def __init__(self, equations: Sequence[Equation], count: int) -> None:
        """Take equations between `count` unknowns."""
        whitened = [np.linalg.cholesky(one.information).T for one in equations]
        values = [root @ one.values for root, one in zip(whitened, equations, strict=True)]
        sizes = np.array([len(one.right) for one in equations])
        lengths = np.repeat([len(one.columns) for one in equations], sizes)
        columns = np.concatenate([np.tile(one.columns, len(one.right)) for one in equations])
        entries = np.concatenate([block.ravel() for block in values])
        rows = np.repeat(np.arange(sizes.sum()), lengths)
        self.matrix = csr_array((entries, (rows, columns)), (int(sizes.sum()), count))
        self.right = np.concatenate([root @ one.right for root, one in zip(whitened, equations, strict=True)])
        self._sizes = sizes

    def solved(self, weights: F64) -> Solution:
        """The unknowns that fit best, with a weight of each equation."""
        each = np.repeat(weights, self._sizes)
        return Solution(self.matrix, each, self.right)

    def mismatches(self, unknowns: F64) -> F64:
        """Square of the error of each equation over what is expected."""
        errors = (self.matrix @ unknowns - self.right) ** 2
        return np.add.reduceat(errors, np.append(0, np.cumsum(self._sizes)[:-1]))


class Solution:
    """Unknowns that fit all equations best, and their covariance."""

    def __init__(self, matrix: csr_array, weights: F64, right: F64) -> None:
        """Solve equations of variance 1 with a weight of each row."""
        weighed = csr_array(matrix.multiply(weights[:, None]))
        normal = csc_array(matrix.T @ weighed)
        # Unknowns of very different units: each in units in which its own equation has the factor 1.
        scale = 1 / np.sqrt(normal.diagonal())
        scaled = csc_array(normal.multiply(scale[:, None]).multiply(scale[None, :]))
        symmetric = {"SymmetricMode": True}
        self._solver = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
        self._scale = scale
        self.unknowns = scale * self._solver.solve(scale * (weighed.T @ right))

    def covariance(self, forms: Sequence[Form]) -> list[F64]:
        """Covariance of the numbers of each form."""
        found: list[F64] = []
        size = len(forms[0].constant)
        for first in range(0, len(forms), max(1, COLUMNS // size)):
            part = forms[first : first + max(1, COLUMNS // size)]
            rows = np.repeat(np.arange(size * len(part)), [len(form.columns) for form in part for _ in range(size)])
            columns = np.concatenate([np.tile(form.columns, size) for form in part])
            values = np.concatenate([form.values.ravel() for form in part])
            sides = csr_array((values * self._scale[columns], (rows, columns)), (size * len(part), len(self._scale)))
            solved = self._solver.solve(sides.toarray().T)
            for number in range(len(part)):
                own = slice(size * number, size * (number + 1))
                found.append(np.asarray(sides[own] @ solved[:, own]))
        return found
