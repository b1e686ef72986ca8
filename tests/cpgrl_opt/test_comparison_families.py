"""Each family of the comparison keeps what its name promises, on any seed, bit for bit the same again."""

import numpy as np
import pytest

from cpgrl_opt import Direction, Status, kkt_residuals
from cpgrl_opt.certify import farkas_residual
from cpgrl_opt.comparison.families import ANGLES, FAMILIES
from cpgrl_opt.comparison.named_families import families_asked, family_named
from cpgrl_opt.exact import exact_answer, exact_trust_region, is_small_enough
from cpgrl_opt.problem import DirectionProblem
from cpgrl_opt.scaling import unit_rows
from cpgrl_opt.testing.law import vary

EQUALITIES = "mixed", "recorded-three-state", "recorded-arm"


def problems(name: str, count: int = 3) -> list[DirectionProblem]:
    return [FAMILIES[name].problem(number, seed) for seed in (0, 20) for number in range(count)]


@pytest.mark.parametrize("name", FAMILIES)
def test_a_problem_depends_on_family_seed_and_number_alone_and_has_the_verdict_promised(name: str) -> None:
    family = FAMILIES[name]
    first, again, *others = (family.problem(*key) for key in ((1, 5), (1, 5), (2, 5), (1, 6)))
    bits = [b"".join(getattr(each, part).tobytes() for part in ("gradient", "jacobian")) for each in (first, *others)]
    assert first.gradient.tobytes() == again.gradient.tobytes()
    assert first.bound.tobytes() == again.bound.tobytes()
    assert len(set(bits)) == 3
    for problem in (first, *others):
        assert is_small_enough(problem) != family.is_large
        assert problem.equality.any() == (name.endswith(EQUALITIES) or "-equality" in name)
        assert family.is_large or exact_answer(problem).feasible == family.feasible


@pytest.mark.parametrize("angle", ANGLES)
def test_rows_stand_at_the_angle_in_the_name(angle: float) -> None:
    for kind, sign in (("parallel", 1.0), ("opposing", -1.0)):
        for problem in problems(f"{kind}-1e{round(np.log10(angle))}", 1):
            rows = unit_rows(problem.jacobian).jacobian
            apart = [np.linalg.norm(rows[i] - sign * rows[j]) for i in range(3) for j in range(i)]
            assert min(apart) == pytest.approx(2 * np.sin(angle / 2), rel=1e-3)


@pytest.mark.parametrize("power", [-12, 12])
def test_sizes_are_those_in_the_name(power: int) -> None:
    for problem in problems(f"gradients-1e{power}-bounds", 1):
        for part in (problem.gradient, problem.jacobian, unit_rows(problem.jacobian).per_length(problem.bound)):
            assert np.log10(np.abs(part).max()) == pytest.approx(power, abs=1.5)
    for problem in problems(f"row-scales-1e{abs(power)}", 1):
        assert np.ptp(np.log10(np.linalg.norm(problem.jacobian, axis=1))) == pytest.approx(2 * abs(power), abs=1.5)


def test_weakly_infeasible_problems_miss_by_what_the_name_says() -> None:
    for power in (-4, -8):
        for problem in problems(f"weakly-infeasible-1e{power}", 1):
            rows, y = unit_rows(problem.jacobian), exact_answer(problem).multipliers
            weights = rows.times_length(y)
            gain = rows.per_length(problem.bound) @ weights / weights.sum() / np.linalg.norm(problem.gradient)
            assert gain == pytest.approx(10.0**power, rel=1e-3)
            assert farkas_residual(problem, y) <= 1e-6


def test_metrics_and_balls_are_those_in_the_name() -> None:
    for name, condition in (("metric-full", 1e2), ("metric-1e10", 1e10), ("metric-diagonal", 1e3)):
        M = FAMILIES[name].problem(0, 0).metric
        assert np.log10(np.linalg.cond(np.diag(M) if M.ndim == 1 else M)) == pytest.approx(np.log10(condition), abs=1)
    for name, factor in (("ball-bounds", 1.5), ("ball-metric-bounds", 1.5), ("ball-out-of-reach", 0.5)):
        problem = FAMILIES[name].problem(1, 0)
        needed = exact_answer(vary(problem, gradient=0.0 * problem.gradient, radius=None)).direction
        flat = needed if problem.whitening is None else problem.whitening.direction(needed)
        assert problem.radius == pytest.approx(factor * np.linalg.norm(flat), rel=1e-12)
    assert 1e11 < FAMILIES["ball-1e12-infeasible"].problem(0, 0).radius < 1e13


def test_exact_answers_rounded_pass_the_referee_where_float64_determines_them() -> None:
    for name in [name for name, family in FAMILIES.items() if family.well_posed and not family.is_large]:
        problem = FAMILIES[name].problem(0, 20)
        answer = exact_answer(problem)
        kappa = 0.0 if problem.radius is None else exact_trust_region(problem).radius_multiplier
        given = Direction(answer.direction, answer.multipliers, Status.OPTIMAL, 0, kappa)
        # Rounding d to float64 costs eps √cond(M) of its length in M.
        assert kkt_residuals(problem, given).worst <= (1e-10 if name == "metric-1e10" else 2e-14), name


def test_patterns_choose_families_and_a_wrong_name_is_answered_with_the_right_ones() -> None:
    chosen = list(families_asked(["touching", "opposing-1e-*", "zero-rows", "zero rows"]))
    assert chosen[:2] == ["opposing-1e-2", "opposing-1e-4"]
    assert chosen[-3:] == ["zero-rows", "zero rows", "touching"]
    with pytest.raises(ValueError, match=r"one of well-conditioned, .*, ordinary, .*FILE.npz; found 'nosuch'"):
        families_asked(["nosuch"])


@pytest.mark.parametrize("name", ["ordinary", "infeasible", "touching"])
def test_the_families_of_the_kit_are_drawn_too_with_their_verdicts(name: str) -> None:
    family = family_named(name)
    for number in range(4):
        problem = family.problem(number, 0)
        assert family.is_feasible(problem) == exact_answer(problem).feasible
