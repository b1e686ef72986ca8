"""A policy that does not fit a Gymnasium environment is refused before the first step."""

from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from rl import GPOMDP, LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, SoftmaxTable
from rl._spaces import require_fitting

from .stand_ins import Foreign, learn

TABLE = Discrete(4), Discrete(2)
POINT = Box(-1, 1, (3,)), Box(-1, 1, (2,))


def network(axes, dimensions):
    return NormalizedGaussianNetwork([-1] * axes, [1] * axes, [2] * axes, dimensions)


def start_of(observation):
    return np.ones(3)


def still(observations, actions):
    """Stays where it is."""
    x = np.zeros(observations.shape, observations.dtype)[()]
    return Foreign(
        lambda _, __, right: (x, *right[1:]), lambda _: (x, {}), observation_space=observations,
        action_space=actions,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("spaces", "policy", "message"),
    [
        (TABLE, SoftmaxTable(4, 3), r"should have 2 actions, .*; found 3"),
        (TABLE, SoftmaxTable(3, 2), r"should have 4 states, .*; found 3"),
        ((Discrete(4, start=1), Discrete(2)), SoftmaxTable(4, 2), r"should have 4 \(from 1, .*; found 4"),
        (POINT, SoftmaxTable(4, 2), r"should have observations from Box.*; found SoftmaxTable"),
        (TABLE, LinearSoftmax(start_of, 3, 3), r"should have 2 actions, .*; found 3"),
        (POINT, LinearSoftmax(start_of, 3, 3), r"should have actions from Box.*; found LinearSoftmax"),
        (POINT, LinearGaussian(start_of, 3, 1), r"should have 2 components of an action, .*; found 1"),
        (TABLE, LinearGaussian(start_of, 3, 1), r"should have actions from Discrete.*; found LinearGaussian"),
        (POINT, network(2, 2), r"should have 3 components of an observation, .*; found 2"),
    ],
)
def test_a_policy_of_another_size_is_refused_at_the_start(spaces, policy, message):
    with pytest.raises(ValueError, match=f"policy {message}"):
        learn(still(*spaces), policy, GPOMDP(steps=3))


def test_a_policy_of_the_right_size_trains():
    for spaces, policy in (
        (TABLE, SoftmaxTable(4, 2)),
        ((POINT[0], TABLE[1]), LinearSoftmax(start_of, 3, 2)),
        (POINT, LinearGaussian(start_of, 3, 2)),
        (POINT, network(3, 2)),
    ):
        assert len(learn(still(*spaces), policy, GPOMDP(steps=3), episodes=2)) == 2


def test_spaces_that_say_nothing_are_let_through_and_the_other_is_read():
    policy, (observations, actions) = SoftmaxTable(4, 2), TABLE
    for said in ({}, {"observation_space": None}, {"observation_space": observations}, {"action_space": actions}):
        require_fitting(SimpleNamespace(**said), policy)
    with pytest.raises(ValueError, match="policy should have"):
        require_fitting(SimpleNamespace(action_space=Discrete(7)), policy)


@pytest.mark.parametrize("policy", [LinearGaussian(start_of, 4, 2), LinearSoftmax(start_of, 4, 2)])
def test_features_of_another_size_are_named(policy):
    with pytest.raises(ValueError, match=r"features of shape \(4,\), as its size; found \(3,\)"):
        policy.score(0, 0)
