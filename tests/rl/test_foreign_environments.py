"""Other people's environments: buffers, events, wrappers, other libraries' answers."""

# ruff: noqa: ARG005 - stand-ins take what they ignore

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from cpgrl_opt import ConstrainedStep
from envs import ThreeStateEnv, TwoLinkArmEnv
from rl import CPGRL, GPOMDP, KondaActorCritic, LinearGaussian, LinearSoftmax, SoftmaxTable, train
from rl.channels import reward_channels
from rl.rollout import episode

from .stand_ins import ONE_OF_TWO, Foreign, Given, estimate_of, learn, one, streams

# --- what is handed out and written to later (B2) ----------------------------------------------------------------

FORMS: dict[str, Any] = {  # what is handed out, made of one buffer, and how a policy reads it
    "array": (lambda x: x, lambda o: o),
    "object": (lambda x: SimpleNamespace(x=x), lambda o: o.x),
    "nested": (lambda x: {"a": ({"x": x},)}, lambda o: o["a"][0]["x"]),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("weights", "size"), [("usual", 0.5), ("paper", 1.0)])
def test_a_step_is_scored_at_the_observation_that_the_policy_saw(form: str, weights: str, size: float) -> None:
    """x_t = t in one buffer, r_t = ±x_{t+1}, ψ_t = x_t(1[a] − ½), β = 0: (1·0 + 2·½)/2, or as printed 2·(0 + ½)."""
    x, (make, read) = np.zeros(1), FORMS[form]
    shared = make(x)

    def move(_: Any, action: Any, right: Any) -> Any:
        x[:] += 1
        return (shared, np.array([x[0], -x[0]]), *right[2:])

    environment = Foreign(move, lambda right: (x.fill(0), (shared, {}))[1])
    settings = GPOMDP(steps=2, trace_decay=0.0, weights=weights)
    policy = LinearSoftmax(read, 1, 2)
    _, estimate = estimate_of(environment, settings, policy)
    np.testing.assert_allclose(np.abs(estimate.gradients[0]), size)
    kept = list(episode(environment, policy, np.random.default_rng(0), 2))  # whoever keeps them finds what there was
    assert [(*read(step.observation), *read(step.following)) for step in kept] == [(0, 1), (1, 2)]


def test_a_reward_counts_as_it_was_at_its_step() -> None:
    """Rewards 3, then 5, in one array: ρ = 0.9 · 0.1 · 3 + 0.1 · 5."""
    reward = np.zeros(2)

    def reuse(own: Any, action: Any, right: Any) -> Any:
        reward[:] = [3.0, -3.0] if own.time == 1 else [5.0, -5.0]
        return right[0], reward, own.time == 2, False, {}

    _, estimate = estimate_of(Foreign(reuse), KondaActorCritic(average_rate=0.1, bias_correction=False), ONE_OF_TWO)
    assert estimate.rewards.tolist() == [[8.0, -8.0]]
    np.testing.assert_allclose(estimate.values, [[0.77, -0.77]])


def test_neither_environment_nor_policy_changes_what_was_drawn() -> None:
    estimator = KondaActorCritic(steps=4)
    policy, space, kept = LinearGaussian(one, 1, 1), Box(-9.0, 9.0, (1,), np.float64), []
    action, psi = np.zeros(1), np.zeros(1)

    def write(_: Any, action: Any, right: Any) -> Any:
        kept.append(action)
        for each in kept:
            each[:] = 1000.0
        return right

    def sample(observation: Any, rng: Any) -> Any:
        action[:] = policy.sample(observation, rng)
        return action

    def score(observation: Any, action: Any) -> Any:
        psi[:] = policy.score(observation, action)
        return psi

    plain, right = estimate_of(Foreign(action_space=space), estimator, policy)
    for answer, other in ((write, policy), (None, Given(sample, score))):
        found, estimate = estimate_of(Foreign(answer, action_space=space), estimator, other)
        np.testing.assert_array_equal(estimate.gradients, right.gradients)
        np.testing.assert_array_equal(found.critics, plain.critics)
    first, second = episode(Foreign(action_space=space), Given(sample, score), np.random.default_rng(0), 2)
    assert first.action != second.action


# --- events (B3) -------------------------------------------------------------------------------------------------


def ending(info: Any, **attributes: Any) -> Foreign:
    """Terminates after three steps, with an info of its own."""
    return Foreign(lambda own, _, right: (*right[:2], own.time == 3, False, info), **attributes)


@pytest.mark.parametrize(
    ("environment", "event"),
    [
        (ending({"cpgrl_event": 3}), 3),
        (ending({"ended by": np.int64(7), "cpgrl_event": 3}, event_key="ended by"), 7),
        (gymnasium.wrappers.TimeLimit(ending({"ended by": 7}, event_key="ended by"), 9), 7),
        (ending({"ended by": 0}, event_key="ended by"), 1),
        (ending({"ended by": True}, event_key="ended by"), 1),
        (ending({"ended by": np.array([7])}, event_key="ended by"), 1),
        (ending(None), 1),
        (ending({"event": 7}), 1),  # of somebody else's namespace
    ],
)
def test_an_event_is_counted_under_our_key_or_the_declared_one(environment: Any, event: int) -> None:
    assert estimate_of(environment, KondaActorCritic(), ONE_OF_TWO)[1].events.tolist() == [event]


# --- channels of wrappers (B7) -----------------------------------------------------------------------------------


class CostChannel(gymnasium.Wrapper):  # type: ignore[type-arg]
    reward_space = Box(np.array([-np.inf, -1.0]), np.array([np.inf, 0.0]), dtype=np.float64)

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, np.array([reward, -info["cost"]]), terminated, truncated, info


def costly() -> Any:
    """A scalar reward and a cost in info: action 1 yields 1 and costs 1, action 0 yields 0.5 and costs nothing."""
    found: Any = Foreign(
        lambda _, action, right: (0, 1.0 if action else 0.5, False, False, {"cost": float(action)}),
        lambda right: (0, {}), observation_space=Discrete(1), reward_space=None,
    )  # fmt: skip
    return found


def test_a_cost_in_info_becomes_a_channel_by_a_wrapper_and_a_constraint_is_met() -> None:
    """ρ¹ = (1 + p)/2, ρ² = −p ≥ −0.2: the best p is 0.2."""
    environment = gymnasium.wrappers.TimeLimit(CostChannel(costly()), 20)
    estimator = GPOMDP(trace_decay=0.0, average_rate=0.005, weights="usual")
    learner = CPGRL(ConstrainedStep(step_size=0.4, restoration_rate=0.4), thresholds=[-0.2])
    policy = SoftmaxTable(1, 2)
    *_, record = train(environment, policy, estimator, learner, episodes=150, runs=2)
    assert record.estimate.steps.tolist() == [20, 20]
    np.testing.assert_allclose(policy.probabilities(record.parameters)[:, 0, 1], 0.2, atol=0.1)
    np.testing.assert_allclose(record.estimate.values[:, 1], -0.2, atol=0.1)


class Fewer(gymnasium.Wrapper):  # type: ignore[type-arg]
    """The first two channels of more."""

    def __init__(self, env: Any, name: str) -> None:
        super().__init__(env)
        setattr(self, name, 2 if name == "reward_channels" else Box(-9, 9, (2,)))

    def step(self, action: Any) -> Any:
        observation, reward, *rest = self.env.step(action)
        return (observation, reward[:2], *rest)


@pytest.mark.parametrize("name", ["reward_space", "reward_channels"])
def test_the_outermost_declaration_of_channels_wins(name: str) -> None:
    environment = gymnasium.wrappers.TimeLimit(Fewer(gymnasium.make("cpgrl/ThreeState-v0"), name), 5)
    (record,) = learn(environment, SoftmaxTable(3, 3), GPOMDP())
    assert record.estimate.rewards.shape == (1, 2)
    assert reward_channels(gymnasium.make("cpgrl/ThreeState-v0")) == 4
    assert reward_channels(Fewer(TwoLinkArmEnv(), name)) == 2


class Scalar(gymnasium.Wrapper):  # type: ignore[type-arg]
    reward_space = Box(-9, 9, ())


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (
            Foreign(reward_channels=3),
            r"reward_channels and reward_space of Foreign should say the same; found 3 and shape \(2,\)",
        ),
        (Scalar(ThreeStateEnv()), r"reward_space of shape \(1 \+ m,\), as in MO-Gymnasium; found \(\) in Scalar"),
        (costly(), r"found none in Foreign.*gymnasium.Wrapper whose step returns np.array\(\[reward"),
        (object(), "environment should be a Gymnasium environment"),
    ],
)
def test_an_environment_without_channels_or_of_two_numbers_of_them_is_refused(environment: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GPOMDP().start(environment, SoftmaxTable(3, 3), streams())


# --- answers of other libraries (B8) -----------------------------------------------------------------------------

X = np.zeros(1)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ((X, 1.0, 0.0, False, False, {}), "found 6 values as in Safety-Gymnasium: .*wrapper"),
        ((X, 1.0, False, {}), "found 4 values as before Gymnasium: .*wrapper"),
        ((X, 1.0, False, False, {}), r"rewards should have shape \(2,\).*found one number: a wrapper makes"),
        ((X, ["1", "2"], False, False, {}), "rewards should be numbers, one for each channel; found"),
        (None, r"reset should return \(observation, info\), as in Gymnasium; found ndarray"),
    ],
)  # fmt: skip
def test_other_libraries_answers_are_told_from_gymnasiums(answer: Any, message: str) -> None:
    begin = (lambda right: right[0]) if answer is None else None
    with pytest.raises(ValueError, match=message):
        learn(Foreign(lambda *_: answer, begin), ONE_OF_TWO, GPOMDP(steps=3))
