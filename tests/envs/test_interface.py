"""What environments hand to compiled code."""

import subprocess
import sys
from functools import cache

import numba
import numpy as np
import pytest
from numba import types

from envs import (
    RESET_SIGNATURE,
    STEP_SIGNATURE,
    ContinuousEnvironment,
    ContinuousKernels,
    FiniteEnvironment,
    FiniteKernel,
    TabularMDP,
    ThreeStateMDP,
    VectorReward,
    function_type,
    random_mdp,
    random_state,
)
from envs.interface.random_stream import next_word, uniform


def test_importing_the_package_loads_nothing_heavy():
    heavy = ("numba", "scipy.optimize", "matplotlib", "cpgrl_opt", "rl")
    program = f"import sys, envs.interface; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_finite_kernel_holds_the_distribution_functions_of_the_mdp():
    mdp = random_mdp(np.random.default_rng(0), 4, 3, 2)
    kernel = mdp.finite_kernel()
    np.testing.assert_allclose(np.diff(kernel.transition_cumulative, axis=2, prepend=0), mdp.transitions, atol=1e-15)
    assert (kernel.transition_cumulative[:, :, -1] == 1).all()
    assert kernel.rewards.tolist() == mdp.rewards.tolist()
    assert (kernel.start, kernel.reward_channels) == (mdp.start, 2)


def test_no_draw_below_one_reaches_an_impossible_state():
    # 0.1 + 0.2 + 0.7 is 1 − 2⁻⁵³ or so: the largest draw must still stop at the last possible state.
    mdp = TabularMDP([[[0, 0.1, 0.2, 0.7, 0]]] * 5, np.zeros((1, 5, 1)))
    row = mdp.finite_kernel().transition_cumulative[0, 0]
    for draw, state in [(0.0, 1), (np.nextafter(1, 0), 3)]:
        assert np.argmax(draw < row) == state


def test_kernel_arrays_are_fresh_writeable_and_contiguous():
    mdp = ThreeStateMDP()
    kernel = mdp.finite_kernel()
    for array in (kernel.transition_cumulative, kernel.rewards):
        assert array.flags.writeable
        assert array.flags.c_contiguous
        array[:] = 0
    assert mdp.rewards.max() == 2


@pytest.mark.parametrize(
    ("cumulative", "rewards", "start", "message"),
    [
        (np.ones((2, 2)), np.zeros((1, 2, 2)), 0, "transition_cumulative should have shape"),
        ([[[1.0, 0.5, 1.0]]] * 3, np.zeros((1, 3, 1)), 0, "should rise from ≥ 0 to 1"),
        (np.ones((2, 1, 2)), np.zeros((1, 1, 2)), 0, "rewards should have shape"),
        (np.ones((2, 1, 2)), np.zeros((1, 2, 1)), 2, "start should be in 0 … 1"),
    ],
)
def test_arrays_that_make_no_finite_kernel_are_refused(cumulative, rewards, start, message):
    with pytest.raises(ValueError, match=message):
        FiniteKernel(cumulative, rewards, start)


def reference_words(state, count):
    """xoshiro256++ in Python's integers."""
    mask = 2**64 - 1

    def rotated(word, bits):
        return (word << bits | word >> (64 - bits)) & mask

    s, words = list(state), []
    for _ in range(count):
        words.append((rotated((s[0] + s[3]) & mask, 23) + s[0]) & mask)
        shifted = s[1] << 17 & mask
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= shifted
        s[3] = rotated(s[3], 45)
    return words


def test_the_stream_is_xoshiro256_plus_plus():
    state = random_state(np.random.SeedSequence(42))
    expected = reference_words(state.tolist(), 100)
    assert [int(next_word(state)) for _ in range(100)] == expected
    assert reference_words([1, 2, 3, 4], 3) == [41943041, 58720359, 3588806011781223]


def test_uniform_draws_fill_the_unit_interval():
    state = random_state(np.random.SeedSequence(0))
    draws = np.array([uniform(state) for _ in range(20_000)])
    assert 0 <= draws.min() < 1e-3 < 1 - 1e-3 < draws.max() < 1
    counts = np.histogram(draws, bins=20, range=(0, 1))[0]
    assert ((counts - 1000) ** 2 / 1000).sum() < 60  # χ² with 19 degrees of freedom: p ≈ 4e-6


def test_streams_are_fixed_by_their_seed_and_differ_between_children():
    seed = np.random.SeedSequence(7)
    first, second = (random_state(child) for child in seed.spawn(2))
    assert first.dtype == np.uint64
    assert first.shape == (4,)
    assert first.tolist() != second.tolist()
    assert random_state(np.random.SeedSequence(7, spawn_key=(0,))).tolist() == first.tolist()


@cache  # not compiled where another worker has the tests that need it
def reset_and_step():
    @numba.njit(RESET_SIGNATURE)
    def start_anywhere(constants, random_state, state):
        for i in range(state.size):
            state[i] = constants[0] * uniform(random_state)

    @numba.njit(STEP_SIGNATURE)
    def drift(constants, state, action, random_state, reward):
        state[0] += action[0]
        reward[0] = state[0]
        reward[1] = uniform(random_state)
        return 1 if state[0] > constants[1] else 0

    return start_anywhere, drift


class Line:
    """The smallest continuous environment: a point that drifts to the right until it is over the edge."""

    reward_channels = 2

    def continuous_kernels(self):
        return ContinuousKernels(1, 1, 2, np.array([0.5, 3.0]), *reset_and_step(), 100, ("over the edge",))


def test_one_compiled_rollout_takes_any_environments_kernels():
    @numba.njit(
        types.Tuple((types.int64, types.int64))(
            function_type(RESET_SIGNATURE),
            function_type(STEP_SIGNATURE),
            types.float64[::1],
            types.uint64[::1],
            types.float64[:, ::1],
        )
    )
    def rollout(reset, step, constants, random_state, rewards):
        state, action = np.empty(1), np.full(1, 0.25)
        reset(constants, random_state, state)
        for t in range(len(rewards)):
            event = step(constants, state, action, random_state, rewards[t])
            if event != 0:
                return t + 1, event
        return len(rewards), 0

    kernels = Line().continuous_kernels()
    rewards = np.zeros((kernels.max_steps, kernels.reward_channels))
    state = random_state(np.random.SeedSequence(3))
    words = reference_words(state.tolist(), 20)
    steps, event = rollout(kernels.reset, kernels.step, kernels.constants, state, rewards)
    begin = 0.5 * (words[0] >> 11) / 2**53
    assert steps == int(np.floor((3.0 - begin) / 0.25)) + 1
    assert kernels.events[event - 1] == "over the edge"
    np.testing.assert_allclose(rewards[:steps, 0], begin + 0.25 * np.arange(1, steps + 1), rtol=1e-14)
    assert rewards[:steps, 1].tolist() == [(word >> 11) / 2**53 for word in words[1 : steps + 1]]


def test_environments_are_told_apart_by_what_they_offer():
    assert isinstance(Line(), VectorReward)
    assert isinstance(Line(), ContinuousEnvironment)
    assert not isinstance(Line(), FiniteEnvironment)
    assert isinstance(ThreeStateMDP(), FiniteEnvironment)
    assert not isinstance(ThreeStateMDP(), ContinuousEnvironment)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"state_size": 0}, "state_size should be an integer ≥ 1"),
        ({"constants": np.array([[1.0]])}, "constants should have one axis"),
        ({"step": "reset"}, r"step should be compiled by numba for int64\(.*found \("),
        ({"reset": print}, "reset should be compiled by numba for void.*found builtin_function_or_method"),
    ],
)
def test_kernels_that_do_not_fit_are_refused(change, message):
    reset, step = reset_and_step()
    if change.get("step") == "reset":
        change = {"step": reset}
    good = {
        "state_size": 1,
        "action_size": 1,
        "reward_channels": 2,
        "constants": np.array([0.5, 3.0]),
        "reset": reset,
        "step": step,
        "max_steps": 100,
    }
    with pytest.raises(ValueError, match=message):
        ContinuousKernels(**{**good, **change})
