"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E}, for B problems of one shape."""

from math import inf

import numpy as np
from numba import njit

from ._certificate import scaled_residuals
from ._dual_active_set import CONFLICT, LIMIT, dual_active_set
from ._least_violation import (
    FAR,
    count_included,
    include_violated,
    pose_relaxed_problem,
    pose_residual_problem,
    read_residual,
)
from ._scaling import impossible_zero_row, scale_problem
from ._workspace import (
    ACTIVE,
    BY_ROW,
    LENGTH,
    MULTIPLIER,
    ROWS,
    THRESHOLD,
    TRIANGLE,
    VALUE,
    kernel,
)

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
_EXACT = 1e-12  # worst residual that the method itself accepts before it tries again, sharper


@kernel
def write_answer(space, small, index, size, scale, value_out, multipliers_out):
    """Writes d and μ as they are returned, and judges them after that rounding; returns the worst residual."""
    for j in range(value_out.shape[0]):
        value_out[j] = space[VALUE, j] * scale
        space[VALUE, j] = value_out[j] / scale
    for i in range(multipliers_out.shape[0]):
        multipliers_out[i] = 0.0
        small[BY_ROW, i] = 0.0
    for k in range(size):
        i = index[ACTIVE, k]
        multipliers_out[i] = small[MULTIPLIER, k] * scale / small[LENGTH, i]
        small[BY_ROW, i] = multipliers_out[i] / scale * small[LENGTH, i]
    stationarity, primal, dual, complementarity = scaled_residuals(space, small, index)
    worst = stationarity
    for r in (primal, dual, complementarity):
        if not r <= worst:
            worst = r
    return worst


@kernel
def allocate(m, n):
    """A workspace for m rows in n coordinates."""
    return np.empty((ROWS + 2 * m, n)), np.empty((TRIANGLE + m, m)), np.empty((3, m), np.int64)


@kernel
def write_infeasible(space, small, scale, value_out):
    """Writes the d of least violation; returns the largest violation."""
    worst = 0.0
    for j in range(value_out.shape[0]):
        value_out[j] = space[VALUE, j] * scale
    for i in range(small.shape[1]):
        worst = max(worst, abs(small[BY_ROW, i]))
    return worst


@njit(
    "void(b1, Array(f8, 2, 'C', readonly=True), Array(f8, 3, 'C', readonly=True), Array(f8, 2, 'C', readonly=True),"
    "Array(b1, 2, 'C', readonly=True), f8, f8[:, ::1], f8[:, ::1], i8[::1], i8[::1], f8[::1])",
    cache=True,
    error_model="numpy",
)
def project_batch(
    tangent,
    gradient,
    jacobian,
    bound,
    equality,
    tolerance,
    value_out,
    multipliers_out,
    status_out,
    iterations_out,
    worst_out,
):
    """B problems of one shape."""
    count, m, n = jacobian.shape
    space, small, index = allocate(m, n)
    included = np.empty(m, np.bool_)
    goal = min(tolerance, _EXACT)
    for b in range(count):
        value, multipliers = value_out[b], multipliers_out[b]
        for j in range(n):
            value[j] = 0.0
        for i in range(m):
            multipliers[i] = 0.0
        status, changes, stage, worst = NUMERICAL_ERROR, 0, 0, inf
        scale = scale_problem(space, small, index, gradient[b], jacobian[b], bound[b], equality[b])
        now_space, now_small, now_index = space, small, index
        largest, end = 0.0, LIMIT
        supported = True
        for i in range(m):
            if tangent and not equality[b, i] and bound[b, i] > -inf:
                supported = False
        while scale < inf and supported:
            sharpness = 2e-15 if stage < 2 else (1e-13 if stage == 3 else 1e-14)
            end, size, more = dual_active_set(now_space, now_small, now_index, stage > 0, sharpness)
            changes += more
            if stage < 4:
                if end == CONFLICT:
                    status = INFEASIBLE
                    for i in range(m):
                        y = small[THRESHOLD, i]
                        multipliers[i] = y / small[LENGTH, i] if y != 0.0 else 0.0
                        included[i] = False
                    stage = 5
                else:
                    worst = write_answer(space, small, index, size, scale, value, multipliers)
                    if worst <= goal:
                        break
                    stage += 1
                    if stage == 4:
                        break
            elif stage == 4:
                read_residual(small, index, now_space, now_index, size, included, largest)
                now_space, now_small, now_index = allocate(m, n)
                pose_relaxed_problem(space, small, index, now_space, now_small, now_index)
                stage = 6
            else:
                for j in range(n):
                    space[VALUE, j] = now_space[VALUE, j]
                if not include_violated(space, small, index, included):
                    worst = write_infeasible(space, small, scale, value)
                    break
                stage = 5
            if stage == 5:
                rows = n + count_included(small, index, included, FAR)
                now_space, now_small, now_index = allocate(rows, rows - n)
                largest = pose_residual_problem(space, small, index, now_space, now_small, now_index, included)
                stage = 4
        if not supported:
            status = UNSUPPORTED
        if status == NUMERICAL_ERROR:
            if worst <= tolerance:
                status = OPTIMAL
            elif worst < inf:
                status = ITERATION_LIMIT if end == LIMIT else UNCERTIFIED
            else:
                for j in range(n):
                    value[j] = 0.0
                for i in range(m):
                    multipliers[i] = 0.0
        row = impossible_zero_row(small, bound[b], equality[b])
        if row >= 0 and scale < inf and supported:
            status = INFEASIBLE
            for i in range(m):
                multipliers[i] = 0.0
            multipliers[row] = 1.0 if bound[b, row] > 0.0 else -1.0
        status_out[b], iterations_out[b], worst_out[b] = status, changes, worst
