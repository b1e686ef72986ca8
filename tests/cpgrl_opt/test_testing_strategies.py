"""The generated problems are what their strategies say: feasible or not, of the rank, angle and scale asked for."""

from fractions import Fraction
from itertools import combinations
from random import Random

import numpy as np
import pytest
from hypothesis import Phase, find, given, seed, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status, farkas_residual
from cpgrl_opt.testing import (
    FAMILIES,
    Case,
    direction_problems,
    distance_bound,
    hoffman_constant,
    infeasible_problems,
    problems_of,
    well_posed_problems,
)

FEW = settings(max_examples=30)


def exact_rank(matrix):
    """By fractions: entries are small integers."""
    rows = [[Fraction(entry) for entry in row] for row in matrix.tolist()]
    rank = 0
    for column in range(matrix.shape[1]):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, len(rows)):
            factor = rows[i][column] / rows[rank][column]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return rank


def unit_violation(problem, d):
    lengths = np.linalg.norm(problem.jacobian, axis=1)
    lack = problem.bound - problem.jacobian @ d
    lack = np.where(problem.equality, np.abs(lack), lack)
    return np.max(lack / np.where(lengths > 0, lengths, 1.0), initial=0.0)


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_the_rank_is_exact(rank):
    @given(direction_problems(4, 3, rank=rank, cases=[Case.BOUNDS]))
    @settings(max_examples=30)
    def has_it(problem):
        assert problem.jacobian.shape == (3, 4)
        assert exact_rank(problem.jacobian) == rank

    has_it()


@given(direction_problems(9, 3, conditioning=1e4, cases=[Case.BOUNDS]))
def test_the_conditioning_is_the_ratio_of_singular_values(problem):
    values = np.linalg.svd(problem.jacobian, compute_uv=False)
    assert values[0] / values[-1] == pytest.approx(1e4, rel=1e-9)


@given(direction_problems(4, st.just(2), scale=1e-6, row_scale=1e4, conflict=(0, 2)))
def test_arguments_are_values_ranges_or_strategies(problem):
    assert problem.jacobian.shape == (2, 4)
    assert np.abs(problem.gradient).max() < 1e-2


@given(direction_problems(5, 3, conflict=2, rank=3, cases=[Case.CONE, Case.BOUNDS]))
@FEW
def test_the_conflict_is_the_number_of_constraints_that_bind(problem):
    answer = SOLVERS["enumeration"].solve(problem)
    assert answer.status == Status.OPTIMAL
    assert (answer.multipliers > 1e-9).sum() == 2


@given(st.one_of(infeasible_problems(), direction_problems(feasible=False, cases=[Case.AFFINE])))
@FEW
def test_infeasible_problems_miss_by_a_thousandth(problem):
    answer = SOLVERS["enumeration"].solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(problem, answer.multipliers) <= 1e-9
    if problem.jacobian.any(axis=1).all():
        lengths = np.linalg.norm(problem.jacobian, axis=1)
        largest = np.max(np.abs(problem.bound / lengths)[problem.bound > -np.inf])
        assert unit_violation(problem, answer.value) >= 5e-4 * largest


def test_a_nearly_opposing_pair_has_the_angle_asked_for():
    @given(problems_of(FAMILIES["nearly opposing"], [Case.CONE]))
    @settings(max_examples=30)
    def angle(problem):
        units = [row / np.linalg.norm(row) for row in problem.jacobian if row.any()]
        apart = [np.linalg.norm(one + other) for one, other in combinations(units, 2)]
        assert any(0.9e-7 <= distance <= 0.11 for distance in apart)

    angle()


def test_most_problems_have_something_to_decide():
    """g is feasible in a quarter of them; mutated draws once made it vanish in half of all."""
    conflicts = []

    @seed(0)
    @settings(max_examples=200, database=None, phases=[Phase.generate])
    @given(well_posed_problems())
    def count(problem):
        lack = problem.bound - problem.jacobian @ problem.gradient
        conflicts.append(np.where(problem.equality, lack != 0, lack > 0).any())

    count()
    assert np.mean(conflicts) > 0.6


def test_shrinking_ends_at_numbers_that_fit_on_a_slip_of_paper():
    problem = find(
        well_posed_problems([Case.CONE]),
        lambda problem: SOLVERS["enumeration"].solve(problem).multipliers.any(),
        settings=settings(database=None, deadline=None),
        random=Random(0),
    )
    assert max(problem.n, problem.m) <= 3
    assert np.abs(problem.jacobian).max() <= 1.0
    assert np.abs(problem.gradient).sum() <= 2.0


def test_cases_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="should include one of J d ≥ b"):
        find(infeasible_problems(cases=[Case.CONE]), lambda _: True)


@given(well_posed_problems(), st.integers(0, 2**32 - 1))
@FEW
def test_no_answer_with_small_residuals_is_farther_off_than_the_bound(problem, number):
    """Perturb the data by δ, solve, and judge the answer by the unperturbed problem: Hoffman's bound covers it."""
    oracle = SOLVERS["enumeration"]
    optimum = oracle.solve(problem)
    rng = np.random.default_rng(number)
    delta = 1e-4 * max(np.linalg.norm(problem.gradient), np.linalg.norm(optimum.value))
    lengths = np.linalg.norm(problem.jacobian, axis=1)
    lower = np.where(problem.equality, 0.0, -delta * lengths * rng.random(problem.m))
    other = DirectionProblem(
        problem.gradient + delta * rng.uniform(-1, 1, problem.n) / np.sqrt(problem.n),
        problem.jacobian,
        problem.bound + lower,
        problem.equality,
    )
    moved = oracle.solve(other)
    assert moved.status == Status.OPTIMAL
    assert np.linalg.norm(moved.value - optimum.value) <= distance_bound(problem, 1e-4, moved.value, optimum.value)


def test_the_constant_of_two_rows_is_that_of_their_angle():
    """σ_min of unit rows at the angle φ is √(1 − |cos φ|)."""
    rows = [[1.0, 0.0], [-np.cos(1e-3), np.sin(1e-3)]]
    assert hoffman_constant(DirectionProblem([1.0, 0.0], rows)) == pytest.approx(1 / np.sqrt(1 - np.cos(1e-3)))
    assert hoffman_constant(DirectionProblem([1.0, 0.0], [[1.0, 0.0], [-2.0, 0.0]])) == 1.0
