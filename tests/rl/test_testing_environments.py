"""`check_constrained_env`: right environments pass, each known-bad one is told what should be."""

from dataclasses import replace
from functools import partial

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


class OneObservation(Plain):
    """Cells as vectors, all of them in the same buffer, as a simulator hands them out."""

    def __init__(self, form=lambda buffer: buffer, copy=False):
        super().__init__()
        space = Box(0, 4, (1,), np.float64)
        self.buffer, self.form, self.copy = np.zeros(1), form, copy
        self.observation_space = gymnasium.spaces.Dict(x=space) if isinstance(form(space), dict) else space

    def handed_out(self):
        self.buffer[0] = self.cell
        return self.form(self.buffer.copy() if self.copy else self.buffer)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        return self.handed_out(), {}

    def step(self, action):
        _, *rest = super().step(action)
        return (self.handed_out(), *rest)


class FirstObservation(OneObservation):
    """Only what reset hands out is written to later."""

    def step(self, action):
        _, *rest = super().step(action)
        return (self.buffer.copy(), *rest)


class Scribbling(Plain):
    def __init__(self):
        super().__init__()
        self.action_space = gymnasium.spaces.MultiBinary(1)

    def step(self, action):
        answer = super().step(int(action[0]))
        action[:] = 1 - action
        return answer


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
    "one observation": (OneObservation, "observation of step . should stay as it was, an array of its own"),
    "one observation in a dictionary": (
        partial(OneObservation, lambda buffer: {"x": buffer}),
        "observation of step . should stay as it was, an array of its own",
    ),
    "first observation": (FirstObservation, "observation of step 0 should stay as it was, an array of its own"),
    "action": (Scribbling, r"the action of step . should not be written to; found \[.\], later \[.\]"),
    "event": (
        after(lambda *four: (*four[:4], {"cpgrl_event": 0})),
        r"info\['cpgrl_event'\] at a termination should be an integer ≥ 1, or missing; found 0",
    ),
    "no reward_space": (without("reward_space"), "reward_space should be a Box"),
    "no action_space": (without("action_space"), "action_space should be a Gymnasium space"),
    "reward_space": (WrongSpace, "reward_space should be a Box of shape"),
    "reward_dim": (TwoDimensions, "reward_dim should be 3, as reward_space has it; found 4"),
}


OTHER_OBSERVATIONS = ("one observation", "one observation in a dictionary", "first observation", "action")


def test_a_right_environment_passes_whatever_it_offers():
    check_constrained_env(Plain(), expected_reward=expected)
    check_constrained_env(ThreeStateEnv(), steps=1000)
    check_constrained_env(gymnasium.make("cpgrl/ThreeState-v0"))


def test_the_arm_passes():
    check_constrained_env(TwoLinkArmEnv(), steps=100)


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_environment_is_told_what_should_be(bad):
    environment, message = BAD[bad]
    order = None if bad in OTHER_OBSERVATIONS else expected
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(environment(), expected_reward=order)


def test_copies_of_a_buffer_pass():
    check_constrained_env(OneObservation(copy=True))
    check_constrained_env(OneObservation(lambda buffer: {"x": buffer}, copy=True))


class CostChannel(gymnasium.Wrapper):
    """A fourth channel, which only the wrapper declares."""

    def __init__(self, env, size=4):
        super().__init__(env)
        self.reward_space = Box(-5.0, 5.0, (size,), dtype=np.float64)

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, np.append(reward, 0.5), *rest)


def test_a_wrappers_reward_space_is_the_one_that_counts():
    check_constrained_env(gymnasium.wrappers.TimeLimit(CostChannel(Plain()), 30))
    with pytest.raises(ContractBroken, match=r"reward of step 0 should have shape \(3,\); found \(4,\)"):
        check_constrained_env(CostChannel(Plain(), 3))
    check_constrained_env(CostChannel(ThreeStateEnv(rewards=np.zeros((3, 3, 3)))))  # its kernels are not the wrapper's


def test_kernels_within_a_wrapper_are_compared_with_the_step_that_they_stand_for():
    class Wrong(ThreeStateEnv):
        def __init__(self):
            super().__init__()
            self.reward_space = Box(-10.0, 10.0, (4,), dtype=np.float64)

        def finite_kernel(self):
            kernel = super().finite_kernel()
            return FiniteKernel(kernel.transition_cumulative, -kernel.rewards, kernel.start)

    with pytest.raises(ContractBroken, match=r"the reward in state . for action . should be the kernel's"):
        check_constrained_env(gymnasium.wrappers.TimeLimit(Wrong(), 50))


class OwnStep(ThreeStateEnv):
    """Rewards of the other sign: nothing for its class's kernel to say."""

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, -reward, *rest)


def test_a_step_of_ones_own_is_not_held_to_inherited_kernels():
    environment = OwnStep()
    environment.reward_space = Box(-10.0, 10.0, (4,), dtype=np.float64)
    check_constrained_env(environment)


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
