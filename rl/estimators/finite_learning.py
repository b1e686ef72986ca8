"""Episodes on a finite MDP with the usual update of θ after each, compiled: many in one call.

Importing this module loads the kernels that it is made of, or compiles them.
"""

import numpy as np

from cpgrl_opt.direct_step import move_parameters

from .._kernels import kernel
from .finite_gpomdp_kernels import advance

_advance, _move = advance.machine_code, move_parameters.machine_code


@kernel(
    "int64(uint64[:, :, ::1], float64[:, ::1], int64, int64, int64, boolean[::1], float64[::1], float64, float64, "
    "float64, uint64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64, float64[:, :, ::1], "
    "float64[:, :, ::1], float64[:, :, :, ::1], float64[:, :, ::1], boolean[:, :, ::1], int64[:, ::1], "
    "float64[:, :, ::1])"
)
def learn(  # type: ignore[no-untyped-def]
    transitions, rewards, start, steps, first, from_start, divisors, trace_decay, following, average_rate,
    random_states, averages,  # as `advance` has them
    thresholds,  # (m,)
    settings, max_change,  # as `move_parameters` and `LearningEstimation` have them
    parameters,  # (1 + K, B, n), the first given, the others filled
    values, gradients, reward_sums,  # (K, B, 1 + m), (K, B, 1 + m, n), (K, B, 1 + m), filled, as are the others
    active, flat, change,  # (K, B, m), (K, B), (K, B, n)
):  # fmt: skip
    """K episodes, each with the usual update of θ: 𝒜 = {i: ρⁱ ≤ Gⁱ}, then `move_parameters`.

    Returns how many updates were made: where it is less than K, one more episode is there, whose update is not the
    usual one, or not finite, or too far.
    """
    count, runs, n = change.shape
    slack = np.empty((runs, thresholds.size))
    multipliers, residuals, predicted = np.empty(slack.shape), np.empty((runs, 4)), np.empty(slack.shape)
    for k in range(count):
        _advance(
            parameters[k], transitions, rewards, start, steps, first, from_start, divisors, trace_decay, following,
            average_rate, random_states, averages, gradients[k], reward_sums[k],
        )  # fmt: skip
        usual = True
        for run in range(runs):
            for i in range(averages.shape[1]):
                values[k, run, i] = averages[run, i]  # one by one: numba takes 4 s to compile a copy of arrays
                usual = usual and abs(values[k, run, i]) < np.inf and abs(reward_sums[k, run, i]) < np.inf
            for i in range(thresholds.size):
                slack[run, i] = values[k, run, 1 + i] - thresholds[i]
                active[k, run, i] = slack[run, i] <= 0.0
                usual = usual and abs(slack[run, i]) < np.inf
        usual = usual and _move(
            gradients[k], slack, active[k], settings, flat[k], change[k], multipliers, residuals, predicted
        )
        for run in range(runs):
            for j in range(n):
                parameters[k + 1, run, j] = parameters[k, run, j] + change[k, run, j]
                near = abs(change[k, run, j]) <= max_change and abs(parameters[k + 1, run, j]) < np.inf
                usual = usual and near
        if not usual:
            return k
    return count
