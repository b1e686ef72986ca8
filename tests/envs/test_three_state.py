"""Facts of the paper's three-state task (§3)."""

import numpy as np
import pytest

from envs import ThreeStateMDP


def test_the_rewards_are_those_of_the_paper():
    mdp = ThreeStateMDP()
    assert mdp.rewards.shape == (4, 3, 3)
    assert mdp.rewards[:, 1, 2].tolist() == [2, 1, -1, 0]  # "when the agent selects the action a₃ at the state s₂"


def test_actions_move_on_by_one_by_two_and_stay():
    np.testing.assert_allclose(ThreeStateMDP().transitions[0, 0], [0.1, 0.8, 0.1])  # the paper's example
    likely = ThreeStateMDP().transitions.argmax(axis=2)
    assert likely.tolist() == [[1, 2, 0], [2, 0, 1], [0, 1, 2]]
    assert sorted(ThreeStateMDP(slip=0.5).transitions[1, 1].tolist()) == [0.25, 0.25, 0.5]


def test_extrinsic_rewards_cancel():
    mdp = ThreeStateMDP()
    assert (mdp.rewards[1:].sum(axis=0) == 0).all()
    policies = np.random.default_rng(0).dirichlet(np.ones(3), size=(50, 3))
    np.testing.assert_allclose(mdp.average_rewards(policies)[:, 1:].sum(axis=1), 0, atol=1e-15)
    np.testing.assert_allclose(mdp.policy_gradients(policies)[:, 1:].sum(axis=1), 0, atol=1e-14)


@pytest.mark.parametrize("slip", [0.01, 0.9])
def test_the_constrained_optimum_is_the_first_action_everywhere(slip):
    optimum = ThreeStateMDP(slip).constrained_optimum([0, 0, 0])
    np.testing.assert_allclose(optimum.values, [1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(optimum.policy, [[1, 0, 0]] * 3, atol=1e-12)


def test_constants_are_arguments():
    mdp = ThreeStateMDP(slip=0.0, rewards=np.ones((2, 3, 3)), start=2)
    assert (mdp.slip, mdp.start, mdp.reward_channels) == (0.0, 2, 2)
    with pytest.raises(ValueError, match=r"slip should be a number in \[0, 1\]; found 1.5"):
        ThreeStateMDP(slip=1.5)
