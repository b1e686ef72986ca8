"""The generated problems are what their strategies say: feasible or not, of the rank, angle and scale asked for."""

from itertools import combinations
from random import Random

import numpy as np
import pytest
from hypothesis import find, given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status, farkas_residual
from cpgrl_opt.published import CPO
from cpgrl_opt.testing import (
    FAMILIES,
    LAWS,
    Case,
    check_least_violation,
    direction_problems,
    distance_bound,
    hoffman_constant,
    hostile_problems,
    infeasible_problems,
    problems_in_geometry,
    problems_of,
    problems_out_of_reach,
    well_posed_problems,
)
from cpgrl_opt.testing.examination import _Draws, _traceless
from cpgrl_opt.testing.law import vary
from cpgrl_opt.testing.strategies import ALL_CASES

ACTIVE_SET, ORACLE = SOLVERS["active-set"], SOLVERS["enumeration"]
FEW = settings(max_examples=20)


@given(st.data(), st.integers(0, 3))
@FEW
def test_the_rank_is_exact(data, rank):
    problem = data.draw(direction_problems(4, 3, rank=rank, cases=[Case.BOUNDS]))
    assert problem.jacobian.shape == (3, 4)
    assert np.linalg.matrix_rank(problem.jacobian) == rank  # exact for small integers


@given(direction_problems(9, 3, conditioning=1e4, cases=[Case.BOUNDS]))
@FEW
def test_the_conditioning_is_the_ratio_of_singular_values(problem):
    values = np.linalg.svd(problem.jacobian, compute_uv=False)
    assert values[0] / values[-1] == pytest.approx(1e4, rel=1e-9)


@given(direction_problems(4, st.just(2), scale=1e-6, row_scale=1e4, conflict=(0, 2)))
@FEW
def test_arguments_are_values_ranges_or_strategies(problem):
    assert problem.jacobian.shape == (2, 4)
    assert np.abs(problem.gradient).max() < 1e-2


@given(direction_problems(5, 3, conflict=2, rank=3, cases=[Case.CONE, Case.BOUNDS]))
@FEW
def test_the_conflict_is_the_number_of_constraints_that_bind(problem):
    answer = ORACLE.solve(problem)
    assert answer.status == Status.OPTIMAL
    assert (answer.multipliers > 1e-9).sum() == 2


@given(st.one_of(infeasible_problems(), direction_problems(feasible=False, cases=[Case.AFFINE])))
@FEW
def test_infeasible_problems_miss_by_a_thousandth(problem):
    answer = ORACLE.solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(problem, answer.multipliers) <= 1e-9
    lengths = np.linalg.norm(problem.jacobian, axis=1)
    if lengths.all():
        lack = problem.bound - problem.jacobian @ answer.value
        lack = np.where(problem.equality, np.abs(lack), lack) / lengths
        assert lack.max() >= 5e-4 * np.max(np.abs(problem.bound / lengths)[problem.bound > -np.inf])


@given(problems_of(FAMILIES["nearly opposing"], [Case.CONE]))
@FEW
def test_a_nearly_opposing_pair_has_the_angle_asked_for(problem):
    units = [row / np.linalg.norm(row) for row in problem.jacobian if row.any()]
    apart = [np.linalg.norm(one + other) for one, other in combinations(units, 2)]
    assert any(0.9e-7 <= distance <= 0.11 for distance in apart)


def test_most_problems_of_a_run_have_something_to_decide():
    """g is feasible in a quarter of them; where Hypothesis varies draws as it likes it is so in 40 %."""
    with _traceless():
        drawn = _Draws(LAWS["check_stationarity"].arguments, ALL_CASES, 200, 0)._draw_all()
    conflicts = []
    for problem in (arguments["problem"] for arguments in drawn):
        lack = problem.bound - problem.jacobian @ problem.gradient
        conflicts.append(np.where(problem.equality, lack != 0, lack > 0).any())
    # Eight seeds gave 0.73 to 0.81, and 0.53 to 0.78 without the list of one that keeps Hypothesis from varying.
    assert np.mean(conflicts) > 0.7


def test_shrinking_ends_at_numbers_that_fit_on_a_slip_of_paper():
    problem = find(
        well_posed_problems([Case.CONE]),
        lambda problem: ACTIVE_SET.solve(problem).multipliers.any(),
        settings=settings(database=None, deadline=None, max_examples=20),
        random=Random(0),
    )
    assert max(problem.n, problem.m) <= 3
    assert np.abs(problem.jacobian).max() <= 1.0
    assert np.abs(problem.gradient).sum() <= 2.0


def test_cases_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="should include one of J d ≥ b"):
        find(infeasible_problems(cases=[Case.CONE]), lambda _: True)


CONSTRAINTS = [Case.CONE, Case.BOUNDS, Case.TANGENT, Case.AFFINE]


@pytest.mark.parametrize("limits", [[Case.ONE_ROW], [Case.RADIUS, Case.BALL], [Case.RADIUS, Case.ONE_ROW, Case.BALL]])
def test_limited_problems_keep_to_the_limit(limits):
    cases = [*CONSTRAINTS, *limits]

    @given(st.one_of(well_posed_problems(cases), hostile_problems(cases)))
    @FEW
    def belongs(problem):
        assert problem.m <= 1 or Case.ONE_ROW not in limits
        assert (problem.radius is not None) == (Case.BALL in limits)
        assert problem.metric is None or Case.BALL in limits

    belongs()


ONE_ROW_BALL = [Case.CONE, Case.BOUNDS, Case.RADIUS, Case.ONE_ROW, Case.BALL]


@pytest.mark.parametrize("law", [law.name for law in LAWS.values() if law.applies_to(CPO())])
def test_a_law_puts_nothing_to_a_limited_solver_that_it_does_not_take(law):
    @given(LAWS[law].arguments([case for case in ONE_ROW_BALL if case in LAWS[law].cases]))
    @settings(max_examples=2)
    def taken(arguments):
        for problem in arguments.get("problems", [arguments.get("problem")]):
            assert CPO().supports(problem)

    taken()


# Metrics and balls.


@given(problems_out_of_reach())
@FEW
def test_a_ball_out_of_reach_is_infeasible_and_nothing_else_is(problem):
    assert ACTIVE_SET.solve(problem).status == Status.INFEASIBLE
    assert ACTIVE_SET.solve(vary(problem, radius=None)).status == Status.OPTIMAL


@pytest.mark.parametrize("name", ["active-set", "enumeration"])
def test_the_least_violation_in_a_ball_of_several_rows_is_that_of_our_solvers(name):
    @given(st.one_of(problems_out_of_reach(), problems_out_of_reach([Case.AFFINE, Case.RADIUS])))
    @settings(max_examples=10)
    def least(problem):
        assert check_least_violation(SOLVERS[name], problem) == "held"

    least()


def test_balls_nearly_touch():
    gaps = set()

    @given(problems_of(FAMILIES["touching"], [Case.BOUNDS]))
    @settings(max_examples=60)
    def look(problem):
        shortest = ACTIVE_SET.solve(vary(problem, gradient=0.0 * problem.gradient, radius=None)).value
        flat = shortest if problem.whitening is None else problem.whitening.direction(shortest)
        gaps.add(round(problem.radius / np.linalg.norm(flat) - 1.0, 12) if flat.any() else None)

    look()
    assert {0.0, 1e-3, 1e-6, 1e-9} <= gaps


# How far two answers may be apart.


@given(st.one_of(well_posed_problems(), problems_in_geometry(cases=[Case.CONE, Case.BOUNDS, Case.RADIUS])))
@FEW
def test_no_answer_with_small_residuals_is_farther_off_than_the_bound(problem):
    """The answer to a problem that is off by 1e-4 in g and in b."""
    optimum = ACTIVE_SET.solve(problem)
    lengths = np.linalg.norm(problem.jacobian, axis=1)
    delta = 1e-4 * max(np.linalg.norm(problem.gradient), np.linalg.norm(optimum.value)) * (problem.radius is None)
    moved = ACTIVE_SET.solve(
        vary(
            problem,
            gradient=problem.gradient * (1 + 1e-4 * np.cos(np.arange(problem.n))),
            bound=problem.bound - np.where(problem.equality, 0.0, delta * lengths * np.sin(np.arange(problem.m)) ** 2),
        )
    )
    assert moved.status == Status.OPTIMAL
    kappa = min(optimum.radius_multiplier, moved.radius_multiplier)
    allowed = distance_bound(problem, 1e-4, optimum.value, moved.value, radius_multiplier=kappa)
    difference = moved.value - optimum.value
    if problem.whitening is not None:
        difference = problem.whitening.direction(difference)
    assert np.linalg.norm(difference) <= allowed


def test_the_constant_of_two_rows_is_that_of_their_angle():
    """σ_min of unit rows at the angle φ is √(1 − |cos φ|)."""
    rows = [[1.0, 0.0], [-np.cos(1e-3), np.sin(1e-3)]]
    assert hoffman_constant(DirectionProblem([1.0, 0.0], rows)) == pytest.approx(1 / np.sqrt(1 - np.cos(1e-3)))
    assert hoffman_constant(DirectionProblem([1.0, 0.0], [[1.0, 0.0], [-2.0, 0.0]])) == 1.0
