"""What the kit asks in a ball: the best climb of what violates least, nearly touching balls, and neighbours."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.testing import (
    FAMILIES,
    LAWS,
    Case,
    LawBroken,
    check_batch_is_loop,
    check_least_violation,
    check_neighbours_change_nothing,
    problems_of,
)
from cpgrl_opt.testing.examination import first_break
from cpgrl_opt.testing.law import varied

ACTIVE_SET = SOLVERS["active-set"]
# d₁ ≥ ½ and d₁ ≤ −½: all of the line d₁ = 0 violates least, and (0, 2, 0) climbs best.
OPPOSING = DirectionProblem([1.0, 3.0, 0.0], [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [0.5, 0.5], radius=2.0)
EASY = DirectionProblem([1.0, 2.0, 0.0], [[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]], radius=2.0)


class Right:
    """active-set, as a third party's."""

    takes_geometry, tolerance = True, 1e-9

    def solve(self, problem):
        return ACTIVE_SET.solve(problem)

    def solve_batch(self, problems):
        return [self.solve(problem) for problem in problems]


class StaysWhereItViolatesLeast(Right):
    """Of those in the ball that violate least the shortest: the gradient is forgotten."""

    def solve(self, problem):
        answer = ACTIVE_SET.solve(problem)
        if answer.status == Status.INFEASIBLE and problem.radius is not None:
            still = ACTIVE_SET.solve(varied(problem, gradient=0.0 * problem.gradient))
            return replace(answer, value=still.value)
        return answer


class ClimbsTheWrongWay(Right):
    def solve(self, problem):
        answer = ACTIVE_SET.solve(problem)
        if answer.status == Status.INFEASIBLE and problem.radius is not None:
            return replace(answer, value=ACTIVE_SET.solve(varied(problem, gradient=-problem.gradient)).value)
        return answer


@pytest.mark.parametrize(
    "solver", [StaysWhereItViolatesLeast(), ClimbsTheWrongWay()], ids=lambda each: type(each).__name__
)
def test_the_least_violation_that_climbs_less_is_rejected(solver):
    assert check_least_violation(Right(), OPPOSING) == "held"
    with pytest.raises(LawBroken, match="take the one that climbs most"):
        check_least_violation(solver, OPPOSING)
    assert first_break(LAWS["check_least_violation"], solver, max_examples=80).broken


def test_a_ball_that_holds_back_leaves_one_direction_only():
    """(2, 2) is asked for from a ball of 1: its point (√½, √½) violates least, whatever g is."""
    missing = DirectionProblem([3.0, -1.0], np.eye(2), 2.0, radius=1.0)
    assert check_least_violation(Right(), missing) == "held"
    with pytest.raises(LawBroken, match="stay in the ball and violate the constraints least"):
        check_least_violation(Towards(missing.gradient), missing)


class Towards(Right):
    def __init__(self, gradient):
        self.gradient = gradient

    def solve(self, problem):
        return replace(ACTIVE_SET.solve(problem), value=self.gradient / np.linalg.norm(self.gradient))


class ScalesTheBatch(Right):
    """Every problem in the unit of the longest gradient: a third of it, so that digits are rounded."""

    def solve_batch(self, problems):
        unit = max(float(np.abs(problem.gradient).max()) for problem in problems) / 3.0 or 1.0
        answers = [ACTIVE_SET.solve(varied(problem, gradient=problem.gradient / unit)) for problem in problems]
        return [
            answer
            if problem.radius is None
            else replace(
                answer, multipliers=unit * answer.multipliers, radius_multiplier=unit * answer.radius_multiplier
            )
            for problem, answer in zip(problems, answers, strict=True)
        ]

    def supports(self, problem):
        return problem.radius is not None


def test_a_batch_in_a_common_unit_changes_last_digits_and_is_rejected():
    far = varied(EASY, gradient=1e7 * EASY.gradient)
    assert check_batch_is_loop(ScalesTheBatch(), [EASY, far]) == "held"
    assert check_neighbours_change_nothing(Right(), EASY, [EASY], [far]) == "held"
    with pytest.raises(LawBroken, match="not in its last bit"):
        check_neighbours_change_nothing(ScalesTheBatch(), EASY, [EASY], [far])
    assert first_break(LAWS["check_neighbours_change_nothing"], ScalesTheBatch(), max_examples=40).broken


@pytest.mark.parametrize("name", ["active-set", "nnls", "osqp"])
def test_a_run_in_a_batch_with_radius_has_the_same_bits_beside_extreme_rows(name):
    """Faults A9: a neighbour's row of 1e300 made the whole batch be rescaled."""
    extreme = varied(EASY, jacobian=1e300 * EASY.jacobian, gradient=1e-290 * EASY.gradient)
    for metric in (None, [1.0, 3.0, 7.0]):
        problem, other = varied(EASY, metric=metric), varied(extreme, metric=metric)
        assert check_neighbours_change_nothing(SOLVERS[name], problem, [problem, problem], [other, problem]) == "held"


def test_balls_nearly_touch():
    gaps = set()

    @given(problems_of(FAMILIES["touching"], [Case.BOUNDS]))
    @settings(max_examples=60)
    def look(problem):
        shortest = ACTIVE_SET.solve(varied(problem, gradient=0.0 * problem.gradient, radius=None)).value
        flat = shortest if problem.whitening is None else problem.whitening.direction(shortest)
        gaps.add(round(problem.radius / np.linalg.norm(flat) - 1.0, 12) if flat.any() else None)

    look()
    assert {0.0, 1e-3, 1e-6, 1e-9} <= gaps
