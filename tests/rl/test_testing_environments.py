"""`check_constrained_env`: right environments pass, each known-bad one is told what should be."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from envs import FiniteKernel, ThreeStateEnv, TwoLinkArm, TwoLinkArmEnv
from rl.testing import ContractBroken, check_constrained_env


class Plain(gymnasium.Env):
    """Two constraints on a walk of five cells, no kernels; a right environment that mutants spoil."""

    def __init__(self):
        self.observation_space, self.action_space = Discrete(5), Discrete(2)
        self.reward_space = Box(np.array([0.0, -1.0, 0.0]), np.array([4.0, 1.0, 1.0]), dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.cell = int(self.np_random.integers(5))
        return np.int64(self.cell), {}

    def step(self, action):
        before = self.cell
        slip = self.np_random.random() < 0.2
        self.cell = int(np.clip(before + (1 if action == 1 and not slip else -1), 0, 4))
        return np.int64(self.cell), expected(before, action, self.cell), self.cell == 4, False, {}


def expected(observation, action, following):
    return np.array([float(following), 1.0 - 2.0 * action, float(observation == 0)])


def after(change):
    """Plain with what `step` returns put through `change`."""

    class Changed(Plain):
        def step(self, action):
            return change(*super().step(action))

    return Changed


def without(name):
    class Lacking(Plain):
        def __init__(self):
            super().__init__()
            delattr(self, name)

    return Lacking


class Unseeded(Plain):
    def reset(self, **_):
        return super().reset()


class FromTheGlobalGenerator(Plain):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.cell = int(np.random.randint(5))  # noqa: NPY002
        return np.int64(self.cell), {}


class OneArray(Plain):
    kept = np.zeros(3)

    def step(self, action):
        observation, reward, *rest = super().step(action)
        self.kept[:] = reward
        return (observation, self.kept, *rest)


class WrongSpace(Plain):
    def __init__(self):
        super().__init__()
        self.reward_space = Box(0.0, 1.0, (3, 1))


class TwoDimensions(Plain):
    reward_dim = 4


BAD = {
    "scalar reward": (after(lambda o, r, *rest: (o, float(r[0]), *rest)), "reward should be an array of floats"),
    "list": (after(lambda o, r, *rest: (o, r.tolist(), *rest)), "reward should be an array of floats"),
    "integers": (after(lambda o, r, *rest: (o, r.astype(int), *rest)), "reward should be an array of floats"),
    "too long": (
        after(lambda o, r, *rest: (o, np.append(r, 0.0), *rest)),
        r"should have shape \(3,\); found \(4,\)",
    ),
    "NaN": (after(lambda o, r, *rest: (o, r * np.nan, *rest)), "should be finite; found"),
    "outside": (after(lambda o, r, *rest: (o, r * 1.5, *rest)), "should lie in reward_space"),
    "no info": (after(lambda o, r, *rest: (o, r, *rest[:2], None)), "info should be a dict; found None"),
    "four": (after(lambda o, r, *rest: (o, r, *rest[1:])), "step should return"),
    "flag": (after(lambda o, r, *rest: (o, r, "no", *rest[1:])), "terminated should be a truth value; found 'no'"),
    "observation": (
        after(lambda _, *rest: (np.int64(7), *rest)),
        r"observation should lie in Discrete\(5\)",
    ),
    "swapped": (after(lambda o, r, *rest: (o, r[[1, 0, 2]], *rest)), "should lie in reward_space|another order"),
    "unseeded": (Unseeded, r"should be the same after reset\(seed=0\)"),
    "global generator": (FromTheGlobalGenerator, "all randomness should come from self.np_random"),
    "one array": (OneArray, "an array of its own"),
    "no reward_space": (without("reward_space"), "reward_space should be a Box"),
    "no action_space": (without("action_space"), "action_space should be a Gymnasium space"),
    "reward_space": (WrongSpace, "reward_space should be a Box of shape"),
    "reward_dim": (TwoDimensions, "reward_dim should be 3, as reward_space has it; found 4"),
}


def test_a_right_environment_passes_whatever_it_offers():
    check_constrained_env(Plain(), expected_reward=expected)
    check_constrained_env(ThreeStateEnv(), steps=1000)
    check_constrained_env(gymnasium.make("cpgrl/ThreeState-v0"))


def test_the_arm_passes():
    check_constrained_env(TwoLinkArmEnv(), steps=100)


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_environment_is_told_what_should_be(bad):
    environment, message = BAD[bad]
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(environment(), expected_reward=expected)


def test_swapped_constraints_are_found_and_named_with_what_channels_should_yield():
    environment = after(lambda o, r, *rest: (o, r[[0, 2, 1]], *rest))()
    environment.reward_space = Box(-1.0, 4.0, (3,), dtype=np.float64)
    check_constrained_env(environment)  # nothing to tell the order by
    with pytest.raises(ContractBroken, match="the same numbers in another order of channels"):
        check_constrained_env(environment, expected_reward=expected)


class SwappedChannels(ThreeStateEnv):
    """Vouches for a kernel whose channels stand in another order; without that its step alone would count."""

    def finite_kernel(self):
        return super().finite_kernel()

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, reward[[0, 2, 1, 3]], *rest)


class OtherTransitions(ThreeStateEnv):
    def finite_kernel(self):
        kernel = super().finite_kernel()
        return FiniteKernel(kernel.transition_cumulative[:, [0, 2, 1]], kernel.rewards, kernel.start)


class OtherStart(ThreeStateEnv):
    def finite_kernel(self):
        return replace_start(super().finite_kernel())


def replace_start(kernel):
    return FiniteKernel(kernel.transition_cumulative, kernel.rewards, 1)


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (SwappedChannels, "should be the kernel's.*in another order of channels"),
        (OtherTransitions, "from state . action . should lead to . with the kernel's probability"),
        (OtherStart, "reset should lead to the kernel's start state 1; found 0"),
    ],
)
def test_a_step_that_differs_from_the_finite_kernel_is_found(environment, message):
    environment = environment()
    environment.reward_space = Box(-10.0, 10.0, (4,), dtype=np.float64)
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(environment)


class SlowArm(TwoLinkArmEnv):
    """Its kernels move twice as fast as its step."""

    def continuous_kernels(self):
        kernels = super().continuous_kernels()
        faster = TwoLinkArm(dt=2 * TwoLinkArm().dt).continuous_kernels()
        return replace(kernels, constants=faster.constants)


class SwappedArm(TwoLinkArmEnv):
    def continuous_kernels(self):
        return super().continuous_kernels()

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, reward[[1, 0, 2]], *rest)


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (SlowArm, r"the mean square of the way from start to last state.* should be the same by kernels and by step"),
        (SwappedArm, "sum of reward channel"),
    ],
)
def test_a_step_that_differs_from_the_continuous_kernels_is_found(environment, message):
    environment = environment()
    environment.reward_space = Box(-10.0, 10.0, (3,), dtype=np.float64)
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(environment, steps=50)
