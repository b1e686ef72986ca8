"""What an environment hands to compiled code: arrays or compiled functions, and the state of their random stream.

numba is imported when `function_type` is called or kernels are handed over, not before.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Float64, UInt64
from ..markov_chain import require_one_class
from ..validation import finite_array, index_below, positive_integer

RESET_SIGNATURE = "void(float64[::1], uint64[::1], float64[::1])"
STEP_SIGNATURE = "int64(float64[::1], float64[::1], float64[::1], uint64[::1], float64[::1])"


@dataclass(frozen=True, init=False, eq=False)
class FiniteKernel:
    """A finite MDP for compiled code.

    The arrays are C-contiguous and *writeable* copies: a kernel compiled for `float64[:, :, ::1]` refuses read-only
    ones.

    Parameters
    ----------
    transition_cumulative
        (S, A, S), C(s, a, j) = Pr(s′ ≤ j | s, a), non-decreasing, exactly 1 from the last possible successor on; the
        next state is the first j with u < C(s, a, j), u uniform on [0, 1).
    rewards
        (1 + m, S, A).
    start
        First state of an episode.

    Raises
    ------
    ValueError
        For arrays that do not fit this.
    """

    transition_cumulative: Float64[np.ndarray, "states actions states"]
    rewards: Float64[np.ndarray, "channels states actions"]
    start: int

    def __init__(self, transition_cumulative: ArrayLike, rewards: ArrayLike, start: int = 0) -> None:
        C = finite_array("transition_cumulative", transition_cumulative).copy()
        r = finite_array("rewards", rewards).copy()
        if C.ndim != 3 or C.shape[0] != C.shape[2] or C.size == 0:
            raise ValueError(f"transition_cumulative should have shape (S, A, S); found {C.shape}")
        if r.ndim != 3 or r.shape[0] == 0 or r.shape[1:] != C.shape[:2]:
            raise ValueError(f"rewards should have shape (1 + m, {C.shape[0]}, {C.shape[1]}); found {r.shape}")
        if C.min() < 0 or (np.diff(C, axis=2) < 0).any() or (C[:, :, -1] != 1).any():
            raise ValueError("transition_cumulative should rise from ≥ 0 to 1; found a row that does not")
        object.__setattr__(self, "transition_cumulative", C)
        object.__setattr__(self, "rewards", r)
        object.__setattr__(self, "start", index_below("start", start, C.shape[0]))

    @property
    def reward_channels(self) -> int:
        """1 + m."""
        return len(self.rewards)

    def require_one_class(self) -> None:
        """ValueError where a policy that takes every action can be caught in more than one recurrent class.

        Then averages per step depend on where a run was caught. Only classes that `start` leads to count.
        """
        require_one_class(np.diff(self.transition_cumulative, axis=2, prepend=0.0) > 0, self.start)


@dataclass(frozen=True, eq=False)
class ContinuousKernels:
    """An environment with real vectors as states and actions, for compiled code.

    Parameters
    ----------
    state_size, action_size, reward_channels
        Lengths of the vectors.
    constants
        (k,), handed to both kernels at every call.
    reset, step
        numba functions compiled for `RESET_SIGNATURE` and `STEP_SIGNATURE`.
    max_steps
        An episode ends after so many: a time-out, no event.
    events
        Name of event k at events[k − 1].

    Raises
    ------
    ValueError
        For sizes below 1, constants that are not finite, kernels with other signatures.
    """

    state_size: int
    action_size: int
    reward_channels: int
    constants: Float64[np.ndarray, "constants"]
    reset: Callable[..., Any]
    step: Callable[..., Any]
    max_steps: int
    events: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("state_size", "action_size", "reward_channels", "max_steps"):
            object.__setattr__(self, name, positive_integer(name, getattr(self, name)))
        constants = finite_array("constants", self.constants).copy()  # writeable, as in FiniteKernel
        if constants.ndim != 1:
            raise ValueError(f"constants should have one axis; found shape {constants.shape}")
        object.__setattr__(self, "constants", constants)
        _require_compiled("reset", self.reset, RESET_SIGNATURE)
        _require_compiled("step", self.step, STEP_SIGNATURE)


def function_type(signature: str) -> Any:
    """The numba type of a function compiled for `signature`, as an argument of another compiled function.

    Raises
    ------
    ValueError
        For what is no signature of numba's.
    """
    from numba import types
    from numba.core import sigutils

    try:
        arguments, result = sigutils.normalize_signature(signature)
    except (NameError, SyntaxError, TypeError) as error:
        raise ValueError(f"signature should be one of numba's, as {STEP_SIGNATURE!r}; found {signature!r}") from error
    return types.FunctionType(result(*arguments))


def random_state(seed: np.random.SeedSequence) -> UInt64[np.ndarray, "4"]:
    """State of the generator inside kernels, xoshiro256++ (`random_stream`): four words of `seed`.

    One per run, from `SeedSequence.spawn`; every kernel of a run advances it in place.

    Raises
    ------
    ValueError
        For what is no SeedSequence.
    """
    if not isinstance(seed, np.random.SeedSequence):
        raise ValueError(f"seed should be a numpy.random.SeedSequence; found {seed!r}")
    return seed.generate_state(4, np.uint64)


def _require_compiled(name: str, kernel: Callable[..., Any], signature: str) -> None:
    from numba.core import sigutils

    compiled = getattr(kernel, "nopython_signatures", [])
    wanted = sigutils.normalize_signature(signature)
    if wanted not in [(found.args, found.return_type) for found in compiled]:
        found = ", ".join(map(str, compiled)) or type(kernel).__name__
        raise ValueError(f"{name} should be compiled by numba for {signature}; found {found}")
