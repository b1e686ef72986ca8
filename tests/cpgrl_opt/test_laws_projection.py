"""The laws of the paper's P, d and λ over generated constraint gradients: degenerate, dependent, badly scaled."""

import numpy as np
from hypothesis import given

from cpgrl_opt import project_onto_tangent, projection_matrix, restoration_move, tangent_multipliers
from cpgrl_opt.testing import Case, direction_problems, hoffman_constant, well_posed_problems

EPS = np.finfo(float).eps
# J and g of tangent problems, J with independent rows, and J d = b that has a solution.
TANGENTS = well_posed_problems([Case.TANGENT])
SYSTEMS = well_posed_problems([Case.AFFINE])
INDEPENDENT = direction_problems(9, 3, rank=3, row_scale=1e6, scale=1e-4, cases=[Case.AFFINE])


def unit(jacobian):
    largest = np.abs(jacobian).max(axis=1, initial=0.0)
    rows = jacobian / np.where(largest > 0, largest, 1.0)[:, None]
    lengths = np.linalg.norm(rows, axis=1)
    return rows / np.where(lengths > 0, lengths, 1.0)[:, None]


def rounding(problem):
    """What float64 leaves of an orthogonality: 1/angle of the rows that are nearly dependent, times m and n."""
    return 32 * max(problem.jacobian.shape) * hoffman_constant(problem) * EPS


@given(TANGENTS)
def test_P_is_symmetric_and_idempotent(problem):
    P = projection_matrix(problem.jacobian)
    np.testing.assert_allclose(P, P.T, rtol=0, atol=0)
    np.testing.assert_allclose(P @ P, P, rtol=0, atol=32 * problem.n * EPS)


@given(TANGENTS)
def test_P_maps_into_the_tangent_space(problem):
    np.testing.assert_allclose(unit(problem.jacobian) @ projection_matrix(problem.jacobian), 0, atol=rounding(problem))


@given(TANGENTS)
def test_the_rank_of_P_is_what_the_constraints_leave(problem):
    trace = np.trace(projection_matrix(problem.jacobian))
    assert abs(trace - round(trace)) < 1e-12
    assert round(trace) >= problem.n - problem.m


@given(TANGENTS)
def test_projecting_is_multiplying_by_P(problem):
    difference = project_onto_tangent(problem.jacobian, problem.gradient) - (
        projection_matrix(problem.jacobian) @ problem.gradient
    )
    assert np.linalg.norm(difference) <= 32 * problem.n * EPS * np.linalg.norm(problem.gradient)


@given(TANGENTS)
def test_lambda_takes_from_the_gradient_what_P_takes(problem):
    """Pg = g − Jᵀλ, eq. 7 and 9 together."""
    g = problem.gradient
    rebuilt = g - tangent_multipliers(problem.jacobian, g) @ problem.jacobian
    difference = np.linalg.norm(rebuilt - project_onto_tangent(problem.jacobian, g))
    assert difference <= rounding(problem) * np.linalg.norm(g)


@given(SYSTEMS)
def test_the_restoration_makes_up_for_the_slack_where_that_is_possible(problem):
    """Jd = slack for any slack in the range of J, not only at full row rank."""
    d = restoration_move(problem.jacobian, problem.bound)
    lengths = np.linalg.norm(problem.jacobian, axis=1)
    missed = np.abs(problem.jacobian @ d - problem.bound) / np.where(lengths > 0, lengths, 1.0)
    demanded = np.abs(problem.bound) / np.where(lengths > 0, lengths, 1.0)
    assert missed.max(initial=0.0) <= rounding(problem) * max(np.linalg.norm(d), demanded.max(initial=0.0))


@given(INDEPENDENT)
def test_the_restoration_is_the_shortest_that_does_so(problem):
    d = restoration_move(problem.jacobian, problem.bound)
    tangent = project_onto_tangent(problem.jacobian, problem.gradient)
    # d + tangent restores as much as d does …
    assert np.abs(unit(problem.jacobian) @ tangent).max() <= rounding(problem) * np.linalg.norm(problem.gradient)
    # … and is longer.
    assert np.linalg.norm(d) <= np.linalg.norm(d + tangent) * (1 + 1e-12)


@given(INDEPENDENT)
def test_the_lengths_of_rows_do_not_matter(problem):
    factors = np.array([1e-6, 1.0, 1e6])
    scaled = factors[:, None] * problem.jacobian
    g, size = problem.gradient, np.linalg.norm(problem.gradient)
    tangent = project_onto_tangent(problem.jacobian, g)
    assert np.linalg.norm(project_onto_tangent(scaled, g) - tangent) <= rounding(problem) * size
    d = restoration_move(problem.jacobian, problem.bound)
    difference = restoration_move(scaled, factors * problem.bound) - d
    assert np.linalg.norm(difference) <= rounding(problem) * hoffman_constant(problem) * np.linalg.norm(d)
    lam = tangent_multipliers(problem.jacobian, g) * np.linalg.norm(problem.jacobian, axis=1)
    difference = tangent_multipliers(scaled, g) * np.linalg.norm(scaled, axis=1) - lam
    assert np.linalg.norm(difference) <= rounding(problem) * hoffman_constant(problem) * size
