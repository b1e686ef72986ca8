"""Laws of performance profiles (Dolan & Moré 2002), and one by hand."""

import random

import pytest

from cpgrl_opt.comparison.measurement import Measurement
from cpgrl_opt.comparison.profiles import Profile, performance_profiles, problems_met, problems_taken


def timed(solver: str, problem: int, ratio: float, outcome: str = "success", variant: str = "prepared") -> Measurement:
    return Measurement(
        solver=solver, variant=variant, family="a", problem=problem, n=2, m=1, status="", outcome=outcome, worst=0.0,
        distance=None, seconds=ratio, ratio=ratio, limit=1e3, noise=False,
    )  # fmt: skip


def profiles_of(measurements: list[Measurement]) -> dict[str, Profile]:
    met = problems_met(measurements, "prepared")
    return {key[0]: value for key, value in performance_profiles(measurements, met, ("prepared",)).items()}


def test_two_solvers_by_hand() -> None:
    found = profiles_of([
        timed("a", 0, 1.0), timed("a", 1, 6.0), timed("a", 2, 0.1, "hang"),
        timed("b", 0, 4.0), timed("b", 1, 2.0), timed("b", 2, 5.0),
    ])  # fmt: skip
    assert found["a"] == Profile((1.0, 3.0), (1 / 3, 2 / 3))
    assert found["b"] == Profile((1.0, 4.0), (2 / 3, 1.0))
    assert [found["b"].at(factor) for factor in (1.0, 3.9, 4.0)] == pytest.approx([2 / 3, 2 / 3, 1.0])


@pytest.mark.parametrize("seed", range(5))
def test_profiles_rise_to_the_share_of_successes_and_someone_is_fastest(seed: int) -> None:
    rng = random.Random(seed)
    measurements = [
        timed(solver, problem, rng.lognormvariate(0, 1), rng.choice(("success", "success", "hang", "silently-wrong")))
        for solver in "abcd"
        for problem in range(30)
    ]
    found = profiles_of(measurements)
    for solver, profile in found.items():
        successes = sum(each.outcome == "success" for each in measurements if each.solver == solver)
        assert profile.at(float("inf")) == pytest.approx(successes / 30)
        assert profile.at(float("inf")) < 1.0
        assert list(profile.shares) == sorted(profile.shares)
        assert all(factor >= 1.0 for factor in profile.factors)
    solved = {each.problem for each in measurements if each.outcome == "success"}
    assert sum(profile.at(1.0) for profile in found.values()) == pytest.approx(len(solved) / 30)


@pytest.mark.parametrize("outcome", ["inaccurate", "silently-wrong", "honest-failure", "crash", "unsupported"])
def test_what_is_no_success_sets_no_pace_and_is_never_solved(outcome: str) -> None:
    found = profiles_of([timed("quick", 0, 0.001, outcome), timed("right", 0, 7.0)])
    assert found["quick"].at(float("inf")) == 0.0
    assert found["right"].at(1.0) == 1.0


def test_a_problem_that_a_solver_did_not_meet_is_one_that_it_did_not_solve() -> None:
    found = profiles_of([timed("a", 0, 1.0), timed("b", 0, 1.0), timed("b", 1, 1.0)])
    assert found["a"].at(float("inf")) == 0.5


def test_a_clock_that_did_not_tick_divides_nothing_by_zero() -> None:
    found = profiles_of([timed("a", 0, 0.0), timed("b", 0, 1.0)])
    assert found["a"].at(1.0) == 1.0
    assert found["b"].at(float("inf")) == 1.0


def test_what_nobody_takes_is_met_and_not_taken() -> None:
    asked = [timed("a", 0, 1.0), timed("a", 1, 0.0, "unsupported"), timed("a", 2, 1.0, variant="raw")]
    assert problems_met(asked, "prepared") == {("a", 0), ("a", 1)}
    assert problems_taken(asked, "prepared") == {("a", 0)}
