"""The paper's P, d and λ (eq. 7, 9, 10) obey their laws on every matrix, also on dependent and badly scaled rows."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cpgrl_opt import project_onto_tangent, projection_matrix, restoration_move, tangent_multipliers

# Integers: dependence is exact, and entries of very different rows stay exact too.
SMALL_INTEGERS = st.integers(-4, 4).map(float)
SHAPES = st.sampled_from([(1, 2), (2, 3), (3, 3), (3, 9), (5, 3)])


@st.composite
def jacobians(draw):
    shape = draw(SHAPES)
    rows = draw(arrays(np.float64, shape, elements=SMALL_INTEGERS))
    exponents = draw(arrays(np.int64, shape[0], elements=st.integers(-12, 12)))
    return rows * 10.0 ** exponents[:, None]


def unit(jacobian):
    length = np.linalg.norm(jacobian, axis=1, keepdims=True)
    return np.divide(jacobian, length, out=np.zeros_like(jacobian), where=length > 0)


@given(jacobians())
@example(np.array([[1.0, 0.0], [-1.0, 0.0]]))
@example(np.array([[1.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, -1.0, -1.0]]))  # Δ² + Δ³ + Δ⁴ = 0
def test_p_is_an_orthogonal_projection_onto_the_tangent(jacobian):
    P = projection_matrix(jacobian)
    np.testing.assert_allclose(P, P.T, atol=1e-14)
    np.testing.assert_allclose(P @ P, P, atol=1e-13)
    np.testing.assert_allclose(unit(jacobian) @ P, 0.0, atol=1e-13)
    rank = np.linalg.matrix_rank(unit(jacobian), tol=1e-9)
    assert np.trace(P) == pytest.approx(jacobian.shape[1] - rank, abs=1e-12)


@given(jacobians(), st.integers(0, 2**32 - 1))
def test_pd_is_zero_and_p_never_turns_the_gradient_back(jacobian, seed):
    rng = np.random.default_rng(seed)
    m, n = jacobian.shape
    gradient, slack = rng.standard_normal(n), -rng.random(m)
    d = restoration_move(jacobian, slack)
    tangent = project_onto_tangent(jacobian, gradient)
    assert np.linalg.norm(project_onto_tangent(jacobian, d)) <= 1e-13 * np.linalg.norm(d)
    assert np.linalg.norm(projection_matrix(jacobian) @ d) <= 1e-13 * np.linalg.norm(d)
    assert gradient @ tangent >= -1e-15 * (gradient @ gradient)
    np.testing.assert_allclose(projection_matrix(jacobian) @ gradient, tangent, atol=1e-13)


@given(jacobians(), st.integers(0, 2**32 - 1))
def test_the_restoration_makes_up_for_any_slack_in_the_range_of_j(jacobian, seed):
    at = np.random.default_rng(seed).standard_normal(jacobian.shape[1])
    d = restoration_move(jacobian, jacobian @ at)
    missed = np.abs(jacobian @ (d - at))
    assert (missed <= 1e-12 * np.linalg.norm(jacobian, axis=1) * np.linalg.norm(at)).all()


@given(jacobians(), st.integers(0, 2**32 - 1))
def test_the_multipliers_are_those_of_the_projection_whatever_the_lengths_of_rows(jacobian, seed):
    """Pg = g − Jᵀλ, eq. 7 and 9 together."""
    gradient = np.random.default_rng(seed).standard_normal(jacobian.shape[1])
    multipliers = tangent_multipliers(jacobian, gradient)
    residual = gradient - jacobian.T @ multipliers - project_onto_tangent(jacobian, gradient)
    assert np.linalg.norm(residual) <= 1e-12 * np.linalg.norm(gradient)
    on_unit_rows = multipliers * np.linalg.norm(jacobian, axis=1)
    np.testing.assert_allclose(tangent_multipliers(unit(jacobian), gradient), on_unit_rows, atol=1e-11)


def test_the_sign_of_lambda_at_an_optimum_is_negative():
    """Slip 1 of the paper: with λ of eq. 7 the stop rule must read "no positive components"."""
    jacobian, gradient = np.array([[0.0, 1.0]]), np.array([0.0, -1.0])  # Δ¹ would leave the feasible side
    assert tangent_multipliers(jacobian, gradient)[0] == pytest.approx(-1.0)


@pytest.mark.parametrize("angle", [1e-3, 1e-6, 1e-9])
def test_nearly_opposing_rows_are_both_kept(angle):
    jacobian = np.array([[1.0, 0.0, 0.0], [-np.cos(angle), np.sin(angle), 0.0]])
    np.testing.assert_allclose(project_onto_tangent(jacobian, [0.3, 0.7, 1.0]), [0.0, 0.0, 1.0], atol=1e-15)


def test_no_constraint_leaves_the_gradient_and_needs_no_restoration():
    none = np.zeros((0, 3))
    np.testing.assert_array_equal(project_onto_tangent(none, [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(restoration_move(none, []), np.zeros(3))
    np.testing.assert_array_equal(projection_matrix(none), np.eye(3))
    assert tangent_multipliers(none, [1.0, 2.0, 3.0]).shape == (0,)
