"""What makes learning impossible is said: no update of one-step episodes, critics that stay 0, several classes."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.wrappers import OrderEnforcing, TimeLimit

from envs import TabularEnv, TabularMDP, ThreeStateMDP, TwoLinkArm
from rl import (
    GPOMDP,
    ExactGradient,
    KondaActorCritic,
    LinearSoftmax,
    NormalizedGaussianNetwork,
    SoftmaxTable,
    WeightedSum,
    train,
)

from .stand_ins import bandit, streams


def learned(estimator: Any, environment: Any, runs: int = 20, episodes: int = 1) -> np.ndarray:
    policy = SoftmaxTable(1, 2)
    *_, last = train(environment, policy, estimator, WeightedSum(step_size=0.1), episodes=episodes, runs=runs)
    return last.parameters


TOLD = r"episodes should have more than one step; found one step in each of the first \d+.*Use weights=\"usual\""


def test_one_step_episodes_with_the_papers_weights_are_an_error() -> None:
    """θ, Δ and ρ stayed 0 without a word. Twenty runs are enough at once; few runs are warned first."""
    with pytest.raises(ValueError, match=TOLD):
        learned(GPOMDP(), bandit(1))
    with pytest.warns(UserWarning, match=TOLD):
        learned(GPOMDP(), bandit(1), runs=5)
    with pytest.warns(UserWarning, match=TOLD), pytest.raises(ValueError, match="in each of the first 20"):
        learned(GPOMDP(), bandit(1), runs=1, episodes=20)


def test_one_step_episodes_are_learned_from_where_all_of_the_sum_enters() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for estimator in (GPOMDP(weights="usual"), GPOMDP(average="episode"), KondaActorCritic()):
            theta = learned(estimator, bandit(1), runs=3, episodes=300)
            assert (theta[:, 1] > theta[:, 0] + 0.1).all()


def test_a_one_step_episode_among_longer_ones_is_no_false_alarm() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        learned(GPOMDP(), bandit(3, *[1] * 60), runs=1, episodes=60)
        learned(GPOMDP(), bandit(1, 2), runs=2)
        learned(GPOMDP(), bandit(1, 1, 4), runs=1, episodes=4)
    with pytest.warns(UserWarning, match=TOLD):
        assert np.abs(learned(GPOMDP(), bandit(*[1] * 6, 4), runs=1, episodes=9)).max() > 0


def test_a_limit_of_one_step_is_refused_at_the_start() -> None:
    arm = TwoLinkArm(max_steps=1)
    for environment, policy, steps in (
        (ThreeStateMDP(), SoftmaxTable(3, 3), 1),
        (arm, NormalizedGaussianNetwork(*arm.stops, (5, 8), 2), 50),
    ):
        with pytest.raises(ValueError, match=r"steps should be above 1; found 1\. .*Use weights=\"usual\""):
            GPOMDP(steps=steps).start(environment, policy, streams())
        GPOMDP(steps=steps, weights="usual").start(environment, policy, streams())
        GPOMDP(steps=steps, average="episode").start(environment, policy, streams())


# --- several recurrent classes -----------------------------------------------------------------------------------


def caught(*, reachable: bool = True) -> TabularMDP:
    """From state 0 action 0 leads to state 1 and action 1 to state 2, or to 1 too; nothing leads out of them."""
    transitions = np.zeros((3, 2, 3))
    transitions[0, 0, 1] = transitions[0, 1, 2 if reachable else 1] = 1.0
    transitions[1, :, 1] = transitions[2, :, 2] = 1.0
    return TabularMDP(transitions, [[[0, 0], [1, 1], [2, 2]]])


@pytest.mark.parametrize("estimator", [GPOMDP(steps=10), KondaActorCritic(steps=10)])
def test_several_recurrent_classes_are_refused_as_the_exact_gradient_refuses_them(estimator: Any) -> None:
    table = SoftmaxTable(3, 2)
    with pytest.raises(ValueError, match="should have one recurrent class") as exact:
        ExactGradient().start(caught(), table, streams()).episode(np.zeros((1, 6)))
    linear = LinearSoftmax(lambda s: np.eye(3)[s], 3, 2)
    env = TabularEnv(caught())
    made = TimeLimit(OrderEnforcing(env), 50)  # as gymnasium.make does
    for environment, policy in ((caught(), table), (env, table), (env, linear), (made, table), (made, linear)):
        with pytest.raises(ValueError, match="should have one recurrent class") as found:
            estimator.start(environment, policy, streams())
        assert str(found.value).startswith(str(exact.value))
    with pytest.raises(ValueError, match="should have one recurrent class"):
        next(train(caught(), table, estimator, WeightedSum(), episodes=1))
    # The sum over ten steps does not need one class, and a class that no episode comes to is none of its business.
    replace(estimator, average="episode").start(caught(), table, streams())
    estimator.start(caught(reachable=False), table, streams())
