"""What environments hand to compiled code."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from envs import FiniteKernel, TwoLinkArm, random_mdp
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
    for array in (kernel.transition_cumulative, kernel.rewards):
        assert array.flags.writeable
        assert array.flags.c_contiguous
        array[:] = 7  # its own
    assert 7 not in mdp.rewards


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


def test_the_stream_is_xoshiro256_plus_plus():
    """The authors' program begins so from the words 1, 2, 3, 4."""
    words = [
        41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205, 9973669472204895162,
        14011001112246962877, 12406186145184390807, 15849039046786891736, 10450023813501588000,
    ]  # fmt: skip
    one, other = np.arange(1, 5, dtype=np.uint64), np.arange(1, 5, dtype=np.uint64)
    assert [int(next_word(one)) for _ in words] == words
    assert [uniform(other) for _ in words] == [(word >> 11) / 2**53 for word in words]


KERNELS = TwoLinkArm().continuous_kernels()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"state_size": 0}, "state_size should be an integer ≥ 1"),
        ({"constants": np.array([[1.0]])}, "constants should have one axis"),
        ({"step": KERNELS.reset}, r"step should be compiled by numba for int64\(.*found \("),
        ({"reset": print}, "reset should be compiled by numba for void.*found builtin_function_or_method"),
    ],
)
def test_kernels_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(KERNELS, **change)
