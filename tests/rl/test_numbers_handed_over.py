"""What goes to and fro between environment and policy: finite numbers, or an error that says where; space's dtypes."""

import pickle
import re
from typing import Any

import numba
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, Tuple

from envs import RESET_SIGNATURE, STEP_SIGNATURE, ContinuousKernels
from rl import GPOMDP, DivergenceError, KondaActorCritic, LinearGaussian, NormalizedGaussianNetwork
from rl.rollout import RolloutError, episode

from .stand_ins import ONE_OF_TWO, Foreign, Given, estimate_of, learn, one

NAN, INF = np.nan, np.inf
QUIET = Box(-9.0, 9.0, (1,), np.float64)
ESTIMATOR = GPOMDP(steps=6)

# --- NaN and infinities (B5) -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("observation", "reward", "message"),
    [
        (np.zeros(1), [1.0, NAN], "reward of channel 1 should be finite; found nan"),
        (np.zeros(1), [-INF, 1.0], "reward of channel 0 should be finite; found -inf"),
        (np.array([INF], np.float32), [1.0, 1.0], "observation should be finite; found inf at [0]"),
        ({"x": (0, np.array([[1.0, NAN]]))}, [1.0, 1.0], "observation should be finite; found nan at ['x'][1][0, 1]"),
    ],
)
def test_what_is_not_finite_is_named_with_its_place(observation: Any, reward: Any, message: str) -> None:
    """At step 3 of the environment's fourth episode, which is the second one of the second run."""

    def break_off(own: Any, _: Any, right: Any) -> Any:
        return (observation, np.array(reward), *right[2:]) if (own.episodes, own.time) == (4, 4) else right

    place = re.escape(f"{message} (step 3, episode 2, run 8, Foreign)")
    with pytest.raises(RolloutError, match=f"^{place}$") as raised:
        learn(Foreign(break_off), ONE_OF_TWO, ESTIMATOR, episodes=9, runs=[3, 8])
    assert not isinstance(raised.value, DivergenceError)
    assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)  # as from another process


def always(value: Any) -> Any:
    return lambda *_: value


SHAPE = r"score of Given should be numbers of shape \(1,\), as θ; found"


@pytest.mark.parametrize(
    ("policy", "error", "message"),
    [
        (
            LinearGaussian(always(np.full(1, 1e200)), 1, 1, parameters=[1e200]), DivergenceError,
            r"action of LinearGaussian should be finite; found inf at \[0\], where max \|θ\| = 1e\+200",
        ),
        (Given(always(None)), ValueError, "sample of Given should return an action; found None"),
        (Given(score=always(np.zeros(2))), ValueError, rf"{SHAPE} float64, shape \(2,\)"),
        (Given(score=always(np.array([NAN]))), DivergenceError, "score of Given should be finite; found nan"),
    ],
)  # fmt: skip
def test_a_policys_flaw_is_named(policy: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=f"{message}.*step 0, episode 1, run 5, Foreign"), np.errstate(over="ignore"):
        learn(Foreign(action_space=QUIET), policy, ESTIMATOR, runs=[5])


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


@pytest.mark.parametrize("estimator", [KondaActorCritic(), GPOMDP(average="episode")])
def test_rewards_of_compiled_kernels_that_are_not_finite_are_named(estimator: Any) -> None:
    place = r"where max \|θ\| = 0 \(episode 1, run 4, Compiled"
    with pytest.raises(RolloutError, match=f"rewards of channel 1 should be finite; found a sum of nan, {place}"):
        learn(Compiled(), NormalizedGaussianNetwork([0], [9], (3,), 1), estimator, runs=[4])


# --- actions in the space's dtype (B6) ---------------------------------------------------------------------------


def recording(space: Any, *, strict: bool = True) -> Any:
    """Keeps its actions; strict: raises for what its action space does not contain, as many environments do."""
    actions: list[Any] = []

    def record(own: Any, action: Any, right: Any) -> Any:
        assert not strict or own.action_space.contains(action), repr(action)
        actions.append(action)
        return right

    return Foreign(record, action_space=space, actions=actions)


WIDE = Box(-100, 100, (2,), np.float32)


def floats(_: Any, rng: Any) -> Any:
    return rng.normal(size=2)


def bits(_: Any, rng: Any) -> Any:
    return rng.integers(2, size=3)


@pytest.mark.parametrize(
    ("space", "draw"),
    [
        (Discrete(2), ONE_OF_TWO.sample),
        (WIDE, floats),
        (WIDE, lambda _, rng: rng.integers(9, size=2)),
        (Box(-100, 100, (), np.float32), lambda _, rng: rng.normal()),
        (Box(0, 255, (3,), np.uint8), bits),
        (Dict(a=WIDE, b=Discrete(3)), lambda o, rng: {"a": floats(o, rng), "b": 1}),
        (Tuple([WIDE, MultiBinary(3)]), lambda o, rng: (floats(o, rng), bits(o, rng))),
    ],
)
def test_actions_lie_in_the_action_space(space: Any, draw: Any) -> None:
    environment = recording(space)
    estimate_of(environment, ESTIMATOR, Given(draw, always(np.ones(1))))
    assert len(environment.actions) == 6


def test_the_score_is_of_the_action_as_drawn_and_nothing_is_clipped() -> None:
    """θ = 7 and φ = 1 in a Box of ±1: ψ = u − 7; the environment gets u rounded to float32, out of its bounds."""
    environment = recording(Box(-1, 1, (1,), np.float32), strict=False)
    (step,) = episode(environment, LinearGaussian(one, 1, 1, parameters=[7.0]), np.random.default_rng(0), 1)
    rng = np.random.default_rng(0)
    rng.integers(2**31)  # the environment's seed
    drawn = 7 + rng.standard_normal(1)
    assert (step.action.tolist(), step.score.tolist()) == (drawn.tolist(), (drawn - 7).tolist())
    (action,) = environment.actions
    assert (action, action.dtype) == (np.float32(drawn), np.float32)
    assert action > 1
    assert drawn != action  # it was rounded, so the score could not be of both


@pytest.mark.parametrize(
    ("space", "action"), [(Box(0, 255, (1,), np.uint8), np.array([300])), (WIDE, np.array([1e300, 0.0]))]
)
def test_what_the_spaces_dtype_cannot_hold_goes_over_as_it_is(space: Any, action: Any) -> None:
    with pytest.raises(AssertionError, match="300"):  # the environment's own answer
        estimate_of(recording(space), GPOMDP(steps=2), Given(always(action), always(np.ones(1))))
