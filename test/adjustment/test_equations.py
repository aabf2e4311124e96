"""Sparse least squares against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.adjustment.equations import Equation, Form, System, mean_form

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
    system = System(told, COUNT)
    solution = system.solved(weights)
    scale = 1 / np.sqrt(np.diag(normal))
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
    np.testing.assert_allclose(solution.unknowns, inverse @ right, rtol=1e-8)

    forms = [Form(np.array([3, 7, 7]), rng.standard_normal((2, 3)), np.zeros(2)) for _ in range(600)]
    covariances = solution.covariance(forms)
    assert len(covariances) == 600
    for form, covariance in zip(forms[::100], covariances[::100], strict=True):
        full = np.zeros((2, COUNT))
        np.add.at(full, (slice(None), form.columns), form.values)
        np.testing.assert_allclose(covariance, full @ inverse @ full.T, rtol=1e-7)


def test_means_and_differences_of_forms() -> None:
    one = Form(np.array([0, 1]), np.array([[1.0, 2.0]]), np.array([3.0]))
    two = Form(np.array([1, 2]), np.array([[4.0, 5.0]]), np.array([6.0]))
    unknowns = np.array([1.0, 10.0, 100.0])
    assert one.at(unknowns) == pytest.approx(24.0)
    assert one.minus([(0.5, two)]).at(unknowns) == pytest.approx(24.0 - 0.5 * 546.0)
    mean = mean_form({0: 0.25, 1: 0.75}, [one, two])
    assert mean.at(unknowns) == pytest.approx(0.25 * 24.0 + 0.75 * 546.0)
    assert mean_form({-1: 1.0}, [one]).at(unknowns) == pytest.approx(0.0)
    system = System([one.equals(np.array([10.0]), np.eye(1)), two.equals(np.array([556.0]), 0.25 * np.eye(1))], 3)
    np.testing.assert_allclose(system.mismatches(unknowns), [14.0**2, 0.25 * 10.0**2])
