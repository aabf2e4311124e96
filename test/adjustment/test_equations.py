"""Sparse least squares against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.adjustment.equations import Equation, Form, System, mean_form, without

COUNT = 30


def equations(rng: np.random.Generator) -> list[Equation]:
    """Each unknown is known by itself, in units from 1e-9 to 1e3, and some by others."""
    scales = 10.0 ** rng.uniform(-9, 3, COUNT)
    alone = [Equation(np.array([n]), np.eye(1), scales[n : n + 1], np.array([[scales[n] ** -2]])) for n in range(COUNT)]
    shared = []
    for _ in range(60):
        columns = rng.choice(COUNT, 4, replace=False)
        values = rng.standard_normal((2, 4)) / scales[columns]
        root = rng.standard_normal((2, 2))
        shared.append(Equation(columns, values, rng.standard_normal(2), root @ root.T + np.eye(2)))
    return alone + shared


def dense(told: list[Equation], weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right side."""
    normal, right = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for equation, weight in zip(told, weights, strict=True):
        full = np.zeros((len(equation.right), COUNT))
        full[:, equation.columns] = equation.values
        normal += weight * full.T @ equation.information @ full
        right += weight * full.T @ equation.information @ equation.right
    return normal, right


def test_solution_and_covariance_are_those_of_dense_algebra() -> None:
    rng = np.random.default_rng(1)
    told, weights = equations(rng), np.ones(90)
    weights[::7] = 0.2
    normal, right = dense(told, weights)
    solution = System(told).solved(weights)
    scale = 1 / np.sqrt(np.diag(normal))
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
    np.testing.assert_allclose(solution.of(np.arange(COUNT)), inverse @ right, rtol=1e-8)

    forms = [Form(np.array([3, 7, 7]), rng.standard_normal((2, 3)), np.zeros(2)) for _ in range(600)]
    covariances = solution.covariance(forms)
    assert len(covariances) == 600
    for form, covariance in zip(forms[::100], covariances[::100], strict=True):
        full = np.zeros((2, COUNT))
        np.add.at(full, (slice(None), form.columns), form.values)
        np.testing.assert_allclose(covariance, full @ inverse @ full.T, rtol=1e-7)


def test_means_and_differences_of_forms() -> None:
    """Of three numbers each, whose unknowns have numbers with gaps."""
    one = Form(np.array([0, 10]), np.tile([1.0, 2.0], (3, 1)), np.full(3, 3.0))
    two = Form(np.array([10, 25]), np.tile([4.0, 5.0], (3, 1)), np.full(3, 6.0))
    columns, unknowns = np.array([0, 10, 25]), np.array([1.0, 10.0, 100.0])
    exact = Equation(columns, np.eye(3), unknowns, 1e12 * np.eye(3))
    solution = System([exact]).solved(np.ones(1))
    assert solution.at(one) == pytest.approx(np.full(3, 24.0))
    assert solution.at(one.minus([(0.5, two)])) == pytest.approx(np.full(3, 24.0 - 0.5 * 546.0))
    mean = mean_form({0: 0.25, 7: 0.75}, {0: one, 7: two})
    assert solution.at(mean) == pytest.approx(np.full(3, 0.25 * 24.0 + 0.75 * 546.0))
    assert solution.at(mean_form({-1: 1.0}, {0: one})) == pytest.approx(np.zeros(3))
    told = [one.equals(np.full(3, 10.0), np.eye(3)), two.equals(np.full(3, 556.0), 0.25 * np.eye(3))]
    system = System([exact, *told])
    found = system.mismatches(solution)
    np.testing.assert_allclose(found, [0.0, 3 * 14.0**2, 3 * 0.25 * 10.0**2], atol=1e-6)


@pytest.mark.parametrize("gone", [[3], [0, 4, 5, 17, 29], [99], list(range(COUNT - 1))])
def test_what_is_left_of_equations_says_the_same_of_the_others(gone: list[int]) -> None:
    """Values and covariance, as long as unknowns go one after the other."""
    told = equations(np.random.default_rng(3))
    stay = np.setdiff1d(np.arange(COUNT), gone)
    whole = System(told).solved(np.ones(len(told)))
    for some in np.array_split(np.array(gone), 2):
        told = without(told, some)
    left = System(told).solved(np.ones(len(told)))
    assert not np.isin(gone, np.concatenate([one.columns for one in told])).any()
    np.testing.assert_allclose(left.of(stay), whole.of(stay), rtol=1e-7)
    forms = [Form(np.array([number]), np.eye(1), np.zeros(1)) for number in stay]
    np.testing.assert_allclose(left.covariance(forms), whole.covariance(forms), rtol=1e-6)


def test_equations_without_any_unknown_that_goes_stay_as_they_are() -> None:
    told = equations(np.random.default_rng(3))
    assert without(told, np.array([COUNT])) == told
