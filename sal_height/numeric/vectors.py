"""Vectors of three numbers within compiled loops."""

from __future__ import annotations

from sal_height.numeric.arrays import F64
from sal_height.numeric.jit import inlined

Vector = tuple[float, float, float]


@inlined
def vector(numbers: F64) -> Vector:
    """The vector of an array of three numbers."""
    return numbers[0], numbers[1], numbers[2]


@inlined
def dot(one: Vector, other: Vector) -> float:
    """Scalar product."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@inlined
def cross(one: Vector, other: Vector) -> Vector:
    """Vector product."""
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


@inlined
def total(one: float, first: Vector, other: float, second: Vector) -> Vector:
    """The sum of `one` times the first vector and `other` times the second."""
    return (
        one * first[0] + other * second[0],
        one * first[1] + other * second[1],
        one * first[2] + other * second[2],
    )
