"""Other people's environments and policies: buffers, events, wrappers, other libraries' answers."""

# ruff: noqa: ARG002 - stand-ins take what they ignore

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from cpgrl_opt import ConstrainedStep
from envs import ThreeStateEnv, TwoLinkArmEnv
from rl import (
    CPGRL,
    GPOMDP,
    KondaActorCritic,
    LinearGaussian,
    LinearSoftmax,
    NormalizedGaussianNetwork,
    SoftmaxTable,
    WeightedSum,
    train,
)
from rl.channels import reward_channels
from rl.streams import run_streams


def one(observation: Any) -> np.ndarray:
    """φ(x) = 1."""
    return np.ones(1)


def huge(observation: Any) -> np.ndarray:
    return np.full(1, 1e200)


STREAMS = [run_streams(0, 0).episodes]
ONE_OF_TWO = LinearSoftmax(one, 1, 2)


def estimate_of(environment: Any, estimator: Any, policy: Any) -> Any:
    estimation = estimator.start(environment, policy, STREAMS)
    return estimation, estimation.episode(np.array([policy.parameters]))


class Foreign(gymnasium.Env):  # type: ignore[type-arg]
    """One state, two actions, two channels; what a test needs else it overrides."""

    observation_space, action_space = Box(-np.inf, np.inf, (1,)), Discrete(2)
    reward_space = Box(-np.inf, np.inf, (2,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.time = 0
        return np.zeros(1), {}

    def step(self, action: Any) -> Any:
        self.time += 1
        return np.zeros(1), np.ones(2), False, False, {}


# --- what is handed out and written to later (B2) ----------------------------------------------------------------


class Box1:
    """A state of somebody's own class."""

    def __init__(self) -> None:
        self.x = np.zeros(1)


class Counting(Foreign):
    """x₀ = 0, x_{t+1} = x_t + 1, r_t = x_{t+1}, every observation in the same buffer."""

    def __init__(self, form: str) -> None:
        self.x = np.zeros(1)
        own = Box1()
        own.x = self.x
        shared: dict[str, Any] = {
            "array": self.x, "dict": {"x": self.x}, "tuple": (self.x, 0), "list": [self.x], "object": own,
            "nested": {"a": ({"x": self.x},)},
        }  # fmt: skip
        self.shared = shared[form]

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self.x[:] = 0
        return self.shared, {}

    def step(self, action: Any) -> Any:
        self.x += 1
        return self.shared, np.array([self.x[0], -self.x[0]]), False, False, {}


READ = {
    "array": lambda o: o, "dict": lambda o: o["x"], "tuple": lambda o: o[0], "list": lambda o: o[0],
    "object": lambda o: o.x, "nested": lambda o: o["a"][0]["x"],
}  # fmt: skip


@pytest.mark.parametrize("form", READ)
@pytest.mark.parametrize(("weights", "size"), [("usual", 0.5), ("paper", 1.0)])
def test_a_step_is_scored_at_the_observation_that_the_policy_saw(form: str, weights: str, size: float) -> None:
    """ψ_t = x_t(1[a] − ½), β = 0: (1·0 + 2·½)/2 with the usual weights, 2·(0 + ½) with the paper's, up to the sign."""
    policy = LinearSoftmax(READ[form], 1, 2)
    _, estimate = estimate_of(Counting(form), GPOMDP(steps=2, trace_decay=0.0, weights=weights), policy)
    np.testing.assert_allclose(np.abs(estimate.gradients[0]), size)


class Reusing(Foreign):
    """Rewards 3, then 5, in an array that every step writes to anew."""

    reward = np.zeros(2)

    def step(self, action: Any) -> Any:
        self.time += 1
        self.reward[:] = [3.0, -3.0] if self.time == 1 else [5.0, -5.0]
        return np.zeros(1), self.reward, self.time == 2, False, {}


@pytest.mark.parametrize("estimator", [KondaActorCritic(average_rate=0.1), GPOMDP(average_rate=0.1, weights="usual")])
def test_a_reward_counts_as_it_was_at_its_step(estimator: Any) -> None:
    _, estimate = estimate_of(Reusing(), estimator, ONE_OF_TWO)
    assert estimate.rewards.tolist() == [[8.0, -8.0]]
    if isinstance(estimator, KondaActorCritic):
        stored = estimator.start(Reusing(), ONE_OF_TWO, STREAMS)
        stored.episode(np.zeros((1, 2)))
        np.testing.assert_allclose(stored.average.per_step, [[0.77, -0.77]])  # 0.1·3, then 0.9·0.3 + 0.1·5


class Writing(Foreign):
    """Keeps the action and writes to it, now and later."""

    action_space = Box(-9.0, 9.0, (1,), np.float64)
    kept: list[Any] = []  # noqa: RUF012

    def step(self, action: Any) -> Any:
        self.kept.append(action)
        for each in self.kept:
            each[:] = 1000.0
        return super().step(action)


class Buffering:
    """A policy that hands out the same arrays over and over."""

    def __init__(self) -> None:
        self.inner = LinearGaussian(one, 1, 1)
        self.parameters = self.inner.parameters
        self.action, self.psi = np.zeros(1), np.zeros(1)

    def with_parameters(self, parameters: Any) -> Any:
        return self

    def sample(self, observation: Any, rng: Any) -> Any:
        self.action[:] = self.inner.sample(observation, rng)
        return self.action

    def score(self, observation: Any, action: Any) -> Any:
        self.psi[:] = self.inner.score(observation, action)
        return self.psi


class Quiet(Foreign):
    action_space = Box(-9.0, 9.0, (1,), np.float64)


@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=4), GPOMDP(steps=4)])
def test_neither_environment_nor_policy_changes_what_was_drawn(estimator: Any) -> None:
    policy = LinearGaussian(one, 1, 1)
    plain, right = estimate_of(Quiet(), estimator, policy)
    for environment, other in ((Writing(), policy), (Quiet(), Buffering())):
        found, estimate = estimate_of(environment, estimator, other)
        np.testing.assert_array_equal(estimate.gradients, right.gradients)
        if isinstance(estimator, KondaActorCritic):
            np.testing.assert_array_equal(found.critics, plain.critics)


# --- events (B3) -------------------------------------------------------------------------------------------------


class Ending(Foreign):
    """Terminates after three steps, with an info of its own."""

    def __init__(self, info: Any) -> None:
        self.info = info

    def step(self, action: Any) -> Any:
        self.time += 1
        return np.zeros(1), np.ones(2), self.time == 3, False, self.info


class Declaring(Ending):
    event_key = "ended by"


@pytest.mark.parametrize("event", [0, "goal", 7])
def test_an_event_of_somebody_elses_namespace_is_not_read(event: Any) -> None:
    policy = ONE_OF_TWO
    plain, right = estimate_of(Ending({}), KondaActorCritic(), policy)
    found, estimate = estimate_of(Ending({"event": event}), KondaActorCritic(), policy)
    assert estimate.events.tolist() == right.events.tolist() == [1]
    np.testing.assert_array_equal(found.critics, plain.critics)  # no bootstrap after a termination


@pytest.mark.parametrize(
    ("environment", "event"),
    [
        (Ending({"cpgrl_event": 3}), 3),
        (Declaring({"ended by": np.int64(7), "cpgrl_event": 3}), 7),
        (gymnasium.wrappers.TimeLimit(Declaring({"ended by": 7}), 9), 7),
        (Declaring({"ended by": 0}), 1),
        (Declaring({"ended by": True}), 1),
        (Declaring({"ended by": np.array([7])}), 1),
        (Ending(None), 1),
    ],
)
def test_an_event_is_counted_under_our_key_or_the_declared_one(environment: Any, event: int) -> None:
    for estimator in (KondaActorCritic(), GPOMDP()):
        assert estimate_of(environment, estimator, ONE_OF_TWO)[1].events.tolist() == [event]


def test_the_arms_events_are_counted_on_the_generic_path_too() -> None:
    environment = gymnasium.make("cpgrl/TwoLinkArm-v0", touch_radius=0.3, max_steps=30)
    estimation = GPOMDP(steps=100).start(environment, network(), [run_streams(0, run).episodes for run in range(40)])
    estimate = estimation.episode(np.zeros((40, 80)))
    assert set(estimate.events) >= {1, 2, 3}
    np.testing.assert_array_equal(estimate.rewards[:, 2], np.array([0, 0, -1, 1, 0])[estimate.events])


def network() -> NormalizedGaussianNetwork:
    return NormalizedGaussianNetwork(*TwoLinkArmEnv().arm.stops, (5, 8), 2)


# --- channels of wrappers (B7) -----------------------------------------------------------------------------------


class Costly(gymnasium.Env):  # type: ignore[type-arg]
    """A scalar reward and a cost in info: action 1 yields 1 and costs 1, action 0 yields 0.5 and costs nothing."""

    observation_space, action_space = Discrete(1), Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return 0, {}

    def step(self, action: Any) -> Any:
        return 0, 1.0 if action else 0.5, False, False, {"cost": float(action)}


class CostChannel(gymnasium.Wrapper):  # type: ignore[type-arg]
    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.reward_space = Box(np.array([-np.inf, -1.0]), np.array([np.inf, 0.0]), dtype=np.float64)

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, np.array([reward, -info["cost"]]), terminated, truncated, info


def test_a_cost_in_info_becomes_a_channel_by_a_wrapper_and_a_constraint_is_met() -> None:
    """ρ¹ = (1 + p)/2, ρ² = −p ≥ −0.2: the best p is 0.2."""
    environment = gymnasium.wrappers.TimeLimit(CostChannel(Costly()), 20)
    estimator = GPOMDP(trace_decay=0.0, average_rate=0.002, weights="usual")
    learner = CPGRL(ConstrainedStep(step_size=0.2, restoration_rate=0.2), thresholds=[-0.2])
    policy = SoftmaxTable(1, 2)
    *_, record = train(environment, policy, estimator, learner, episodes=400, runs=2)
    assert record.estimate.steps.tolist() == [20, 20]
    np.testing.assert_allclose(policy.probabilities(record.parameters)[:, 0, 1], 0.2, atol=0.08)
    np.testing.assert_allclose(record.estimate.values[:, 1], -0.2, atol=0.08)


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
    (record,) = train(environment, SoftmaxTable(3, 3), GPOMDP(), WeightedSum(), episodes=1, runs=1)
    assert record.estimate.rewards.shape == (1, 2)
    assert reward_channels(gymnasium.make("cpgrl/ThreeState-v0")) == 4
    assert reward_channels(Fewer(TwoLinkArmEnv(), name)) == 2


def test_an_environment_that_says_two_numbers_of_channels_is_refused() -> None:
    class Longer(ThreeStateEnv):
        def __init__(self) -> None:
            super().__init__()
            self.reward_space = Box(-9, 9, (5,))

        def step(self, action: Any) -> Any:
            observation, reward, *rest = super().step(action)
            return (observation, np.append(reward, 0.0), *rest)

    with pytest.raises(ValueError, match="reward_channels and reward_space of Longer should say the same; found 4 and"):
        GPOMDP().start(Longer(), SoftmaxTable(3, 3), STREAMS)


def test_a_reward_space_that_is_no_vectors_is_refused() -> None:
    class Scalar(gymnasium.Wrapper):  # type: ignore[type-arg]
        reward_space = Box(-9, 9, ())

    with pytest.raises(
        ValueError, match=r"reward_space of shape \(1 \+ m,\), as in MO-Gymnasium; found \(\) in Scalar"
    ):
        GPOMDP().start(Scalar(ThreeStateEnv()), SoftmaxTable(3, 3), STREAMS)
    with pytest.raises(
        ValueError, match=r"found none in Costly.*gymnasium.Wrapper whose step returns np.array\(\[reward"
    ):
        GPOMDP().start(Costly(), SoftmaxTable(1, 2), STREAMS)


# --- answers of other libraries (B8) -----------------------------------------------------------------------------


class Answering(Foreign):
    def __init__(self, step: Any = None, reset: Any = None) -> None:
        self.answers = step, reset

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return super().reset(seed=seed) if self.answers[1] is None else self.answers[1]

    def step(self, action: Any) -> Any:
        return super().step(action) if self.answers[0] is None else self.answers[0]


X = np.zeros(1)


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"step": (X, 1.0, 0.0, False, False, {})}, "found 6 values as in Safety-Gymnasium: .*wrapper"),
        ({"step": (X, 1.0, False, {})}, "found 4 values as before Gymnasium: .*wrapper"),
        ({"step": [X, 1.0, False, False, {}]}, "step should return .*; found list"),
        (
            {"step": (X, 1.0, False, False, {})},
            r"rewards should have shape \(2,\).*found one number: a wrapper makes",
        ),
        ({"step": (X, ["1", "2"], False, False, {})}, "rewards should be numbers, one for each channel; found"),
        ({"step": (X, [None, 1.0], False, False, {})}, "reward of channel 0 should be finite; found nan"),
        ({"reset": np.zeros(2)}, r"reset should return \(observation, info\), as in Gymnasium; found ndarray"),
    ],
)
def test_other_libraries_answers_are_told_from_gymnasiums(answers: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        list(train(Answering(**answers), ONE_OF_TWO, GPOMDP(steps=3), WeightedSum(), episodes=1, runs=1))
