"""A policy that does not fit a Gymnasium environment is refused before the first step."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from rl import GPOMDP, KondaActorCritic, LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, SoftmaxTable, train
from rl.learners import WeightedSum
from rl.rollout import require_fitting

TABLE = Discrete(4), Discrete(2)
POINT = Box(-1, 1, (3,)), Box(-1, 1, (2,))


class Still(gymnasium.Env):
    """Stays where it is; rewards of a length of one's choice."""

    def __init__(self, observations, actions, rewards=2):
        self.observation_space, self.action_space = observations, actions
        self.reward_space = Box(-1, 1, (2,))
        self.rewards = rewards

    def reset(self, *, seed=None, options=None):  # noqa: ARG002 - Gymnasium's
        super().reset(seed=seed)
        return np.zeros(self.observation_space.shape, self.observation_space.dtype)[()], {}

    def step(self, action):  # noqa: ARG002 - Gymnasium's
        return self.reset()[0], np.zeros(self.rewards), False, False, {}


def network(axes, dimensions):
    return NormalizedGaussianNetwork([-1] * axes, [1] * axes, [2] * axes, dimensions)


def start_of(observation):
    return np.ones(3)


@pytest.mark.parametrize("estimator", [GPOMDP(steps=3), KondaActorCritic(steps=3)])
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
def test_a_policy_of_another_size_is_refused_at_the_start(estimator, spaces, policy, message):
    with pytest.raises(ValueError, match=f"policy {message}"):
        train(Still(*spaces), policy, estimator, WeightedSum(), episodes=1, runs=1)


@pytest.mark.parametrize(
    ("spaces", "policy"),
    [
        (TABLE, SoftmaxTable(4, 2)),
        (TABLE, LinearSoftmax(start_of, 3, 2)),
        (POINT, LinearSoftmax(start_of, 3, 2)),
        (POINT, LinearGaussian(start_of, 3, 2)),
        (POINT, network(3, 2)),
    ],
)
def test_a_policy_of_the_right_size_trains(spaces, policy):
    if isinstance(policy, LinearSoftmax):
        spaces = spaces[0], Discrete(2)
    records = list(train(Still(*spaces), policy, GPOMDP(steps=3), WeightedSum(), episodes=2, runs=1))
    assert len(records) == 2


class Silent:
    """An environment that says what it is told to say, and nothing else."""

    def __init__(self, **spaces):
        vars(self).update(spaces)


@pytest.mark.parametrize(
    ("policy", "spaces"),
    [
        (SoftmaxTable(4, 2), TABLE),
        (LinearSoftmax(start_of, 3, 2), TABLE),
        (LinearGaussian(start_of, 3, 2), POINT),
        (network(3, 2), POINT),
    ],
)
def test_spaces_that_say_nothing_are_let_through_and_the_other_is_read(policy, spaces):
    observations, actions = spaces
    for silent in (
        Silent(),
        Silent(observation_space=None, action_space=None),
        Silent(observation_space=observations),
        Silent(action_space=actions),
    ):
        require_fitting(silent, policy)
    for wrong in (Discrete(7), Box(-1, 1, (7,))):
        with pytest.raises(ValueError, match="policy should have"):
            require_fitting(Silent(action_space=wrong), policy)


def test_features_of_another_size_are_named():
    with pytest.raises(ValueError, match=r"features of shape \(4,\), as its size; found \(3,\)"):
        LinearGaussian(start_of, 4, 2).mean(0)
    with pytest.raises(ValueError, match=r"features of shape \(4,\), as its size; found \(3,\)"):
        LinearSoftmax(start_of, 4, 2).probabilities(0)


def test_rewards_of_another_length_than_declared_are_refused():
    training = train(Still(*TABLE, rewards=3), SoftmaxTable(4, 2), GPOMDP(steps=3), WeightedSum(), episodes=1, runs=1)
    with pytest.raises(ValueError, match=r"rewards should have shape \(2,\), as the environment declares; found \(3,"):
        list(training)
