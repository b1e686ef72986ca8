"""Families of problems: what their table says of them holds, whoever makes the choices, and they are drawn by name."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.exact import exact_answer, is_small_enough
from cpgrl_opt.problems import FAMILIES, Case, Family, draw_problem, families
from cpgrl_opt.problems.case import ALL_CASES
from cpgrl_opt.problems.infeasible import infeasible
from cpgrl_opt.problems.source import RandomSource
from cpgrl_opt.testing import problems_of
from cpgrl_opt.testing.law import vary


def some(name: str, case: Case | None = None, count: int = 4, **shape: int) -> list[DirectionProblem]:
    return [draw_problem(name, np.random.default_rng([7, k]), case, **shape) for k in range(count)]


def belongs(family: Family, problem: DirectionProblem, case: Case) -> None:
    """The kind of constraints and the geometry are those of the table."""
    on = problem.bound > -np.inf
    if case in (Case.TANGENT, Case.AFFINE):
        assert problem.equality.all()
    if case in (Case.CONE, Case.BOUNDS):
        assert not problem.equality.any()
    if not case.is_shifted:
        assert not problem.bound[on].any()
    if family.geometry is not None:
        assert (problem.radius is not None) == (family.geometry == Case.RADIUS)
        assert problem.radius is not None or problem.metric is not None


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_keeps_what_its_table_says(name: str) -> None:
    family = families()[name]
    assert family.reason
    for case in family.cases:
        for problem in some(name, case, 2):
            belongs(family, problem, case)
            if family.feasible is not None and is_small_enough(problem):
                exact = exact_answer(problem)
                assert exact.feasible == family.feasible
                if family.well_posed and problem.radius is None:
                    size = max(np.linalg.norm(problem.gradient), np.linalg.norm(exact.direction))
                    found = SOLVERS["active-set"].solve(problem).value
                    assert np.linalg.norm(found - exact.direction) <= 1e-6 * size


@pytest.mark.parametrize("name", FAMILIES)
def test_the_kit_draws_the_same_of_small_integers(name: str) -> None:
    family = FAMILIES[name]

    @given(problems_of(family))
    @settings(max_examples=6)
    def yields(problem: DirectionProblem) -> None:
        status = SOLVERS["active-set"].solve(problem).status
        if family.feasible is not None and family.well_posed:
            assert status == Status.OPTIMAL
        if family.feasible is False and name != "weakly infeasible":  # of which an answer may claim neither
            assert status != Status.OPTIMAL

    yields()


def test_a_problem_is_a_function_of_the_generator_alone_and_of_the_shape_asked_for() -> None:
    for name in ("ordinary", "duplicate rows", "nearly parallel", "infeasible", "in a ball"):
        one, again = some(name, count=1), some(name, count=1)
        assert (
            one[0].jacobian.tobytes() + one[0].bound.tobytes() == again[0].jacobian.tobytes() + again[0].bound.tobytes()
        )
        assert [(each.n, each.m) for each in some(name, n=6, m=5)] == [(6, 5)] * 4
    assert {each.m for each in some("pinched", n=4, m=5, count=8)} == {4, 5}, "four rows, and one more or none"
    kinds = {bool(problem.equality.any()) for problem in some("ordinary", count=12)}
    assert kinds == {True, False}, "the kind of constraints is drawn too"


def test_what_no_family_is_or_comes_in_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"name should include one of ordinary, .*; found nosuch"):
        draw_problem("nosuch", rng)
    with pytest.raises(ValueError, match="case should include one of J d ≥ 0; found J d = 0"):
        draw_problem("cone of zero", rng, Case.TANGENT)
    with pytest.raises(ValueError, match=r"\(n, m\) should be at least \(2, 2\) here; found \(1, 3\)"):
        draw_problem("nearly opposing", rng, n=1)


def rank(problem: DirectionProblem) -> int:
    return int(np.linalg.matrix_rank(problem.jacobian))


# What is known of single families beyond the verdict.
HOLDS = {
    "rank-deficient": lambda p: rank(p) < min(p.n, p.m),
    "sum to zero": lambda p: not p.jacobian.sum(axis=0).round(12).any() and rank(p) == p.m - 1,
    "duplicate rows": lambda p: len({tuple(row / np.abs(row).max()) for row in p.jacobian}) == 2,
    "opposing rows": lambda p: (p.jacobian @ p.jacobian.T).min() < 0,
    "pinched": lambda p: p.equality.all() or not exact_answer(vary(p, bound=p.bound + 2.0**-20)).feasible,
    "zero rows": lambda p: (~p.jacobian.any(axis=1)).sum() == 1,
    "cone of zero": lambda p: not exact_answer(p).direction.any(),
    "degenerate vertex": lambda p: (p.jacobian @ exact_answer(p).direction == p.bound).sum() > p.n,
    "binding": lambda p: exact_answer(p).multipliers.any(),
    "Kahan rows": lambda p: np.linalg.cond(p.jacobian) > 10,
    "feasible gradient": lambda p: (p.jacobian @ p.gradient >= p.bound - 1e-9).all(),
    "row scales": lambda p: np.ptp(np.log10(np.linalg.norm(p.jacobian, axis=1))) > 10,
}


def test_what_is_infeasible_asks_for_a_part_of_the_gradients_length_where_all_else_has_room() -> None:
    """In two parameters three of the six rows tell d₀, from which these miss ‖g‖‖Jᵢ‖/32."""
    for seed in range(6):
        p = infeasible(RandomSource(np.random.default_rng(seed), 2, 6), Case.BOUNDS, support=3, gap=1 / 32)
        size = np.linalg.norm(p.gradient) * np.linalg.norm(p.jacobian, axis=1)
        found = []
        for rows in map(list, combinations(range(6), 3)):
            d = np.linalg.lstsq(p.jacobian[rows], (p.bound - size / 32)[rows])[0]
            room = np.sort((p.jacobian @ d - p.bound) / size)
            found.append(np.allclose(room[:3], -1 / 32) and 0.1 <= room[3] <= room[5] <= 1.0)
        assert any(found)


def test_what_is_pinched_is_so_by_rows_that_oppose_each_other_or_by_one_of_their_sum() -> None:
    """Σ wᵢAᵢ with w of 1 and 2, so that the sum is exact: the null vector of the rows."""
    drawn = some("pinched", Case.BOUNDS, 16)
    assert {each.m for each in drawn} == {4, 6}
    weights = [np.abs(np.linalg.svd(each.jacobian.T)[2][-1]) for each in drawn if each.m == 4]
    found = {tuple(np.sort(each / each.min()).round(9)) for each in weights}
    assert len(found) > 1
    assert set().union(*found) == {1.0, 2.0}


@pytest.mark.parametrize("name", HOLDS)
def test_a_family_is_what_it_is_called(name: str) -> None:
    assert all(HOLDS[name](problem) for problem in some(name))


def test_kinds_are_five_and_every_family_names_some() -> None:
    assert all(set(family.cases) <= set(ALL_CASES) and family.cases for family in FAMILIES.values())
