"""Laws of the occupancy-measure linear programme."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs import TabularMDP, random_mdp


@st.composite
def feasible_cases(draw):
    """A random MDP and thresholds that some policy meets, some of them exactly."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    states, actions, m = draw(st.integers(1, 5)), draw(st.integers(1, 4)), draw(st.integers(0, 3))
    mdp = random_mdp(rng, states, actions, 1 + m)
    witness = rng.dirichlet(np.ones(actions), size=states)
    thresholds = mdp.average_rewards(witness)[1:] - rng.choice([0, 0.1], size=m)
    return mdp, thresholds, rng


@settings(max_examples=20)
@given(feasible_cases())
def test_the_optimum_is_feasible_and_consistent(case):
    mdp, thresholds, _ = case
    optimum = mdp.constrained_optimum(thresholds)
    assert (optimum.values[1:] >= thresholds - 1e-8).all()
    assert (optimum.policy >= 0).all()
    np.testing.assert_allclose(optimum.policy.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(optimum.occupancy.sum(), 1, rtol=1e-12)
    np.testing.assert_allclose((mdp.rewards * optimum.occupancy).sum(axis=(1, 2)), optimum.values, atol=1e-12)
    inflow = np.einsum("sa,saj->j", optimum.occupancy, mdp.transitions)
    np.testing.assert_allclose(inflow, optimum.occupancy.sum(axis=1), atol=1e-12)


@settings(max_examples=20)
@given(feasible_cases())
def test_multipliers_certify_the_optimum(case):
    mdp, thresholds, _ = case
    optimum = mdp.constrained_optimum(thresholds)
    multipliers, slack = optimum.multipliers, optimum.values[1:] - thresholds
    assert (multipliers >= 0).all()
    np.testing.assert_allclose(multipliers * slack, 0, atol=1e-7)
    # Strong duality: the best policy for r¹ + Σ λᵢ(rⁱ − Gⁱ), unconstrained, is worth exactly ρ¹.
    lagrangian = mdp.rewards[0] + np.tensordot(multipliers, mdp.rewards[1:] - thresholds[:, None, None], 1)
    relaxed = TabularMDP(mdp.transitions, lagrangian[None]).constrained_optimum([])
    assert relaxed.values[0] == pytest.approx(optimum.values[0], abs=1e-7)


def test_without_constraints_no_deterministic_policy_is_better():
    mdp = random_mdp(np.random.default_rng(9), 3, 3, 2)
    choices = np.array(list(np.ndindex(3, 3, 3)))
    every_policy = np.eye(3)[choices]
    best = mdp.average_rewards(every_policy)[:, 0].max()
    optimum = mdp.constrained_optimum([-np.inf])
    assert optimum.values[0] == pytest.approx(best, abs=1e-12)
    assert optimum.multipliers.tolist() == [0]


def test_units_of_the_rewards_do_not_matter():
    mdp = random_mdp(np.random.default_rng(10), 4, 3, 3)
    thresholds = mdp.average_rewards(np.full((4, 3), 1 / 3))[1:]
    plain = mdp.constrained_optimum(thresholds)
    unit, shift = np.array([1e9, 1e-9, 1e4]), np.array([0, 3e-9, -5e5])
    rescaled = TabularMDP(mdp.transitions, mdp.rewards * unit[:, None, None] + shift[:, None, None])
    optimum = rescaled.constrained_optimum(thresholds * unit[1:] + shift[1:])
    np.testing.assert_allclose(optimum.values, plain.values * unit + shift, rtol=1e-9)
    np.testing.assert_allclose(optimum.policy, plain.policy, atol=1e-9)
    np.testing.assert_allclose(optimum.multipliers, plain.multipliers * unit[0] / unit[1:], rtol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(1, 3))
def test_infeasible_thresholds_name_the_least_violation(seed, m):
    rng = np.random.default_rng(seed)
    mdp = random_mdp(rng, 3, 3, 1 + m)
    thresholds = mdp.rewards[1:].max(axis=(1, 2)) - rng.uniform(-1, 0.05, size=m)
    with pytest.raises(ValueError, match="thresholds should be within reach") as refusal:
        mdp.constrained_optimum(thresholds)
    found = re.search(r"least violation, .*, is (\S+)$", str(refusal.value))
    assert found
    violation = float(found[1])
    mdp.constrained_optimum(thresholds - violation * (1 + 1e-5))
    with pytest.raises(ValueError, match="thresholds should be within reach"):
        mdp.constrained_optimum(thresholds - violation * (1 - 1e-4))


@pytest.mark.parametrize("shift", [0, 1e8])
def test_thresholds_at_the_very_edge_are_feasible(shift):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        mdp = random_mdp(rng, 3, 3, 4)
        mdp = TabularMDP(mdp.transitions, mdp.rewards + shift)
        # A deterministic policy is a corner of what can be reached; beyond the best one of a channel there is nothing.
        corner = mdp.average_rewards(np.eye(3)[rng.integers(3, size=3)])
        first_constraint = TabularMDP(mdp.transitions, mdp.rewards[1:2]).constrained_optimum([])
        best = mdp.average_rewards(first_constraint.policy)
        for averages in (corner, best):
            optimum = mdp.constrained_optimum(averages[1:])
            assert optimum.values[0] >= averages[0] - 1e-12 * max(shift, 1)
            assert (optimum.values[1:] >= averages[1:] - 1e-9 - 1e-13 * shift).all()


def test_an_optimum_that_no_single_run_can_reach_is_refused():
    # Two absorbing states, one good for each channel: half the time in each is what the programme wants.
    absorbing = np.repeat(np.eye(2)[:, None, :], 2, axis=1)
    mdp = TabularMDP(absorbing, [[[1, 1], [0, 0]], [[0, 0], [1, 1]]])
    with pytest.raises(ValueError, match="one recurrent class"):
        mdp.constrained_optimum([0.5])


@pytest.mark.parametrize("thresholds", [[0.0], [np.nan, 0], [np.inf, 0]])
def test_thresholds_that_are_none_are_refused(thresholds):
    with pytest.raises(ValueError, match="thresholds should"):
        random_mdp(np.random.default_rng(0), 2, 2, 3).constrained_optimum(thresholds)
