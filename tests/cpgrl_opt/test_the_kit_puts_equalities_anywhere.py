"""Solvers that are wrong only where an equality stands after an inequality.

Each of them passed a whole default run of the kit of commit 779aebc, whose mixed problems had their equalities first.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.testing import LAWS
from cpgrl_opt.testing.examination import first_break

CORRECT = SOLVERS["active-set"]
Fault = Callable[[DirectionProblem, Direction], Direction]


def is_late(problem: DirectionProblem) -> bool:
    """Whether an equality stands after an inequality."""
    return bool((np.diff(problem.equality.astype(int)) > 0).any())


# --- faults ------------------------------------------------------------------------------------------------------


def equalities_first(problem: DirectionProblem, answer: Direction) -> Direction:
    """The method puts equalities first, and never puts their multipliers back."""
    mu, equality = answer.multipliers, problem.equality
    return replace(answer, multipliers=np.concatenate([mu[equality], mu[~equality]]))


def from_the_last_row(problem: DirectionProblem, answer: Direction) -> Direction:
    return replace(answer, multipliers=answer.multipliers[::-1].copy())


def opposite_sign(problem: DirectionProblem, answer: Direction) -> Direction:
    """Multipliers of equalities, which may have either sign, are those of −Jᵢd = −bᵢ."""
    return replace(answer, multipliers=np.where(problem.equality, -answer.multipliers, answer.multipliers))


def first_rows(problem: DirectionProblem, answer: Direction) -> Direction:
    """The library takes a number k of equalities, and takes the first k rows for them (quadprog's `meq`)."""
    equality = np.arange(problem.m) < problem.equality.sum()
    return CORRECT.solve(
        DirectionProblem(
            problem.gradient, problem.jacobian, problem.bound, equality, problem.metric, radius=problem.radius
        )
    )


def the_gradient(problem: DirectionProblem, answer: Direction) -> Direction:
    return replace(answer, value=problem.gradient)


# --- where -------------------------------------------------------------------------------------------------------


def optimal(problem: DirectionProblem, answer: Direction) -> bool:
    return answer.status == Status.OPTIMAL


def dependent(problem: DirectionProblem, answer: Direction) -> bool:
    return optimal(problem, answer) and np.linalg.matrix_rank(problem.jacobian) < problem.m


def switched_off(problem: DirectionProblem, answer: Direction) -> bool:
    return optimal(problem, answer) and bool((problem.bound == -np.inf).any())


def two_rows(problem: DirectionProblem, answer: Direction) -> bool:
    return problem.m == 2


def last_row_alone(problem: DirectionProblem, answer: Direction) -> bool:
    return optimal(problem, answer) and bool(problem.equality[-1]) and problem.equality.sum() == 1


def long(problem: DirectionProblem, answer: Direction) -> bool:
    return problem.n > 9


def in_a_ball(problem: DirectionProblem, answer: Direction) -> bool:
    return optimal(problem, answer) and problem.radius is not None


def infeasible(problem: DirectionProblem, answer: Direction) -> bool:
    return answer.status == Status.INFEASIBLE and bool(np.isfinite(problem.bound).all())


def anywhere(problem: DirectionProblem, answer: Direction) -> bool:
    return True


@dataclass(frozen=True)
class WrongWhereLate:
    """Active-set, with `fault` where an equality stands after an inequality and `where` holds."""

    fault: Fault
    where: Callable[[DirectionProblem, Direction], bool]
    takes_geometry: bool = False

    def solve(self, problem: DirectionProblem) -> Direction:
        answer = CORRECT.solve(problem)
        if is_late(problem) and self.where(problem, answer):
            return self.fault(problem, answer)
        return answer


def in_batches(wrong: WrongWhereLate) -> Any:
    """Right alone, wrong in a batch."""
    return SimpleNamespace(solve=CORRECT.solve, solve_batch=lambda problems: [wrong.solve(each) for each in problems])


def in_sessions(wrong: WrongWhereLate) -> Any:
    """Right alone, wrong from a warm start."""

    def session(_n: int, _m: int, *, warm_start: bool = False) -> Any:
        return wrong if warm_start else CORRECT

    return SimpleNamespace(solve=CORRECT.solve, session=session)


# solver, and a law that it breaks
WRONG = {
    "μ, equalities first": (WrongWhereLate(equalities_first, optimal), "check_stationarity"),
    "μ, equalities first, permuted": (WrongWhereLate(equalities_first, optimal), "check_permutation"),
    "μ, last row first": (WrongWhereLate(from_the_last_row, optimal), "check_agreement_with_enumeration"),
    "μ, signs of equalities": (WrongWhereLate(opposite_sign, optimal), "check_stationarity"),
    "μ of rows that depend": (WrongWhereLate(equalities_first, dependent), "check_stationarity"),
    "μ beside rows that are off": (WrongWhereLate(equalities_first, switched_off), "check_permutation"),
    "μ of two rows": (WrongWhereLate(equalities_first, two_rows), "check_stationarity"),
    "μ of the last row alone": (WrongWhereLate(equalities_first, last_row_alone), "check_stationarity"),
    "μ in a ball": (WrongWhereLate(equalities_first, in_a_ball, takes_geometry=True), "check_claims_are_certified"),
    "d of two rows": (WrongWhereLate(first_rows, two_rows), "check_permutation"),
    "d of ten parameters or more": (WrongWhereLate(first_rows, long), "check_primal_feasibility"),
    "d of a batch": (in_batches(WrongWhereLate(first_rows, anywhere)), "check_batch_is_loop"),
    "d from a warm start": (in_sessions(WrongWhereLate(first_rows, anywhere)), "check_warm_start_is_cold_start"),
    "proof": (WrongWhereLate(equalities_first, infeasible), "check_infeasible_is_called_infeasible"),
    "d that violates least": (WrongWhereLate(the_gradient, infeasible), "check_least_violation"),
    "rows that are violated": (WrongWhereLate(first_rows, infeasible), "check_least_violation"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_solver_that_is_wrong_only_at_equalities_after_inequalities_is_rejected(what: str) -> None:
    solver, law = WRONG[what]
    found = first_break(LAWS[law], solver, max_examples=100)
    assert found.broken == 1
    asked = found.arguments.get("problems", [found.arguments.get("problem")])
    order = found.arguments.get("order", np.arange(asked[0].m))
    permuted = [replace_rows(each, order) for each in asked]
    assert any(is_late(each) for each in (*asked, *permuted))


def replace_rows(problem: DirectionProblem, order: np.ndarray) -> DirectionProblem:
    return DirectionProblem(
        problem.gradient,
        problem.jacobian[order],
        problem.bound[order],
        problem.equality[order],
        problem.metric,
        radius=problem.radius,
    )
