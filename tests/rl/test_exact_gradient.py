"""With exact gradients CPGRL climbs to the linear programme's optimum, and the paper's termination comes true."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import TabularEnv, TabularMDP, ThreeStateMDP, random_mdp
from rl import CPGRL, ExactGradient, LinearSoftmax, SoftmaxTable, train, uniform_parameters

FORMULATIONS = ["equality", "cone", "restoring", "linearized"]


def assert_at_the_optimum(mdp: TabularMDP, formulation: str, thresholds: np.ndarray) -> None:
    """ρ¹ within 0.03 of the optimum's, no constraint missed by more than 0.02; starting points are far from both."""
    learner = CPGRL(ConstrainedStep(formulation=formulation, step_size=4.0, restoration_rate=0.5), thresholds)
    policy, initial = SoftmaxTable(mdp.states, mdp.actions), uniform_parameters(mdp.states * mdp.actions)
    *_, last = train(mdp, policy, ExactGradient(), learner, episodes=90, runs=1, initial=initial)
    values = mdp.average_rewards(policy.probabilities(last.parameters[0]))
    optimum = mdp.constrained_optimum(thresholds).values
    assert abs(values[0] - optimum[0]) < 0.03
    assert (values[1:] - thresholds > -0.02).all()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_three_state_optimum_is_reached(formulation: str) -> None:
    assert_at_the_optimum(ThreeStateMDP(), formulation, np.zeros(3))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_optimum_of_a_random_mdp_is_reached_with_a_constraint_in_the_way(formulation: str) -> None:
    rng = np.random.default_rng(0)
    mdp = random_mdp(rng, 4, 3, 3)
    free = mdp.constrained_optimum(np.full(2, -np.inf)).values
    others = mdp.average_rewards(rng.dirichlet(np.full(3, 0.2), size=(200, 4)))
    better = others[(others[:, 1:] - free[1:]).min(axis=1).argmax()]
    thresholds = (free[1:] + better[1:]) / 2  # halfway between two policies' values: feasible
    assert (free[1:] - thresholds).min() < -0.03  # the unconstrained optimum would fail
    assert_at_the_optimum(mdp, formulation, thresholds)


def opposed(sign: float) -> tuple[TabularMDP, np.ndarray, np.ndarray]:
    """r² = sign·r¹ and a policy that meets G² exactly, so that Δ² = sign·Δ¹ is active."""
    mdp = ThreeStateMDP(rewards=np.array(ThreeStateMDP().rewards[0]) * np.array([1.0, sign])[:, None, None])
    theta = np.random.default_rng(0).random(9)
    return mdp, theta, mdp.average_rewards(SoftmaxTable(3, 3, theta).probabilities())[1:]


@pytest.mark.parametrize(("sign", "drop", "episodes"), [(-1.0, "never", 1), (1.0, "stationary", 5)])
def test_training_stops_where_the_gradient_vanishes_on_the_tangent_and_no_multiplier_is_positive(
    sign: float, drop: str, episodes: int
) -> None:
    """Where one is, the constraint may be dropped: docs/reproduction.md, slip 1."""
    mdp, theta, thresholds = opposed(sign)
    learner, policy = CPGRL(ConstrainedStep(drop=drop), thresholds), SoftmaxTable(3, 3, theta)
    records = list(train(mdp, policy, ExactGradient(), learner, episodes=5, runs=2, stop_when_stationary=True))
    assert len(records) == episodes
    assert records[0].update.stationary.all() == (episodes == 1)
    assert np.allclose(records[0].parameters, [theta, theta], atol=1e-12) == (episodes == 1)
    assert episodes == 1 or records[-1].linearization.values[0, 0] > records[0].linearization.values[0, 0]
    assert len(list(train(mdp, policy, ExactGradient(), learner, episodes=5, runs=2))) == 5


def test_what_is_no_finite_mdp_or_no_table_is_refused() -> None:
    stream = [np.random.SeedSequence(0)]
    with pytest.raises(ValueError, match="environment should have average_rewards"):
        ExactGradient().start(TabularEnv(ThreeStateMDP()), SoftmaxTable(3, 3), stream)
    with pytest.raises(ValueError, match="policy should be a SoftmaxTable"):
        ExactGradient().start(ThreeStateMDP(), LinearSoftmax(lambda s: np.eye(3)[s], 3, 3), stream)
