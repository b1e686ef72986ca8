"""Stored averages are means from the first number on; without correction they are eq. 4 as printed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from cpgrl_opt import ConstrainedStep
from envs import TabularEnv, TabularMDP, ThreeStateMDP, TwoLinkArm
from rl import CPGRL, GPOMDP, KondaActorCritic, LinearSoftmax, NormalizedGaussianNetwork, SoftmaxTable, train
from rl.experiments.arm import ArmExperiment
from rl.experiments.three_state import ThreeStateExperiment

from .stand_ins import Foreign, streams

ESTIMATORS = [GPOMDP(), GPOMDP(weights="usual"), KondaActorCritic()]
NAMES = ["GPOMDP", "usual", "Konda"]


def costly() -> Foreign:
    """Channel 1 is −10 a step, ten steps an episode."""
    return Foreign(
        lambda own, action, _: (0, np.array([float(action), -10.0]), own.time == 10, False, {}),
        lambda _: (0, {}), observation_space=Discrete(2),
    )  # fmt: skip


def actives(estimator: Any, threshold: float) -> list[bool]:
    learner = CPGRL(ConstrainedStep(), [threshold])
    records = train(costly(), SoftmaxTable(2, 2), estimator, learner, episodes=3, runs=2)
    return [bool(record.update.active.all()) for record in records]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=NAMES)
def test_a_constraint_is_judged_right_from_the_first_episode(estimator: Any) -> None:
    """−100 an episode against −50 was "satisfied" for 34 episodes; −10 a step is below −9 and above −11."""
    by_episode = replace(estimator, average="episode")
    assert actives(by_episode, -50.0) == [True] * 3
    assert actives(by_episode, -150.0) == [False] * 3
    assert actives(estimator, -9.0) == [True] * 3
    assert actives(estimator, -11.0) == [False] * 3
    assert actives(replace(by_episode, bias_correction=False), -50.0) == [False] * 3  # as printed


@pytest.mark.parametrize("rate", [1e-12, 0.7, 1.0])
@pytest.mark.parametrize("path", ["finite", "plain"])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=NAMES)
def test_of_equal_rewards_the_average_is_that_reward(estimator: Any, path: str, rate: float) -> None:
    mdp = TabularMDP(np.full((2, 2, 2), 0.5), [np.full((2, 2), -7.0), np.full((2, 2), 0.3)])
    environment: Any = mdp if path == "finite" else TabularEnv(mdp)
    policy: Any = SoftmaxTable(2, 2) if path == "finite" else LinearSoftmax(lambda s: np.eye(2)[s], 2, 2)
    settings = replace(estimator, average_rate=rate, steps=6, average=("step", "episode"))
    estimation = settings.start(environment, policy, streams(3))
    for _ in range(4):
        values = estimation.episode(np.zeros((3, 4))).values
        np.testing.assert_allclose(values, np.tile([-7.0, 1.8], (3, 1)), rtol=1e-12)


@pytest.mark.parametrize("estimator", [GPOMDP, KondaActorCritic])
def test_the_correction_divides_by_the_sum_of_the_weights(estimator: Any) -> None:
    """In a compiled environment with episodes of many lengths; eq. 4 as printed is the same program's."""
    arm = TwoLinkArm(touch_radius=0.2)
    settings = [estimator(average_rate=0.1, steps=40, bias_correction=flag) for flag in (True, False)]
    policy = NormalizedGaussianNetwork(*arm.stops, (5, 8), 2)
    corrected, printed = (each.start(arm, policy, streams(4)) for each in settings)
    steps, missed = np.zeros(4), estimator is GPOMDP  # with weights "paper" the first step does not enter
    for _ in range(3):
        found, raw = (estimation.episode(np.zeros((4, 80))) for estimation in (corrected, printed))
        steps += found.steps - missed
        np.testing.assert_allclose(found.values, raw.values / (1 - 0.9**steps)[:, None], rtol=1e-12)


def test_konda_s_critics_subtract_the_corrected_average() -> None:
    """Rewards that do not depend on anything leave nothing to criticise: w stays 0, which eq. 4 from 0 does not."""
    mdp = TabularMDP(np.full((2, 2, 2), 0.5), [np.full((2, 2), 5.0)])
    for flag in (True, False):
        settings = KondaActorCritic(steps=30, bias_correction=flag)
        estimation: Any = settings.start(mdp, SoftmaxTable(2, 2), [np.random.SeedSequence(1)])
        estimation.episode(np.zeros((1, 4)))
        assert (np.abs(estimation.critics).max() < 1e-12) == flag


def test_the_reproductions_keep_equation_4_as_printed_and_name_it() -> None:
    assert not ThreeStateExperiment().estimator().bias_correction
    assert not ArmExperiment().gradient_estimator("b").bias_correction  # type: ignore[attr-defined]


def test_averages_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="average_rate should be above 0, since ρ would never leave 0; found 0"):
        GPOMDP(average_rate=0)
    assert GPOMDP(average_rate=0, bias_correction=False).average_rate == 0
    with pytest.raises(ValueError, match="bias_correction should be True or False; found 'off'"):
        GPOMDP(bias_correction="off")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"average should be one of step, episode.*found 'year'"):
        GPOMDP(average=("step", "year"))
    with pytest.raises(ValueError, match="average should be one kind, or 4, one for each channel; found 2"):
        GPOMDP(average=("step", "episode")).start(ThreeStateMDP(), SoftmaxTable(3, 3), streams())
