"""Solvers that take one constraint at most, or only trust regions: what they are given, and rejected for."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.published import CPO
from cpgrl_opt.published.euclidean import euclidean
from cpgrl_opt.testing import (
    LAWS,
    Case,
    LawBroken,
    Outcome,
    check_agreement_with_enumeration,
    check_direction_solver,
    check_least_violation,
    hostile_problems,
    problems_out_of_reach,
    supported_cases,
    well_posed_problems,
)
from cpgrl_opt.testing.law import varied

ACTIVE_SET = SOLVERS["active-set"]
CONSTRAINTS = [Case.CONE, Case.BOUNDS, Case.TANGENT, Case.AFFINE]
ONE_ROW_BALL = [Case.CONE, Case.BOUNDS, Case.RADIUS, Case.ONE_ROW, Case.BALL]
# What is about several rows, or about projections.
NOT_OF_CPO = {
    *("check_gradient_kept_when_feasible", "check_idempotence", "check_non_expansiveness", "check_symmetry"),
    *("check_firm_non_expansiveness", "check_restoration_is_normal", "check_permutation", "check_duplicate_row"),
    *("check_inactive_row", "check_batch_is_loop", "check_neighbours_change_nothing"),
    "check_warm_start_is_cold_start",
}


@pytest.fixture(autouse=True)
def little_shrinking(monkeypatch):
    monkeypatch.setattr("cpgrl_opt.testing.examination._SHRINKING_CALLS", 12)


@dataclass(frozen=True)
class OneRow:
    """The projection onto one half-space or hyperplane, d = g + μa, in plain NumPy."""

    mistake: str = ""

    def supports(self, problem):
        return problem.m <= 1

    def solve(self, problem):
        assert problem.m <= 1
        assert problem.radius is None
        g, on = problem.gradient, problem.bound > -np.inf
        if not (np.isfinite(g).all() and np.isfinite(problem.jacobian).all() and (problem.bound < np.inf).all()):
            raise ValueError("found what is not finite")
        if not on.any():
            return Direction(g, np.zeros(problem.m), Status.OPTIMAL)
        (a,), (b,) = problem.jacobian, problem.bound
        if self.mistake == "bound forgotten":
            b = 0.0
        if not a.any():
            held = b == 0 or (b < 0 and not problem.equality[0])
            return Direction(g, np.sign([0.0 if held else b]), Status.OPTIMAL if held else Status.INFEASIBLE)
        lack = b - a @ g
        if not problem.equality[0] and self.mistake != "always an equality":
            lack = max(lack, 0.0)
        mu = lack / (a @ a if self.mistake != "length for its square" else np.sqrt(a @ a))
        return Direction(g + mu * a, np.array([mu]), Status.OPTIMAL)


@dataclass(frozen=True)
class BallsOnly:
    """active-set, which takes nothing without a radius."""

    takes_geometry = True

    def supports(self, problem):
        return problem.radius is not None

    def solve(self, problem):
        assert problem.radius is not None
        return ACTIVE_SET.solve(problem)


@pytest.mark.parametrize(
    ("solver", "cases"),
    [
        (OneRow(), [*CONSTRAINTS, Case.ONE_ROW]),
        (BallsOnly(), [*CONSTRAINTS, Case.MIXED, Case.RADIUS, Case.BALL]),
        (CPO(), ONE_ROW_BALL),
        (ACTIVE_SET, [*CONSTRAINTS, Case.MIXED, Case.METRIC, Case.RADIUS]),
    ],
)
def test_the_limits_are_found_out_by_asking_supports(solver, cases):
    assert supported_cases(solver) == cases


@pytest.mark.parametrize("source", [well_posed_problems, hostile_problems])
@pytest.mark.parametrize("limits", [[Case.ONE_ROW], [Case.RADIUS, Case.BALL], [Case.RADIUS, Case.ONE_ROW, Case.BALL]])
def test_limited_problems_keep_to_the_limit(limits, source):
    @given(source([*CONSTRAINTS, *limits]))
    @settings(max_examples=10)
    def belongs(problem):
        assert problem.m <= 1 or Case.ONE_ROW not in limits
        assert (problem.radius is not None) == (Case.BALL in limits)
        assert problem.metric is None or Case.BALL in limits

    belongs()


@pytest.mark.parametrize("law", [name for name in LAWS if name not in NOT_OF_CPO])
def test_a_law_puts_nothing_to_a_limited_solver_that_it_does_not_take(law):
    cases = [case for case in ONE_ROW_BALL if case in LAWS[law].cases]

    @given(LAWS[law].arguments(cases))
    @settings(max_examples=2)
    def taken(arguments):
        for problem in arguments.get("problems", [arguments.get("problem")]):
            assert CPO().supports(problem)

    taken()


ADDS_ROWS = {"check_permutation", "check_duplicate_row", "check_inactive_row", "check_least_violation"}
ABOUT_MANY = {"check_batch_is_loop", "check_neighbours_change_nothing", "check_warm_start_is_cold_start"}
PROJECTIONS = NOT_OF_CPO - ADDS_ROWS - ABOUT_MANY


@pytest.mark.parametrize(
    ("solver", "silent"),
    [(OneRow(), ADDS_ROWS | ABOUT_MANY), (BallsOnly(), PROJECTIONS | ABOUT_MANY), (CPO(), NOT_OF_CPO)],
    ids=["one row", "balls", "CPO"],
)
def test_a_correct_limited_solver_passes_the_laws_that_speak_about_it(solver, silent):
    verdict = check_direction_solver(solver, max_examples=3)
    verdict.raise_for_failures()
    assert {result.check for result in verdict.results if not result.supported} == silent
    assert all(result.run for result in verdict.results if result.supported)


@pytest.mark.parametrize(
    ("mistake", "law"),
    [
        ("always an equality", "check_dual_feasibility"),
        ("bound forgotten", "check_primal_feasibility"),
        ("length for its square", "check_row_scaling"),
    ],
)
def test_a_wrong_solver_of_one_row_is_rejected(mistake, law):
    result = check_direction_solver(OneRow(mistake), checks=[law], max_examples=25)[law]
    assert result.failed


@dataclass(frozen=True)
class WrongCPO:
    """CPO's closed form behind a mistake."""

    mistake: str
    tolerance = 1e-6
    takes_geometry = True

    def supports(self, problem):
        return CPO().supports(problem)

    def solve(self, problem):
        if self.mistake == "δ for its root":
            return CPO().solve(varied(problem, radius=problem.radius**2))
        answer = CPO().solve(problem)
        if self.mistake == "g of the loss":
            mu = CPO().solve(varied(problem, gradient=-problem.gradient)).multipliers
            force = problem.gradient + mu @ problem.jacobian
            return replace(in_ball_along(problem, force), multipliers=mu)
        if self.mistake == "κ lost":
            return replace(answer, radius_multiplier=0.0)
        if self.mistake == "never infeasible":
            return replace(answer, status=Status.OPTIMAL)
        if answer.status == Status.INFEASIBLE and self.mistake == "recovery by halves":
            return replace(answer, value=0.5 * answer.value)
        return answer


def in_ball_along(problem, force):
    """radius H⁻¹f/√(fᵀH⁻¹f), and κ."""
    step = euclidean(varied(problem, gradient=force)).gradient
    size = np.linalg.norm(step) or 1.0
    value = problem.radius * step / size
    if problem.whitening is not None:
        value = problem.whitening.original(value)
    return Direction(value, np.zeros(problem.m), Status.OPTIMAL, radius_multiplier=size / problem.radius)


@pytest.mark.parametrize(
    ("mistake", "law"),
    [
        ("g of the loss", "check_complementarity"),
        ("δ for its root", "check_agreement_with_enumeration"),
        ("κ lost", "check_stationarity"),
        ("never infeasible", "check_infeasible_is_called_infeasible"),
        ("recovery by halves", "check_least_violation"),
    ],
)
def test_a_wrong_trust_region_step_is_rejected_with_a_counterexample_that_cpo_passes(mistake, law):
    result = check_direction_solver(WrongCPO(mistake), checks=[law], max_examples=25)[law]
    assert result.failed
    assert "radius=" in result.counterexample
    scope = {}
    exec(result.counterexample, scope)
    name = f"test_{law.removeprefix('check_')}_holds_here"
    with pytest.raises(LawBroken):
        scope[name](WrongCPO(mistake))
    scope[name](CPO())


@pytest.mark.parametrize("told", [-1.0, float("nan"), 1e300, None])
def test_the_reported_multiplier_of_the_ball_decides_neither_what_is_compared_nor_how_exactly(told):
    """Half the optimum is no optimum, however the ball is said to bind; what is compared is the problem's affair."""

    def solve(problem):
        answer = ACTIVE_SET.solve(problem)
        multiplier = {} if told is None else {"radius_multiplier": told}
        return SimpleNamespace(
            value=answer.value / 2, multipliers=answer.multipliers, status=answer.status, **multiplier
        )

    half = SimpleNamespace(solve=solve, supports=BallsOnly().supports, takes_geometry=True)
    binding = DirectionProblem([3.0, 4.0], [[1.0, 0.0]], 1.0, radius=2.0)
    with pytest.raises(LawBroken, match="d\\* by enumeration"):
        check_agreement_with_enumeration(half, binding)
    slack = DirectionProblem([-3.0, 0.0], [[1.0, 0.0]], radius=2.0)  # d = 0, or any (0, t) in the ball
    assert check_agreement_with_enumeration(half, slack) == Outcome.SKIPPED


@pytest.mark.parametrize("name", ["active-set", "enumeration"])
def test_the_least_violation_in_a_ball_of_several_rows_is_that_of_our_solvers(name):
    @given(st.one_of(problems_out_of_reach(), problems_out_of_reach([Case.AFFINE, Case.RADIUS])))
    @settings(max_examples=10)
    def least(problem):
        assert check_least_violation(SOLVERS[name], problem) == "held"

    least()
