"""What a default run of the kit is made of, and solvers that are wrong at some shape, face or order of rows only."""

from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, Status
from cpgrl_opt.testing import LAWS, LawBroken
from cpgrl_opt.testing.draws import SHAPES
from cpgrl_opt.testing.examination import _Draws, _traceless
from cpgrl_opt.testing.strategies import ALL_CASES

CORRECT = SOLVERS["active-set"]
# A third of the laws that have one problem; a default run puts 100 problems to each.
SAMPLE = ("check_primal_feasibility", "check_claims_are_certified", "check_dual_feasibility", "check_permutation")
MORE = ("check_row_scaling", "check_agreement_with_enumeration", "check_rotation", "check_input_is_unchanged")


@cache
def default_draws(law):
    """What a default run puts to solvers of all constraints."""
    with _traceless():
        return _Draws(LAWS[law].arguments, ALL_CASES, 100, 0)._kept()


@cache
def sample():
    problems = [arguments["problem"] for law in (*SAMPLE, *MORE) for arguments in default_draws(law)]
    return [(problem, CORRECT.solve(problem)) for problem in problems]


def share(is_so):
    return np.mean([is_so(problem, answer) for problem, answer in sample()])


def tight(problem, answer):
    return 0 if answer.status != Status.OPTIMAL else int(np.count_nonzero(answer.multipliers))


def rank(problem):
    return np.linalg.matrix_rank(problem.jacobian) if problem.m else 0


# The least part of all problems; it was 0 for all of them but the last three.
SHARES = {
    "two rows": (lambda p, _: p.m == 2, 0.2),
    "one parameter": (lambda p, _: p.n == 1, 0.05),
    "ten parameters or more": (lambda p, _: p.n > 9, 0.1),
    "20 to 60 parameters": (lambda p, _: 20 <= p.n <= 60, 0.04),
    "eleven rows or more": (lambda p, _: p.m >= 11, 0.05),
    "seven to ten rows": (lambda p, _: 7 <= p.m <= 10, 0.04),
    "as many rows as parameters": (lambda p, _: p.m == p.n, 0.15),
    "four tight rows or more": (lambda p, a: tight(p, a) >= 4, 0.08),
    "six tight rows or more": (lambda p, a: tight(p, a) >= 6, 0.03),
    "all of several rows tight": (lambda p, a: 1 < tight(p, a) == p.m, 0.08),
    "rank below n < m": (lambda p, _: rank(p) < p.n < p.m, 0.02),
    "an equality after an inequality": (lambda p, _: (np.diff(p.equality.astype(int)) > 0).any(), 0.06),
    "rank below m ≤ n": (lambda p, _: rank(p) < p.m <= p.n, 0.05),
    "no row tight": (lambda p, a: tight(p, a) == 0, 0.1),
    "one row tight": (lambda p, a: tight(p, a) == 1, 0.15),
}


@pytest.mark.parametrize("what", SHARES)
def test_a_default_run_has_its_share_of_every_kind(what):
    is_so, least = SHARES[what]
    assert share(is_so) >= least


def test_a_default_run_has_every_listed_shape_and_many_others():
    found = Counter((problem.n, problem.m) for problem, _ in sample())
    assert set(SHAPES) <= set(found)
    assert {(1, 1), (200, 3), (40, 12)} <= set(SHAPES)
    assert len(found) > 50


@dataclass(frozen=True)
class WrongWhere:
    """The gradient for the direction, called OPTIMAL, where `is_so(problem, right answer)`; else active-set."""

    is_so: Any

    def solve(self, problem):
        answer = CORRECT.solve(problem)
        if self.is_so(problem, answer):
            return Direction(problem.gradient, np.zeros(problem.m), Status.OPTIMAL)
        return answer


WRONG = {
    "n = 1": lambda p, _: p.n == 1,
    "n = 3, m = 2": lambda p, _: (p.n, p.m) == (3, 2),
    "n = 7": lambda p, _: p.n == 7,
    "n > 9": lambda p, _: p.n > 9,
    "n in 20 … 60": lambda p, _: 20 <= p.n <= 60,
    "n = 40": lambda p, _: p.n == 40,
    "n = 200": lambda p, _: p.n == 200,
    "n > 60": lambda p, _: p.n > 60,
    "m = 2": lambda p, _: p.m == 2,
    "m = 4": lambda p, _: p.m == 4,
    "m = 7": lambda p, _: p.m == 7,
    "m = 11": lambda p, _: p.m == 11,
    "m ≥ 11": lambda p, _: p.m >= 11,
    "m = 12": lambda p, _: p.m == 12,
    "n = m": lambda p, _: p.n == p.m,
    "n = m > 5": lambda p, _: p.n == p.m > 5,
    "(1, 1)": lambda p, _: (p.n, p.m) == (1, 1),
    "(2, 2)": lambda p, _: (p.n, p.m) == (2, 2),
    "(1, 2)": lambda p, _: (p.n, p.m) == (1, 2),
    "m > 2n": lambda p, _: p.m > 2 * p.n,
    "four rows tight or more": lambda p, a: tight(p, a) >= 4,
    "exactly four rows tight": lambda p, a: tight(p, a) == 4,
    "six rows tight or more": lambda p, a: tight(p, a) >= 6,
    "more than eight rows tight": lambda p, a: tight(p, a) > 8,
    "all rows tight": lambda p, a: 0 < tight(p, a) == p.m,
    "all of several inequalities tight": lambda p, a: 1 < tight(p, a) == p.m and not p.equality.any(),
    "all but one tight": lambda p, a: 1 < tight(p, a) == p.m - 1,
    "n rows tight": lambda p, a: 1 < tight(p, a) == p.n,
    "rank below n < m": lambda p, _: rank(p) < p.n < p.m,
    "rank below m < n": lambda p, _: rank(p) < p.m < p.n,
    "rank below m = n": lambda p, _: rank(p) < p.m == p.n,
    "the last row alone tight": lambda p, a: p.m > 1 and np.flatnonzero(a.multipliers).tolist() == [p.m - 1],
    "the first row slack, others tight": lambda p, a: tight(p, a) > 1 and a.multipliers[0] == 0,
    "equalities last": lambda p, _: p.m > 1 and p.equality[-1] and not p.equality[0],
    "equality between inequalities": lambda p, _: "010" in "".join(map(str, p.equality.astype(int))),
}


def breaks(solver, laws):
    """Whether one of the laws breaks on a problem of a default run."""
    for law in laws:
        for arguments in default_draws(law):
            try:
                LAWS[law].check(solver, **arguments)
            except LawBroken:
                return True
    return False


@pytest.mark.parametrize("where", WRONG)
def test_a_solver_that_is_wrong_at_some_shape_or_face_only_is_rejected(where):
    assert breaks(WrongWhere(WRONG[where]), (*SAMPLE, *MORE))


def test_the_right_solver_is_not():
    assert not breaks(CORRECT, SAMPLE)


@dataclass(frozen=True)
class WrongMultipliers:
    """The right directions, with multipliers that `change(multipliers, equality)` makes of the right ones."""

    change: Any

    def solve(self, problem):
        answer = CORRECT.solve(problem)
        return Direction(answer.value, self.change(answer.multipliers, problem.equality), answer.status)


def equalities_first(mu, equality):
    return np.concatenate([mu[equality], mu[~equality]])


def equalities_last(mu, equality):
    return np.concatenate([mu[~equality], mu[equality]])


def reversed_rows(mu, equality):
    return mu[::-1].copy()


def reversed_in_mixed_problems(mu, equality):
    return mu[::-1].copy() if equality.any() and not equality.all() else mu


def reversed_equalities(mu, equality):
    changed = mu.copy()
    changed[equality] = mu[equality][::-1]
    return changed


def sign_of_equalities(mu, equality):
    return np.where(equality, -mu, mu)


def sign_of_equalities_in_mixed_problems(mu, equality):
    return np.where(equality & ~equality.all(), -mu, mu)


def lost_beside_equalities(mu, equality):
    return np.where(~equality & equality.any(), 0.0, mu)


CHANGES = [
    *(equalities_first, equalities_last, reversed_rows, reversed_in_mixed_problems, reversed_equalities),
    *(sign_of_equalities, sign_of_equalities_in_mixed_problems, lost_beside_equalities),
]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("law", ["check_stationarity", "check_agreement_with_enumeration"])
def test_multipliers_in_a_wrong_order_or_of_a_wrong_sign_are_rejected(change, law):
    assert breaks(WrongMultipliers(change), [law])


@pytest.mark.parametrize("change", [equalities_first, equalities_last, reversed_rows])
def test_multipliers_that_do_not_move_with_the_rows_are_rejected(change):
    assert breaks(WrongMultipliers(change), ["check_permutation"])


def test_multipliers_that_do_not_scale_with_the_rows_are_rejected():
    """The direction is right; a unit row's multiplier is returned for the row's own."""

    class OfUnitRows:
        def solve(self, problem):
            answer = CORRECT.solve(problem)
            lengths = np.linalg.norm(problem.jacobian, axis=1)
            return Direction(answer.value, answer.multipliers * lengths, answer.status)

    assert breaks(OfUnitRows(), ["check_row_scaling"])
