"""Limits of iterations and of time reach the libraries: unpolished, what is stopped at once is not OPTIMAL."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.solvers import DirectionSolver, QPSolversBackend, is_installed
from cpgrl_opt.solvers.through_qpsolvers import BACK_ENDS


def cone(m: int, n: int) -> DirectionProblem:
    rng = np.random.default_rng(0)
    return DirectionProblem(rng.normal(size=n), rng.normal(size=(m, n)))


LARGE = cone(60, 40)  # 28 constraints are active at the answer, which takes each method some steps
LARGER = cone(160, 80)  # DAQP looks at the clock every so many steps only
WITHOUT_TIME_LIMIT = ("quadprog", "piqp", "proxqp")  # of the library
NAMES = [name for name in ("osqp", *BACK_ENDS, "cvxpy") if is_installed(SOLVERS[name])]


def unpolished(name: str, **limits: Any) -> DirectionSolver:
    changed: DirectionSolver = dataclasses.replace(SOLVERS[name], polish=False, **limits)  # type: ignore[type-var]
    return changed


@pytest.mark.parametrize("name", [name for name in NAMES if name != "piqp"])
def test_the_problem_is_solved_within_wide_limits(name: str) -> None:
    """As otherwise the tests below would say nothing."""
    if name == "daqp":
        assert unpolished(name, time_limit=60.0).solve(LARGER).status == Status.OPTIMAL
    assert unpolished(name, time_limit=60.0).solve(LARGE).status == Status.OPTIMAL


@pytest.mark.parametrize("name", [name for name in NAMES if name != "quadprog"])
def test_two_iterations_are_too_few(name: str) -> None:
    answer = unpolished(name, iteration_limit=2).solve(LARGE)
    assert answer.status in (Status.ITERATION_LIMIT, Status.UNCERTIFIED, Status.NUMERICAL_ERROR)
    assert answer.iterations <= 2


@pytest.mark.parametrize("name", [name for name in NAMES if name not in WITHOUT_TIME_LIMIT])
def test_a_tenth_of_a_microsecond_is_too_short(name: str) -> None:
    answer = unpolished(name, time_limit=1e-7).solve(LARGER if name == "daqp" else LARGE)
    assert answer.status in (Status.ITERATION_LIMIT, Status.UNCERTIFIED, Status.NUMERICAL_ERROR)


@pytest.mark.parametrize("name", BACK_ENDS)
def test_every_library_that_has_limits_gets_both(name: str) -> None:
    settings = QPSolversBackend(name, iteration_limit=12345, time_limit=67.5)
    options = BACK_ENDS[name].options(settings).values()
    assert (12345 in options) == (name != "quadprog")
    assert (67.5 in options) == (name not in WITHOUT_TIME_LIMIT)
