"""Solvers that are wrong at some shape, face or order of rows only: a default run of the kit rejects each of them."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.problems.case import ALL_CASES
from cpgrl_opt.testing import LAWS, LawBroken
from cpgrl_opt.testing.draws import SHAPES
from cpgrl_opt.testing.examination import _Draws, _traceless, first_break
from cpgrl_opt.testing.law import varied

CORRECT = SOLVERS["active-set"]
# A third of the laws that have one problem; a default run puts 100 problems to each.
SAMPLE = ("check_primal_feasibility", "check_claims_are_certified", "check_dual_feasibility", "check_permutation")
MORE = ("check_row_scaling", "check_agreement_with_enumeration", "check_rotation", "check_input_is_unchanged")


@cache
def default_draws(law: str) -> tuple[dict[str, Any], ...]:
    """What a default run puts to solvers of all constraints."""
    with _traceless():
        return _Draws(LAWS[law].arguments, ALL_CASES, 100, 0)._kept()


def breaks(solver: Any, laws: tuple[str, ...]) -> bool:
    """Whether one of the laws breaks on a problem of a default run."""
    for law in laws:
        for arguments in default_draws(law):
            try:
                LAWS[law].check(solver, **arguments)
            except LawBroken:
                return True
    return False


@dataclass(frozen=True)
class WrongWhere:
    """active-set, with `fault` where `is_so(problem, right answer)`."""

    is_so: Callable[[DirectionProblem, Direction], Any]
    fault: Callable[[DirectionProblem, Direction], Direction]
    takes_geometry: bool = False

    def solve(self, problem: DirectionProblem) -> Direction:
        answer = CORRECT.solve(problem)
        return self.fault(problem, answer) if self.is_so(problem, answer) else answer


def the_gradient(problem: DirectionProblem, answer: Direction) -> Direction:
    return Direction(problem.gradient, np.zeros(problem.m), Status.OPTIMAL)


def tight(problem: DirectionProblem, answer: Direction) -> int:
    return 0 if answer.status != Status.OPTIMAL else int(np.count_nonzero(answer.multipliers))


def rank(problem: DirectionProblem) -> int:
    return int(np.linalg.matrix_rank(problem.jacobian)) if problem.m else 0


def test_a_default_run_has_every_listed_shape_and_many_others() -> None:
    problems = [arguments["problem"] for law in (*SAMPLE, *MORE) for arguments in default_draws(law)]
    found = Counter((problem.n, problem.m) for problem in problems)
    assert {(1, 1), (200, 3), (40, 12)} <= set(SHAPES) <= set(found)
    assert len(found) > 50


SOMEWHERE = {
    "n = 1": lambda p, _: p.n == 1,
    "n = 7": lambda p, _: p.n == 7,
    "n = 40": lambda p, _: p.n == 40,
    "n = 200": lambda p, _: p.n == 200,
    "n in 20 … 60": lambda p, _: 20 <= p.n <= 60,
    "m = 4": lambda p, _: p.m == 4,
    "m = 7": lambda p, _: p.m == 7,
    "m = 11": lambda p, _: p.m == 11,
    "n = m > 5": lambda p, _: p.n == p.m > 5,
    "(1, 2)": lambda p, _: (p.n, p.m) == (1, 2),
    "m > 2n": lambda p, _: p.m > 2 * p.n,
    "exactly four rows tight": lambda p, a: tight(p, a) == 4,
    "more than eight rows tight": lambda p, a: tight(p, a) > 8,
    "all of several inequalities tight": lambda p, a: 1 < tight(p, a) == p.m and not p.equality.any(),
    "all but one tight": lambda p, a: 1 < tight(p, a) == p.m - 1,
    "n rows tight": lambda p, a: 1 < tight(p, a) == p.n,
    "rank below n < m": lambda p, _: rank(p) < p.n < p.m,
    "rank below m < n": lambda p, _: rank(p) < p.m < p.n,
    "the last row alone tight": lambda p, a: p.m > 1 and np.flatnonzero(a.multipliers).tolist() == [p.m - 1],
    "the first row slack, others tight": lambda p, a: tight(p, a) > 1 and a.multipliers[0] == 0,
    "equality between inequalities": lambda p, _: "010" in "".join(map(str, p.equality.astype(int))),
}


@pytest.mark.parametrize("where", SOMEWHERE)
def test_a_solver_that_is_wrong_at_some_shape_or_face_only_is_rejected(where: str) -> None:
    assert breaks(WrongWhere(SOMEWHERE[where], the_gradient), (*SAMPLE, *MORE))


def equalities_first(problem: DirectionProblem, answer: Direction) -> Direction:
    """The method puts equalities first, and never puts their multipliers back."""
    mu, equality = answer.multipliers, problem.equality
    return replace(answer, multipliers=np.concatenate([mu[equality], mu[~equality]]))


def from_the_last_row(problem: DirectionProblem, answer: Direction) -> Direction:
    return replace(answer, multipliers=answer.multipliers[::-1].copy())


def opposite_sign(problem: DirectionProblem, answer: Direction) -> Direction:
    """Multipliers of equalities, which may have either sign, are those of −Jᵢd = −bᵢ."""
    return replace(answer, multipliers=np.where(problem.equality, -answer.multipliers, answer.multipliers))


def lost(problem: DirectionProblem, answer: Direction) -> Direction:
    return replace(answer, multipliers=np.where(problem.equality, answer.multipliers, 0.0))


def of_unit_rows(problem: DirectionProblem, answer: Direction) -> Direction:
    return replace(answer, multipliers=answer.multipliers * np.linalg.norm(problem.jacobian, axis=1))


def first_rows(problem: DirectionProblem, answer: Direction) -> Direction:
    """The library takes a number k of equalities, and takes the first k rows for them (quadprog's `meq`)."""
    return CORRECT.solve(varied(problem, equality=np.arange(problem.m) < problem.equality.sum()))


def anywhere(problem: DirectionProblem, answer: Direction) -> bool:
    return True


def late(
    is_so: Callable[[DirectionProblem, Direction], Any] = anywhere,
) -> Callable[[DirectionProblem, Direction], Any]:
    """Where an equality stands after an inequality, and `is_so`."""
    return lambda p, a: bool((np.diff(p.equality.astype(int)) > 0).any()) and is_so(p, a)


def optimal(problem: DirectionProblem, answer: Direction) -> bool:
    return answer.status == Status.OPTIMAL


def infeasible(problem: DirectionProblem, answer: Direction) -> bool:
    return answer.status == Status.INFEASIBLE and bool(np.isfinite(problem.bound).all())


def in_batches(wrong: WrongWhere) -> Any:
    """Right alone, wrong in a batch."""
    return SimpleNamespace(solve=CORRECT.solve, solve_batch=lambda problems: [wrong.solve(each) for each in problems])


def in_sessions(wrong: WrongWhere) -> Any:
    """Right alone, wrong from a warm start."""

    def session(_n: int, _m: int, *, warm_start: bool = False) -> Any:
        return wrong if warm_start else CORRECT

    return SimpleNamespace(solve=CORRECT.solve, session=session)


# Each passed a whole default run of the kit of commit 779aebc, whose mixed problems had their equalities first.
AT_LATE_EQUALITIES = {
    "μ, permuted": (WrongWhere(late(optimal), equalities_first), "check_permutation"),
    "μ, last row first": (WrongWhere(late(optimal), from_the_last_row), "check_agreement_with_enumeration"),
    "μ, signs of equalities": (WrongWhere(late(optimal), opposite_sign), "check_stationarity"),
    "μ, lost beside equalities": (WrongWhere(late(optimal), lost), "check_stationarity"),
    "μ of rows that depend": (WrongWhere(late(lambda p, _: rank(p) < p.m), equalities_first), "check_stationarity"),
    "μ beside rows that are off": (
        WrongWhere(late(lambda p, a: optimal(p, a) and (p.bound == -np.inf).any()), equalities_first),
        "check_permutation",
    ),
    "μ of the last row alone": (
        WrongWhere(late(lambda p, a: optimal(p, a) and p.equality[-1] and p.equality.sum() == 1), equalities_first),
        "check_stationarity",
    ),
    "μ in a ball": (
        WrongWhere(late(lambda p, _: p.radius is not None), equalities_first, takes_geometry=True),
        "check_claims_are_certified",
    ),
    "d of two rows": (WrongWhere(late(lambda p, _: p.m == 2), first_rows), "check_permutation"),
    "d of ten parameters or more": (WrongWhere(late(lambda p, _: p.n > 9), first_rows), "check_primal_feasibility"),
    "d of a batch": (in_batches(WrongWhere(late(), first_rows)), "check_batch_is_loop"),
    "d from a warm start": (in_sessions(WrongWhere(late(), first_rows)), "check_warm_start_is_cold_start"),
    "proof": (WrongWhere(late(infeasible), equalities_first), "check_infeasible_is_called_infeasible"),
    "rows that are violated": (WrongWhere(late(infeasible), first_rows), "check_least_violation"),
    "μ of unit rows": (WrongWhere(anywhere, of_unit_rows), "check_row_scaling"),
}


@pytest.mark.parametrize("what", AT_LATE_EQUALITIES)
def test_a_solver_that_is_wrong_only_at_equalities_after_inequalities_is_rejected(what: str) -> None:
    solver, law = AT_LATE_EQUALITIES[what]
    assert first_break(LAWS[law], solver, max_examples=100).broken == 1


def test_the_right_solver_is_not() -> None:
    assert not breaks(CORRECT, SAMPLE[:2])
