"""What goes to and fro between environment and policy: finite numbers, or an error that says where; space's dtypes."""

# ruff: noqa: ARG002, ARG005 - stand-ins take what they ignore

import pickle
import re
from typing import Any

import gymnasium
import numba
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, Tuple

from envs import RESET_SIGNATURE, STEP_SIGNATURE, ContinuousKernels
from rl import (
    GPOMDP,
    DivergenceError,
    KondaActorCritic,
    LinearGaussian,
    LinearSoftmax,
    NormalizedGaussianNetwork,
    WeightedSum,
    train,
)
from rl.rollout import RolloutError, episode
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


class Quiet(Foreign):
    action_space = Box(-9.0, 9.0, (1,), np.float64)


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


# --- NaN and infinities (B5) -------------------------------------------------------------------------------------


class Breaking(Foreign):
    """Right until step 3 of its fourth episode, which is the second one of the second run."""

    def __init__(self, observation: Any, reward: Any) -> None:
        self.broken, self.resets = (observation, np.array(reward)), 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self.resets += 1
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> Any:
        right = super().step(action)
        return (*self.broken, *right[2:]) if (self.resets, self.time) == (4, 4) else right


NAN, INF = np.nan, np.inf


@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=6), GPOMDP(steps=6)])
@pytest.mark.parametrize(
    ("observation", "reward", "message"),
    [
        (np.zeros(1), [1.0, NAN], "reward of channel 1 should be finite; found nan"),
        (np.zeros(1), [-INF, 1.0], "reward of channel 0 should be finite; found -inf"),
        (np.array([NAN]), [1.0, 1.0], "observation should be finite; found nan at [0]"),
        (np.array([INF], np.float32), [1.0, 1.0], "observation should be finite; found inf at [0]"),
        (NAN, [1.0, 1.0], "observation should be finite; found nan"),
        ({"x": (0, np.array([[1.0, NAN]]))}, [1.0, 1.0], "observation should be finite; found nan at ['x'][1][0, 1]"),
    ],
)
def test_what_is_not_finite_is_named_with_its_place(
    estimator: Any, observation: Any, reward: Any, message: str
) -> None:
    training = train(Breaking(observation, reward), ONE_OF_TWO, estimator, WeightedSum(), episodes=9, runs=[3, 8])
    place = re.escape(f"{message} (step 3, episode 2, run 8, Breaking)")
    with pytest.raises(RolloutError, match=f"^{place}$") as raised:
        list(training)
    assert not isinstance(raised.value, DivergenceError)
    assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)  # as from another process


def test_a_first_observation_that_is_not_finite_is_named() -> None:
    class Early(Foreign):
        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            return np.array([NAN]), {}

    with pytest.raises(
        RolloutError, match=r"^first observation should be finite; found nan at \[0\] \(step 0, episode 1"
    ):
        list(train(Early(), ONE_OF_TWO, GPOMDP(), WeightedSum(), episodes=1, runs=1))


@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=6), GPOMDP(steps=6)])
def test_an_action_that_is_not_finite_is_named_and_may_be_due_to_theta(estimator: Any) -> None:
    policy = LinearGaussian(huge, 1, 1, parameters=[1e200])
    message = (
        r"action of LinearGaussian should be finite; found inf at \[0\], where max \|θ\| = 1e\+200 \(step 0, .*run 5"
    )
    with pytest.raises(DivergenceError, match=message), np.errstate(over="ignore"):
        list(train(Quiet(), policy, estimator, WeightedSum(), episodes=1, runs=[5]))


class Flawed(Buffering):
    def __init__(self, action: Any = None, score: Any = None) -> None:
        super().__init__()
        self.flaws = {"sample": action, "score": score}

    def sample(self, observation: Any, rng: Any) -> Any:
        return super().sample(observation, rng) if self.flaws["sample"] is None else self.flaws["sample"]()

    def score(self, observation: Any, action: Any) -> Any:
        return super().score(observation, action) if self.flaws["score"] is None else self.flaws["score"]()


@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=6), GPOMDP(steps=6)])
@pytest.mark.parametrize(
    ("policy", "error", "message"),
    [
        (Flawed(action=lambda: None), ValueError, "sample of Flawed should return an action; found None"),
        (Flawed(action=lambda: np.array([NAN])), DivergenceError, "action of Flawed should be finite; found nan"),
        (
            Flawed(score=lambda: None),
            ValueError,
            r"score of Flawed should be numbers of shape \(1,\), as θ; found object",
        ),
        (Flawed(score=lambda: np.zeros(2)), ValueError, r"score of Flawed should be .*; found float64, shape \(2,\)"),
        (Flawed(score=lambda: np.array([NAN])), DivergenceError, "score of Flawed should be finite; found nan"),
    ],
)
def test_a_policys_flaw_is_named(estimator: Any, policy: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=f"{message}.*step 0, episode 1, run 0, Quiet"):
        list(train(Quiet(), policy, estimator, WeightedSum(), episodes=1, runs=1))


@numba.njit(RESET_SIGNATURE)
def begin(constants, random_state, state):  # type: ignore[no-untyped-def]
    state[0] = 0.0


@numba.njit(STEP_SIGNATURE)
def break_off(constants, state, action, random_state, reward):  # type: ignore[no-untyped-def]
    state[0] += 1.0
    reward[0], reward[1] = 1.0, np.sqrt(constants[0] - state[0])
    return 0


class Compiled:
    """√(2.5 − t) for a reward: NaN from the third step on."""

    reward_channels = 2

    def continuous_kernels(self) -> ContinuousKernels:
        return ContinuousKernels(1, 1, 2, np.array([2.5]), begin, break_off, 9)


@pytest.mark.parametrize("estimator", [KondaActorCritic(), GPOMDP(), GPOMDP(average="episode")])
def test_rewards_of_compiled_kernels_that_are_not_finite_are_named(estimator: Any) -> None:
    policy = NormalizedGaussianNetwork([0], [9], (3,), 1)
    message = (
        r"rewards of channel 1 should be finite; found a sum of nan, where max \|θ\| = 0 \(episode 1, run 4, Compiled"
    )
    with pytest.raises(RolloutError, match=message):
        list(train(Compiled(), policy, estimator, WeightedSum(), episodes=1, runs=[4]))


# --- actions in the space's dtype (B6) ---------------------------------------------------------------------------


class Strict(Foreign):
    """Raises for what its action space does not contain, as many environments do."""

    def __init__(self, space: Any) -> None:
        self.action_space, self.actions = space, []

    def step(self, action: Any) -> Any:
        assert self.action_space.contains(action), repr(action)
        self.actions.append(action)
        return super().step(action)


class Drawing:
    """A policy without parameters worth mention that draws by a function of a generator."""

    parameters = np.zeros(1)

    def __init__(self, draw: Any) -> None:
        self.draw = draw

    def with_parameters(self, parameters: Any) -> Any:
        return self

    def sample(self, observation: Any, rng: Any) -> Any:
        return self.draw(rng)

    def score(self, observation: Any, action: Any) -> Any:
        return np.ones(1)


WIDE = Box(-100, 100, (2,), np.float32)
FLOATS, BITS = lambda rng: rng.normal(size=2), lambda rng: rng.integers(2, size=3)


@pytest.mark.parametrize(
    ("space", "policy"),
    [
        (WIDE, LinearGaussian(one, 1, 2)),
        (Discrete(2), ONE_OF_TWO),
        (WIDE, Drawing(FLOATS)),
        (WIDE, Drawing(lambda rng: rng.integers(9, size=2))),
        (WIDE, Drawing(lambda rng: list(rng.normal(size=2)))),
        (Box(-100, 100, (), np.float32), Drawing(lambda rng: rng.normal())),
        (Box(-100, 100, (2,), np.float16), Drawing(FLOATS)),
        (Box(0, 255, (3,), np.uint8), Drawing(BITS)),
        (MultiBinary(3), Drawing(BITS)),
        (Dict(a=WIDE, b=Discrete(3)), Drawing(lambda rng: {"a": rng.normal(size=2), "b": 1})),
        (Tuple([WIDE, MultiBinary(3)]), Drawing(lambda rng: (rng.normal(size=2), BITS(rng)))),
    ],
)
@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=5), GPOMDP(steps=5)])
def test_actions_lie_in_the_action_space(estimator: Any, space: Any, policy: Any) -> None:
    environment = Strict(space)
    estimate_of(environment, estimator, policy)
    assert len(environment.actions) == 5


def test_the_score_is_of_the_action_as_drawn_and_nothing_is_clipped() -> None:
    """θ = 7 and φ = 1 in a Box of ±1: ψ = u − 7; the environment gets u rounded to float32, out of its bounds."""

    class Lax(Strict):
        def step(self, action: Any) -> Any:
            self.actions.append(action)
            return Foreign.step(self, action)

    environment, policy = Lax(Box(-1, 1, (1,), np.float32)), LinearGaussian(one, 1, 1, parameters=[7.0])
    (step,) = episode(environment, policy, np.random.default_rng(0), 1)
    rng = np.random.default_rng(0)
    rng.integers(2**31)  # the environment's seed
    drawn = 7 + rng.standard_normal(1)
    assert step.action.tolist() == drawn.tolist()
    assert step.score.tolist() == (drawn - 7).tolist()
    assert environment.actions == [np.float32(drawn)]
    assert environment.actions[0].dtype == np.float32
    assert environment.actions[0] > 1
    assert drawn != environment.actions[0]  # it was rounded, so the score could not be of both


def test_a_wrapper_clips_behind_the_policy() -> None:
    environment = Strict(Box(-1, 1, (1,), np.float32))
    policy = LinearGaussian(one, 1, 1, parameters=[7.0])
    _, estimate = estimate_of(gymnasium.wrappers.ClipAction(environment), GPOMDP(steps=5), policy)
    assert environment.actions == [1.0] * 5
    assert estimate.steps.tolist() == [5]


def test_what_the_spaces_dtype_cannot_hold_goes_over_as_it_is() -> None:
    for space, action in ((Box(0, 255, (1,), np.uint8), np.array([300])), (WIDE, np.array([1e300, 0.0]))):
        environment = Strict(space)
        with pytest.raises(AssertionError, match="300"):  # the environment's own answer
            estimate_of(environment, GPOMDP(steps=2), Drawing(lambda rng, action=action: action))
