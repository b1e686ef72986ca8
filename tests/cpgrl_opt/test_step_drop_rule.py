"""The drop rule obeys multipliers and not their rounding: λᵢ‖Jᵢ‖ counts as 0 below a part of ‖Δ¹‖, as PΔ¹ does."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Direction, DirectionProblem, Linearization, Status
from cpgrl_opt.solvers import RosenDrop

GEOMETRIES = [{}, {"metric": [2.0, 0.5, 1.0, 3.0]}, {"ridge": 1e-300}]


def opposed(seed: int) -> Linearization:
    """Two constraints violated by 1, and Δ¹ = −Δ²: the optimum on their face, λ = (−1, 0)."""
    rows = np.random.default_rng(seed).standard_normal((2, 4))
    return Linearization([0.0, -1.0, -1.0], [-rows[0], *rows])


@pytest.mark.parametrize("drop", ["stationary", "always"])
@pytest.mark.parametrize("settings", GEOMETRIES)
@pytest.mark.parametrize("raw", [False, True])
def test_a_multiplier_of_rounding_size_drops_no_constraint(drop, settings, raw):
    step = ConstrainedStep(step_size=1.0, restoration_rate=1.0, drop=drop, raw_multipliers=raw, **settings)
    for seed in range(12):
        linearization = opposed(seed)
        result = step(linearization, [0.0, 0.0])
        assert (result.counts["dropped"], bool(result.stationary)) == (0, True)
        np.testing.assert_allclose(linearization.jacobian @ result.change, [1.0, 1.0], rtol=1e-9)


def test_an_optimum_is_stationary_though_its_multipliers_round_to_either_sign():
    for seed in range(12):
        assert ConstrainedStep(drop="never")(opposed(seed), [0.0, 0.0]).stationary


def test_what_is_a_hundred_times_rounding_still_drops():
    """λ₂‖J₂‖ = 1e-8 ‖Δ¹‖, positive."""
    climbing = Linearization([0.0, -1.0, -1.0], [[-1.0, 1e-8], [1.0, 0.0], [0.0, 1.0]])
    result = ConstrainedStep()(climbing, [0.0, 0.0])
    assert (result.counts["dropped"], bool(result.stationary)) == (1, False)


@pytest.mark.parametrize("raw", [False, True])
def test_rosens_drop_rule_does_not_obey_rounding_either(raw):
    for seed in range(12):
        rows = np.random.default_rng(seed).standard_normal((2, 4))
        answer = RosenDrop(raw_multipliers=raw).solve(DirectionProblem(-rows[0], rows))
        assert (answer.status, answer.iterations) == (Status.OPTIMAL, 0)


def test_raw_multipliers_are_those_printed_whatever_rows_stand_beside():
    """λ₁ = 1 and λ₂ = 0.1, λ₂‖J₂‖ = 10; or a row of 1e-200, whose λ is 1e200."""
    ordinary, tiny = [[1.02, 10.2], [1.0, 0.2], [0.2, 100.0]], [[1.0, 1.0], [1e-200, 0.0], [0.0, 1.0]]
    step = ConstrainedStep(raw_multipliers=True, step_size=1.0, restoration_rate=0.0)
    values = np.array([0.0, -1.0, -1.0])
    together = step(Linearization([values, values], [ordinary, tiny]), [0.0, 0.0]).change
    np.testing.assert_array_equal(together[0], step(Linearization(values, ordinary), [0.0, 0.0]).change)
    np.testing.assert_allclose(together[1], [1.0, 0.0], atol=1e-15)  # λ = (1e200, 1): the first goes


def test_an_observer_keeps_what_it_saw():
    climbing, seen = Linearization([0.0, -1.0], [[0.0, 1.0], [0.0, 1.0]]), []
    result = ConstrainedStep()(climbing, [0.0], observe=lambda _, answers: seen.append((answers, answers.value.copy())))
    assert result.counts["dropped"] == 1
    for answers, value in seen:
        np.testing.assert_array_equal(answers.value, value)


class Forceful:
    """Right, but that it names a force where g and d vanish: nothing to measure it by."""

    def solve(self, problem):
        return Direction(np.zeros(problem.n), np.full(problem.m, -5.0), Status.OPTIMAL)


def test_where_the_objective_is_flat_no_multiplier_drops_a_constraint():
    flat = Linearization([0.0, 0.0], [[0.0, 0.0], [1.0, 0.0]])
    result = ConstrainedStep(solver=Forceful())(flat, [0.0])
    assert (result.counts["dropped"], bool(result.stationary)) == (0, True)
