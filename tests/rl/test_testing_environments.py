"""`check_constrained_env`: right environments pass, each known-bad one is told what should be."""

import os
import time
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary

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


def after(change, base=Plain):
    """An environment with what `step` returns put through `change`."""

    class Changed(base):
        def step(self, action):
            return change(*super().step(action))

    return Changed


def declaring(base=Plain, **attributes):
    """An environment whose instances say something else of themselves; None for nothing."""

    class Declaring(base):
        def __init__(self):
            super().__init__()
            for name, value in attributes.items():
                delattr(self, name) if value is None else setattr(self, name, value)

    return Declaring


class Unseeded(Plain):
    def reset(self, **_):
        return super().reset()


class FromTheGlobalGenerator(Plain):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.cell = int(np.random.randint(5))  # noqa: NPY002
        return np.int64(self.cell), {}


class Buffered(Plain):
    """Cells as vectors in a dictionary, all of them in the same buffer, as a simulator hands them out."""

    def __init__(self):
        super().__init__()
        self.buffer = np.zeros(1)
        self.observation_space = gymnasium.spaces.Dict(x=Box(0, 4, (1,), np.float64))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.buffer[0] = self.cell
        return {"x": self.buffer}, {}

    def step(self, action):
        _, *rest = super().step(action)
        self.buffer[0] = self.cell
        return ({"x": self.buffer}, *rest)


class Scribbling(Plain):
    def __init__(self):
        super().__init__()
        self.action_space = MultiBinary(1)

    def step(self, action):
        answer = super().step(int(action[0]))
        action[:] = 1 - action
        return answer


class CostChannel(gymnasium.Wrapper):
    """A fourth channel, which only the wrapper declares."""

    def __init__(self, env, size=4):
        super().__init__(env)
        self.reward_space = Box(-5.0, 5.0, (size,), dtype=np.float64)

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, np.append(reward, 0.5), *rest)


WIDE = Box(-10.0, 10.0, (4,), dtype=np.float64)


def kernel_changed(change, base=ThreeStateEnv):
    """The three-state environment, which vouches for another kernel than its step has."""

    class Vouching(declaring(base, reward_space=WIDE)):
        def finite_kernel(self):
            kernel = super().finite_kernel()
            return change(kernel.transition_cumulative, kernel.rewards, kernel.start)

    return Vouching


class SlowArm(TwoLinkArmEnv):
    """Its kernels move twice as fast as its step."""

    def continuous_kernels(self):
        faster = TwoLinkArm(dt=2 * TwoLinkArm().dt).continuous_kernels()
        return replace(super().continuous_kernels(), constants=faster.constants)


BAD = {
    "scalar reward": (after(lambda o, r, *rest: (o, float(r[0]), *rest)), "reward should be an array of floats"),
    "NaN": (after(lambda o, r, *rest: (o, r * np.nan, *rest)), "should be finite; found"),
    "outside": (after(lambda o, r, *rest: (o, r * 1.5, *rest)), "should lie in reward_space"),
    "no info": (after(lambda o, r, *rest: (o, r, *rest[:2], None)), "info should be a dict; found None"),
    "four": (after(lambda o, r, *rest: (o, r, *rest[1:])), "step should return"),
    "flag": (after(lambda o, r, *rest: (o, r, "no", *rest[1:])), "terminated should be a truth value; found 'no'"),
    "observation": (after(lambda _, *rest: (np.int64(7), *rest)), r"observation should lie in Discrete\(5\)"),
    "unseeded": (Unseeded, r"should be the same after reset\(seed=0\)"),
    "global generator": (FromTheGlobalGenerator, "all randomness should come from self.np_random"),
    "one observation": (Buffered, "observation of step . should stay as it was, an array of its own"),
    "action": (Scribbling, r"the action of step . should not be written to; found \[.\], later \[.\]"),
    "event": (
        after(lambda *four: (*four[:4], {"cpgrl_event": 0})),
        r"info\['cpgrl_event'\] at a termination should be an integer ≥ 1, or missing; found 0",
    ),
    "no reward_space": (declaring(reward_space=None), "reward_space should be a Box"),
    "reward_dim": (declaring(reward_dim=4), "reward_dim should be 3, as reward_space has it; found 4"),
    "wrapper": (lambda: CostChannel(Plain(), 3), r"reward of step 0 should have shape \(3,\); found \(4,\)"),
    "kernel's rewards, in a wrapper": (
        lambda: gymnasium.wrappers.TimeLimit(kernel_changed(lambda p, r, s: FiniteKernel(p, -r, s))(), 50),
        r"the reward in state . for action . should be the kernel's",
    ),
    "kernel's channels": (
        kernel_changed(lambda p, r, s: FiniteKernel(p, r[[0, 2, 1, 3]], s)),
        "should be the kernel's.*in another order of channels",
    ),
    "kernel's transitions": (
        kernel_changed(lambda p, r, s: FiniteKernel(p[:, [0, 2, 1]], r, s)),
        "from state . action . should lead to . with the kernel's probability",
    ),
    "kernel's start": (
        kernel_changed(lambda p, r, _: FiniteKernel(p, r, 1)),
        "reset should lead to the kernel's start state 1; found 0",
    ),
    "arm's speed": (SlowArm, r"the mean square of the way from start to last state.* the same by kernels and by step"),
}


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_environment_is_told_what_should_be(bad):
    environment, message = BAD[bad]
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(environment(), steps=100)


GOOD = {
    "plain": Plain,
    "registered": lambda: gymnasium.make("cpgrl/ThreeState-v0"),
    "arm": TwoLinkArmEnv,
    "a wrapper's own reward_space": lambda: gymnasium.wrappers.TimeLimit(CostChannel(Plain()), 30),
    "kernels that are not the wrapper's": lambda: CostChannel(ThreeStateEnv(rewards=np.zeros((3, 3, 3)))),
    "kernels of another step": declaring(after(lambda o, r, *rest: (o, -r, *rest), ThreeStateEnv), reward_space=WIDE),
}


@pytest.mark.parametrize("good", GOOD)
def test_a_right_environment_passes_whatever_it_offers(good):
    check_constrained_env(GOOD[good](), steps=100, expected_reward=expected if good == "plain" else None)


def test_swapped_constraints_are_found_and_named_with_what_channels_should_yield():
    swapped = after(lambda o, r, *rest: (o, r[[0, 2, 1]], *rest))
    environment = declaring(swapped, reward_space=Box(-1.0, 4.0, (3,), dtype=np.float64))()
    check_constrained_env(environment, steps=100)  # nothing to tell the order by
    with pytest.raises(ContractBroken, match="the same numbers in another order of channels"):
        check_constrained_env(environment, steps=100, expected_reward=expected)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda *_: time.sleep(600),
            r"should come back; found no answer within 3 s; it was at .* in <lambda>",
        ),
        (lambda *_: os._exit(7), r"should come back; found the end of the process \(exit code 7\)"),
    ],
    ids=["hangs", "exits"],
)
def test_in_a_process_of_its_own_what_never_comes_back_is_a_broken_contract(act, message):
    with pytest.raises(ContractBroken, match=message):
        check_constrained_env(after(act)(), time_limit=3.0 if "3 s" in message else 60.0)
