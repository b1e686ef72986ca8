"""Every family of problems in every kind of vectors: the status, the rung and the direction of one array of float64.

Problems are made longer by zeros, and all count as long, so that the kinds are looked at as they are, and not put
together as arrays first.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import Direction, DirectionProblem, Status, solve
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.testing import FAMILIES as KIT_FAMILIES
from cpgrl_opt.testing import problems_of
from cpgrl_opt.vectors import Sharded
from cpgrl_opt.vectors._bfloat16 import narrow, widen

from .kinds import FORMS, ROUNDING, InPairs, Kept, Ranks, as_problem

pytestmark = pytest.mark.usefixtures("every_problem_is_long")
# Of a family each solves so many: its first, and of the kit's as many as are drawn.
PROBLEMS, EXAMPLES = 1, 2
Solved = tuple[Direction, np.ndarray]


def in_one(make: Callable[..., DirectionProblem]) -> Callable[..., Solved]:
    """Solved as a problem of this kind."""

    def solved(V: np.ndarray, **rest: Any) -> Solved:
        problem = make(V, **rest)
        answer = solve(problem)
        return answer, problem.row_of(answer.value)

    return solved


def in_two_parts(V: np.ndarray, **rest: Any) -> Solved:
    parts = V[:, : V.shape[1] // 3], V[:, V.shape[1] // 3 :]

    def work(rank: int, gather: Any) -> Direction:
        return solve(DirectionProblem(Sharded(parts[rank][0], parts[rank][1:], gather=gather), **rest))

    found = Ranks(2).run(work)
    return found[0], np.concatenate([each.value for each in found])


KINDS: dict[str, tuple[Callable[..., Solved], str]] = {
    **{name: (in_one(partial(as_problem, form)), dtype) for name, (form, dtype) in FORMS.items()},
    "object": (in_one(lambda V, **rest: DirectionProblem(InPairs(V), **rest)), "float64"),
    "object without pairs": (in_one(lambda V, **rest: DirectionProblem(Kept(V), **rest)), "float64"),
    "two processes": (in_two_parts, "float64"),
}
WITHOUT_ROWS = ("object", "object without pairs", "two processes")


def held(V: np.ndarray, dtype: str) -> np.ndarray:
    """V rounded to the dtype, which is then the problem; infinite where it does not hold it."""
    with np.errstate(over="ignore"):
        if dtype == "bfloat16":
            return widen(narrow(V)).astype(np.float64)
        return V if dtype == "float64" else V.astype(dtype).astype(np.float64)


def require_the_same(kind: str, problem: DirectionProblem) -> None:
    """In the kind as in one array, where the dtype holds the problem and the kind takes its metric."""
    run, dtype = KINDS[kind]
    V = held(np.vstack([problem.gradient, problem.jacobian]), dtype)
    rest: dict[str, Any] = {"bound": problem.bound, "equality": problem.equality, "radius": problem.radius}
    if problem.metric is not None and kind not in WITHOUT_ROWS:
        rest["metric"] = problem.metric
    else:
        V = np.hstack([V, np.zeros((len(V), max(0, 65 - V.shape[1], 4 * len(V) + 1 - V.shape[1])))])
    if not np.isfinite(V).all():
        return
    expected = solve(DirectionProblem(V[0], V[1:], **rest))
    if not np.isfinite(held(expected.value, dtype)).all():
        return
    found, value = run(V, **rest)
    if kind == "object without pairs" and found.status == Status.UNCERTIFIED:
        return
    if kind in ("object", "two processes") and expected.rung == "rows":  # what no rung tells is no claim
        assert found.status == Status.UNCERTIFIED
        return
    assert found.status == expected.status
    size = max(float(np.linalg.norm(expected.value)), float(np.linalg.norm(V[0])))
    if size < 1e38:  # else the first rung asks whether the dtypes hold d
        assert found.rung == ("gramian" if kind == "object without pairs" else expected.rung)
    assert np.linalg.norm(value - expected.value) <= max(1e-9, ROUNDING[dtype]) * size


@pytest.mark.parametrize("kind", KINDS)
def test_on_the_families_of_the_comparison(kind: str) -> None:
    for family in FAMILIES.values():
        for number in range(PROBLEMS if not family.name.startswith("well-conditioned-100000") else 0):
            try:
                require_the_same(kind, family.problem(number, seed=0))
            except AssertionError as error:
                raise AssertionError(f"{family.name}, problem {number}: {error}") from error


@pytest.mark.parametrize("kind", KINDS)
def test_on_the_families_of_the_kit(kind: str) -> None:
    @settings(max_examples=EXAMPLES * len(KIT_FAMILIES), deadline=None)
    @given(st.sampled_from([*KIT_FAMILIES.values()]).flatmap(problems_of))
    def check(problem: DirectionProblem) -> None:
        require_the_same(kind, problem)

    check()


@pytest.mark.parametrize("kind", KINDS)
def test_without_rows_and_with_more_rows_than_parameters(kind: str) -> None:
    rng = np.random.default_rng(0)
    for m, n in ((0, 1), (0, 7), (1, 1), (6, 3), (9, 2)):
        g, J = rng.integers(-9, 10, n) / 8.0, rng.integers(-9, 10, (m, n)) / 8.0
        require_the_same(kind, DirectionProblem(g, J))
