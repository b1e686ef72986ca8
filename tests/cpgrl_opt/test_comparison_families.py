"""Each family of the comparison keeps what its name promises, on any seed, bit for bit the same again."""

import numpy as np
import pytest

from cpgrl_opt import Direction, Status, kkt_residuals
from cpgrl_opt.certify import farkas_residual
from cpgrl_opt.comparison.families import ANGLES, FAMILIES, families_named
from cpgrl_opt.exact import exact_answer, is_small_enough
from cpgrl_opt.exact.trust_region import exact_trust_region
from cpgrl_opt.problem import DirectionProblem
from cpgrl_opt.scaling import unit_rows
from cpgrl_opt.testing.law import varied

SEEDS = (0, 1, 20)


def problems(name: str, count: int = 3) -> list[DirectionProblem]:
    return [FAMILIES[name].problem(number, seed) for seed in SEEDS for number in range(count)]


@pytest.mark.parametrize("name", FAMILIES)
def test_a_problem_depends_on_family_seed_and_number_alone(name: str) -> None:
    family = FAMILIES[name]
    first, again, other, reseeded = (family.problem(*key) for key in ((1, 5), (1, 5), (2, 5), (1, 6)))
    for field in ("gradient", "jacobian", "bound", "equality"):
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    for another in (other, reseeded):
        assert not (
            np.array_equal(first.gradient, another.gradient) and np.array_equal(first.jacobian, another.jacobian)
        )


@pytest.mark.parametrize("name", [name for name in FAMILIES if not FAMILIES[name].is_large])
def test_the_verdict_that_a_family_promises_is_the_exact_one(name: str) -> None:
    family = FAMILIES[name]
    for problem in problems(name):
        assert is_small_enough(problem)
        assert exact_answer(problem).feasible == family.feasible
        assert problem.equality.any() == family.equality


@pytest.mark.parametrize("name", [name for name in FAMILIES if FAMILIES[name].is_large])
def test_large_problems_hold_their_feasible_point(name: str) -> None:
    problem = FAMILIES[name].problem(0, 0)
    assert problem.n > 100
    if "bounds" in name:  # Gaussian rows are independent, so that some d meets any bounds
        assert np.linalg.matrix_rank(problem.jacobian) == problem.m
    else:
        assert not problem.bound.any()


@pytest.mark.parametrize("angle", ANGLES)
def test_rows_stand_at_the_angle_in_the_name(angle: float) -> None:
    for kind, sign in (("parallel", 1.0), ("opposing", -1.0)):
        for problem in problems(f"{kind}-1e{round(np.log10(angle))}"):
            rows = unit_rows(problem.jacobian).jacobian
            apart = [np.linalg.norm(rows[i] - sign * rows[j]) for i in range(3) for j in range(i)]
            assert min(apart) == pytest.approx(2 * np.sin(angle / 2), rel=1e-3)


def test_rows_that_sum_to_zero_do_so_exactly() -> None:
    for suffix in ("", "-bounds", "-equality"):
        for problem in problems(f"sum-to-zero{suffix}"):
            assert not problem.jacobian.sum(axis=0).any()
            assert np.linalg.matrix_rank(problem.jacobian) == 2


def test_duplicates_are_exact_multiples() -> None:
    for problem in problems("duplicate") + problems("duplicate-equality"):
        rows = {tuple(row / np.abs(row).max()) for row in problem.jacobian}
        assert len(rows) == 2
        assert problem.m == 4


def test_zero_rows_are_there() -> None:
    for problem in problems("zero-rows") + problems("zero-rows-equality"):
        assert (np.abs(problem.jacobian).max(axis=1) == 0).sum() == 1


@pytest.mark.parametrize("decades", [6, 12])
def test_row_lengths_span_the_decades_in_the_name(decades: int) -> None:
    for problem in problems(f"row-scales-1e{decades}") + problems(f"row-scales-1e{decades}-bounds"):
        length = np.log10(np.linalg.norm(problem.jacobian, axis=1))
        assert np.ptp(length) == pytest.approx(2 * decades, abs=1.5)


@pytest.mark.parametrize("power", [-12, -4, 12])
def test_gradients_have_the_size_in_the_name(power: int) -> None:
    for problem in problems(f"gradients-1e{power}") + problems(f"gradients-1e{power}-bounds"):
        assert np.log10(np.linalg.norm(problem.gradient)) == pytest.approx(power, abs=1.5)
        assert np.log10(np.linalg.norm(problem.jacobian)) == pytest.approx(power, abs=1.5)


@pytest.mark.parametrize("power", [-12, 12])
def test_bounds_matter_at_every_scale_of_the_gradients(power: int) -> None:
    answers = [(problem, exact_answer(problem)) for problem in problems(f"gradients-1e{power}-bounds")]
    assert any(answer.multipliers.any() for _, answer in answers)
    for problem, answer in answers:
        rows = unit_rows(problem.jacobian)
        assert np.log10(np.abs(rows.per_length(problem.bound)).max()) == pytest.approx(power, abs=1.5)
        assert np.log10(np.linalg.norm(answer.direction)) == pytest.approx(power, abs=1.5)


def test_families_do_not_share_their_random_numbers() -> None:
    gradients = [FAMILIES[name].problem(0, 0).gradient for name in ("well-conditioned", "zero-rows", "far-bounds")]
    assert np.linalg.matrix_rank(gradients) == 3
    scaled = FAMILIES["gradients-1e12"].problem(0, 0).gradient
    assert not np.allclose(scaled / 1e12, gradients[0])


def test_the_cone_of_zero_leaves_nothing() -> None:
    for problem in problems("cone-of-zero"):
        assert not exact_answer(problem).direction.any()


def test_a_feasible_gradient_is_its_own_answer() -> None:
    for problem in problems("feasible-gradient"):
        assert (problem.jacobian @ problem.gradient > problem.bound).all()


def test_vertices_are_degenerate() -> None:
    for problem in problems("degenerate-vertex"):
        answer = exact_answer(problem)
        assert (problem.jacobian @ answer.direction == problem.bound).sum() > problem.n


@pytest.mark.parametrize("power", [-4, -6, -8])
def test_weakly_infeasible_problems_miss_by_what_the_name_says(power: int) -> None:
    for problem in problems(f"weakly-infeasible-1e{power}"):
        rows = unit_rows(problem.jacobian)
        y = exact_answer(problem).multipliers
        weights = rows.times_length(y)
        gain = rows.per_length(problem.bound) @ weights / weights.sum() / np.linalg.norm(problem.gradient)
        assert gain == pytest.approx(10.0**power, rel=1e-3)
        assert farkas_residual(problem, y) <= 1e-6


def test_bounds_bind_in_some_problems_and_not_in_others() -> None:
    binding = [exact_answer(problem).multipliers.any() for problem in problems("well-conditioned-bounds", 6)]
    assert any(binding)
    assert not all(binding)


@pytest.mark.parametrize(("name", "condition"), [("metric-full", 1e2), ("metric-1e10", 1e10), ("metric-diagonal", 1e3)])
def test_metrics_are_as_ill_conditioned_as_the_name_says(name: str, condition: float) -> None:
    for problem in problems(name):
        assert problem.radius is None
        assert problem.metric is not None
        M = np.diag(problem.metric) if problem.metric.ndim == 1 else problem.metric
        assert np.log10(np.linalg.cond(M)) == pytest.approx(np.log10(condition), abs=1.0)


def test_balls_reach_or_miss_the_constraints_by_half() -> None:
    for name, factor in (("ball-bounds", 1.5), ("ball-metric-bounds", 1.5), ("ball-out-of-reach", 0.5)):
        for problem in problems(name):
            needed = exact_answer(varied(problem, gradient=0.0 * problem.gradient, radius=None))
            M = np.eye(problem.n) if problem.metric is None else problem.metric
            M = np.diag(M) if M.ndim == 1 else M
            size = np.sqrt(needed.direction @ M @ needed.direction)
            assert problem.radius == pytest.approx(factor * size, rel=1e-12)
    assert all(1e11 < problem.radius < 1e13 for problem in problems("ball-1e12-infeasible"))
    radii = [problem.radius for problem in problems("ball")]
    assert max(radii) > 100 * min(radii)


def test_exact_answers_rounded_pass_the_referee_where_float64_determines_them() -> None:
    for name in [name for name, family in FAMILIES.items() if family.well_posed and not family.is_large]:
        for problem in problems(name, 1):
            answer = exact_answer(problem)
            kappa = 0.0 if problem.radius is None else exact_trust_region(problem).radius_multiplier
            given = Direction(answer.direction, answer.multipliers, Status.OPTIMAL, 0, kappa)
            # Rounding d to float64 costs eps √cond(M) of its length in M.
            assert kkt_residuals(problem, given).worst <= (1e-10 if name == "metric-1e10" else 2e-14), name


def test_patterns_choose_families_and_a_wrong_name_is_answered_with_the_right_ones() -> None:
    assert list(families_named(["opposing-1e-*", "zero-rows"]))[:2] == ["opposing-1e-2", "opposing-1e-4"]
    assert "zero-rows" in families_named(["opposing-1e-*", "zero-rows"])
    with pytest.raises(ValueError, match=r"family should be one of well-conditioned, .*; found 'nosuch'"):
        families_named(["nosuch"])
