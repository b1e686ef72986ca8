"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E}, for B problems of one shape."""

from math import inf

from numba import njit

from ._certificate import scaled_residuals
from ._dual_active_set import CONFLICT, LIMIT, dual_active_set
from ._least_violation import include_violated, pose_nearest, pose_residual
from ._scaling import scale_problem
from ._workspace import (
    ACTIVE,
    BY_ROW,
    IMPOSSIBLE,
    KIND,
    LENGTH,
    MULTIPLIER,
    THRESHOLD,
    VALUE,
    allocate,
    kernel,
)

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
# Attempts: in double precision; refined; refined with looser ideas of rounding. Then the two problems of least violation.
SHARPNESS = (2e-15, 2e-15, 1e-14, 1e-13, 1e-14, 1e-14)
RESIDUAL, NEAREST = 4, 5
EXACT = 1e-12  # worst residual that ends the attempts


@kernel
def write_answer(space, small, index, size, scale, best, value_out, multipliers_out):
    """Judges d and μ as they round when returned; writes them if better than the best so far. The better worst."""
    m = small.shape[1]
    for j in range(value_out.shape[0]):
        space[VALUE, j] = space[VALUE, j] * scale / scale
    for i in range(m):
        small[BY_ROW, i] = 0.0
        small[THRESHOLD, i] = 0.0
    for k in range(size):
        i = index[ACTIVE, k]
        small[THRESHOLD, i] = small[MULTIPLIER, k] * scale / small[LENGTH, i]
        small[BY_ROW, i] = small[THRESHOLD, i] / scale * small[LENGTH, i]
    worst = 0.0
    for residual in scaled_residuals(space, small, index):
        if not residual <= worst:
            worst = residual
    if not worst < best:
        return best
    for j in range(value_out.shape[0]):
        value_out[j] = space[VALUE, j] * scale
    for i in range(m):
        multipliers_out[i] = small[THRESHOLD, i]
    return worst


@kernel
def write_proof(small, index, status, multipliers_out):
    """Writes the Farkas vector: of the conflict, or of a zero row that asks for something; returns the status."""
    m = small.shape[1]
    for i in range(m):
        if status == INFEASIBLE:
            y = small[THRESHOLD, i]
            multipliers_out[i] = y / small[LENGTH, i] if y != 0.0 else 0.0
    return status


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
    goal = EXACT if EXACT < tolerance else tolerance
    for b in range(count):
        value, multipliers = value_out[b], multipliers_out[b]
        status, changes, worst, stage, end, largest = NUMERICAL_ERROR, 0, inf, 0, LIMIT, 0.0
        scale = scale_problem(space, small, index, gradient[b], jacobian[b], bound[b], equality[b])
        for j in range(n):
            value[j] = 0.0
        for i in range(m):
            multipliers[i] = 0.0
            if tangent and not equality[b, i] and bound[b, i] > -inf:
                status, scale = UNSUPPORTED, inf
        now_space, now_small, now_index = space, small, index
        while scale < inf:
            end, size, more = dual_active_set(now_space, now_small, now_index, stage > 0, SHARPNESS[stage])
            changes += more
            if stage < RESIDUAL and end != CONFLICT:
                worst = write_answer(space, small, index, size, scale, worst, value, multipliers)
                stage += 1
                if worst <= goal or stage == RESIDUAL:
                    break
                continue
            if stage == RESIDUAL:
                dual_space, dual_index = now_space, now_index
                now_space, now_small, now_index = allocate(m, n)
                pose_nearest(
                    space, small, index, dual_space, dual_index, size, largest, now_space, now_small, now_index
                )
                stage = NEAREST
                continue
            if stage < RESIDUAL:
                status = write_proof(small, index, INFEASIBLE, multipliers)
            else:
                for j in range(n):
                    space[VALUE, j] = now_space[VALUE, j]
                    value[j] = space[VALUE, j] * scale
            included = include_violated(space, small, index, stage < RESIDUAL)
            if included == 0:
                break
            now_space, now_small, now_index = allocate(n + included, included)
            largest = pose_residual(space, small, index, now_space, now_small, now_index)
            stage = RESIDUAL
        if scale < inf and status != INFEASIBLE and worst < inf:
            status = OPTIMAL if worst <= tolerance else (ITERATION_LIMIT if end == LIMIT else UNCERTIFIED)
        for i in range(m):
            if index[KIND, i] == IMPOSSIBLE and scale < inf:
                for k in range(m):
                    multipliers[k] = 0.0
                multipliers[i] = 1.0 if bound[b, i] > 0.0 else -1.0
                status = INFEASIBLE
        status_out[b], iterations_out[b], worst_out[b] = status, changes, worst
