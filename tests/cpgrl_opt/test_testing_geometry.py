"""The kit on metrics and balls: what it generates, whom it asks, and the mistakes that it rejects."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import Phase, find, given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.published.euclidean import euclidean
from cpgrl_opt.testing import (
    Case,
    LawBroken,
    check_claims_are_certified,
    check_direction_solver,
    check_stationarity,
    distance_bound,
    problems_in_geometry,
    problems_out_of_reach,
    supported_cases,
)
from cpgrl_opt.testing.counterexample import counterexample_code
from cpgrl_opt.testing.law import varied
from cpgrl_opt.testing.laws import LAWS

ACTIVE_SET = SOLVERS["active-set"]
FEW = settings(max_examples=30)


@given(problems_out_of_reach())
@FEW
def test_a_ball_out_of_reach_is_infeasible_and_nothing_else_is(problem):
    assert ACTIVE_SET.solve(problem).status == Status.INFEASIBLE
    assert ACTIVE_SET.solve(varied(problem, radius=None)).status == Status.OPTIMAL


@given(problems_in_geometry(cases=[Case.CONE, Case.BOUNDS, Case.RADIUS]))
@FEW
def test_the_bound_on_distances_in_a_ball_is_one(problem):
    """Of an answer to a problem that is off by 1e-4 in g."""
    optimum = ACTIVE_SET.solve(problem)
    gradient = problem.gradient * (1 + 1e-4 * np.cos(np.arange(problem.n)))
    moved = ACTIVE_SET.solve(varied(problem, gradient=gradient))
    kappa = min(optimum.radius_multiplier, moved.radius_multiplier)
    allowed = distance_bound(problem, 1e-4, optimum.value, moved.value, radius_multiplier=kappa)
    difference = moved.value - optimum.value
    if problem.whitening is not None:
        difference = problem.whitening.direction(difference)
    assert np.linalg.norm(difference) <= allowed


@dataclass(frozen=True)
class Mutant:
    """active-set behind a mistake."""

    mistake: str
    tolerance: float = 1e-9

    takes_geometry = True

    def solve(self, problem):
        radius, M = problem.radius, problem.metric
        if self.mistake == "metric forgotten":
            return ACTIVE_SET.solve(varied(problem, metric=None))
        if self.mistake == "radius forgotten":
            return ACTIVE_SET.solve(varied(problem, radius=None))
        if self.mistake == "transposed" and M is not None and M.ndim == 2:
            flat = ACTIVE_SET.solve(varied(euclidean(problem), radius=radius))
            return replace(flat, value=np.linalg.solve(problem.whitening.factor, flat.value))
        if self.mistake == "cut to the ball" and radius is not None:
            answer = ACTIVE_SET.solve(varied(problem, radius=None))
            size = np.linalg.norm(answer.value if M is None else problem.whitening.direction(answer.value))
            return replace(answer, value=answer.value * min(1.0, radius / max(size, 1e-300)), radius_multiplier=1.0)
        answer = ACTIVE_SET.solve(problem)
        if self.mistake == "κ lost":
            return replace(answer, radius_multiplier=0.0)
        if self.mistake == "κ's sign":
            return replace(answer, radius_multiplier=-answer.radius_multiplier)
        return answer


MISTAKES = ["metric forgotten", "radius forgotten", "transposed", "cut to the ball", "κ lost", "κ's sign"]


def breaks(solver, problem):
    try:
        check_claims_are_certified(solver, problem)
    except LawBroken:
        return True
    return False


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_rejected(mistake):
    found = find(
        problems_in_geometry(),
        lambda problem: breaks(Mutant(mistake), problem),
        settings=settings(max_examples=200, phases=[Phase.generate], database=None),
    )
    assert not breaks(Mutant("none"), found)


def test_the_verdict_shows_the_geometry_that_was_forgotten():
    law = "check_primal_feasibility"
    verdict = check_direction_solver(Mutant("radius forgotten"), max_examples=60, checks=[law])
    assert "radius=" in verdict[law].counterexample


def test_only_who_declares_geometry_is_asked_for_it():
    class Naive:
        def solve(self, problem):
            assert problem.metric is None
            assert problem.radius is None
            return ACTIVE_SET.solve(problem)

        def supports(self, problem):
            return problem.m < 9

    assert not any(case.is_geometry for case in supported_cases(Naive()))
    assert check_direction_solver(Naive(), max_examples=8, checks=["check_stationarity", "check_silence"]).passed
    assert set(supported_cases(SOLVERS["rosen"])) == {Case.TANGENT, Case.AFFINE, Case.METRIC, Case.RADIUS}


def test_a_counterexample_writes_metric_and_radius_out():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=[[2.0, 1.0], [1.0, 2.0]], radius=0.5)
    code = counterexample_code(LAWS["check_stationarity"], None, {"problem": problem}, imports=(), spelled="SOLVER")
    space = {"SOLVER": ACTIVE_SET}
    exec(code, space)  # it is the code that is pasted
    space["test_stationarity_holds_here"]()
    assert "radius=0.5" in code


def test_a_broken_law_shows_the_geometry():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=[2.0, 1.0], radius=0.5)
    with pytest.raises(LawBroken, match=r"(?s)metric .*radius .*κ"):
        check_stationarity(Mutant("κ's sign"), problem)
