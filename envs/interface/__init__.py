"""What an environment offers: vector rewards, and kernels for compiled training.

Generic path: a Gymnasium environment whose `step` returns an ndarray of rewards (MO-Gymnasium's convention).
Compiled path: arrays (`FiniteKernel`) for finite MDPs, compiled functions (`ContinuousKernels`) for the
others. `finite_kernel_of` and `continuous_kernels_of` say whether kernels stand for an environment: a subclass
that overrides code of the class that declared them trains by its own `step`. Of the modules here only
`random_stream`, for those that hold kernels, imports numba at once.

On the generic path an environment may declare an `event_key`: at a termination info[event_key] is then the
number, ≥ 1, of the event that ended the episode. Without one it is info["cpgrl_event"], and 1 if that is missing.

numba kernels of a continuous environment have exactly these signatures:

    reset(constants, random_state, state)                          fills state
    step(constants, state, action, random_state, reward) → event   moves state in place, fills reward

`event` is 0 while the episode runs and k ≥ 1 when it ended with the k-th event. The policy observes the
state. A rollout takes them as arguments of `function_type(...)` in an explicit signature of its own:

    @numba.njit([types.float64(function_type(RESET_SIGNATURE), function_type(STEP_SIGNATURE), …)], cache=True)

Then rollout and kernels all load from numba's disk cache in a new process; passed as plain dispatchers
without a signature, or captured in a closure, they would compile anew in each. Such a call costs about 0.2 ms
before the first step, so it should run whole episodes, better many.
"""

from .environments import (
    ContinuousEnvironment,
    FiniteEnvironment,
    VectorReward,
    continuous_kernels_of,
    finite_kernel_of,
)
from .kernels import (
    RESET_SIGNATURE,
    STEP_SIGNATURE,
    ContinuousKernels,
    FiniteKernel,
    function_type,
    random_state,
)
from .overrides import declaring_class, list_overrides, register_code

__all__ = [
    "RESET_SIGNATURE", "STEP_SIGNATURE", "ContinuousEnvironment", "ContinuousKernels", "FiniteEnvironment",
    "FiniteKernel", "VectorReward", "continuous_kernels_of", "declaring_class", "finite_kernel_of",
    "function_type", "list_overrides", "random_state", "register_code",
]  # fmt: skip
