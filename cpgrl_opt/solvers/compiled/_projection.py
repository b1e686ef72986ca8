"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E}, for B problems of one shape."""

from math import inf, ldexp

from numba import njit

from ._certificate import scaled_residuals
from ._dual_active_set import CONFLICT, LIMIT, dual_active_set
from ._least_violation import include_rows, pose_residual, relax, restore
from ._scaling import UNUSABLE, scale_problem
from ._workspace import (
    ACTIVE,
    BY_ROW,
    EXPONENT,
    IMPOSSIBLE,
    INCLUDED,
    KIND,
    MULTIPLIER,
    REFINED,
    THRESHOLD,
    VALUE,
    allocate,
    kernel,
)

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
# Attempts: in double precision; refined; refined, with looser ideas of what rounding is.
SHARPNESS = (2e-15, 2e-15, 1e-14, 1e-13)
LOOSE = 1e-14  # for the problems of least violation, whose constraints hold by a hair
EXACT = 1e-12  # worst residual that ends the attempts


@kernel
def judge(space, small, index, size, scale):
    """The worst residual of d and μ as they round when unscaled; leaves μ, by row, in THRESHOLD."""
    factor = ldexp(1.0, scale)
    for j in range(space.shape[1]):
        space[VALUE, j] = space[VALUE, j] * factor / factor
    for i in range(small.shape[1]):
        small[BY_ROW, i] = 0.0
        small[THRESHOLD, i] = 0.0
    for k in range(size):
        i = index[ACTIVE, k]
        small[THRESHOLD, i] = ldexp(small[MULTIPLIER, k], scale - index[EXPONENT, i])
        small[BY_ROW, i] = ldexp(small[THRESHOLD, i], index[EXPONENT, i] - scale)
    worst = 0.0
    for residual in scaled_residuals(space, small, index):
        if not residual <= worst:
            worst = residual
    return worst


@kernel
def write(space, small, scale, problem, value_out, multipliers_out):
    """The answer: VALUE, unscaled, and the multipliers in THRESHOLD."""
    factor = ldexp(1.0, scale)
    for j in range(space.shape[1]):
        value_out[problem * space.shape[1] + j] = space[VALUE, j] * factor
    for i in range(small.shape[1]):
        multipliers_out[problem * small.shape[1] + i] = small[THRESHOLD, i]


@kernel
def prove(small, index, bound, problem, conflict):
    """The Farkas vector into THRESHOLD: that of a zero row that asks for something, else that of the conflict.

    Returns whether there is one.
    """
    m, impossible = small.shape[1], -1
    for i in range(m):
        index[INCLUDED, i] = 0
        small[BY_ROW, i] = 0.0
        if index[KIND, i] == IMPOSSIBLE:
            impossible = i
    for i in range(m):
        if impossible >= 0:
            small[THRESHOLD, i] = 0.0
        elif conflict:
            small[THRESHOLD, i] = ldexp(small[THRESHOLD, i], -index[EXPONENT, i])
    if impossible >= 0:
        small[THRESHOLD, impossible] = 1.0 if bound[problem * m + impossible] > 0.0 else -1.0
    return conflict or impossible >= 0


@njit(
    "void(b1, Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 1, 'C', readonly=True),"
    "Array(b1, 1, 'C', readonly=True), f8, f8[::1], f8[::1], f8[::1])",
    cache=True,
    error_model="numpy",
    no_cfunc_wrapper=True,
)
def project_stacked(
    tangent, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report_out
):
    """B problems of one shape, each array with theirs one after the other: (B·n,), (B·m, n), (B·m,), (B·m,).

    report_out (3·B,): status, iterations, worst residual of each. tangent: no inequalities taken.
    """
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    space, small, index = allocate(m, n)
    for b in range(count):
        status, changes, worst, attempt, end = NUMERICAL_ERROR, 0, inf, 0, LIMIT
        scale = scale_problem(space, small, index, b, gradient, jacobian, bound, equality)
        for j in range(n):
            value_out[b * n + j] = 0.0
        for i in range(b * m, b * m + m):
            multipliers_out[i] = 0.0
            if tangent and not equality[i] and bound[i] > -inf:
                status, scale = UNSUPPORTED, UNUSABLE
        while scale < UNUSABLE and attempt < 4 and not (worst <= EXACT or worst <= tolerance) and end != CONFLICT:
            end, size, more = dual_active_set(space, small, index, attempt > 0, SHARPNESS[attempt])
            changes += more
            attempt += 1
            residual = judge(space, small, index, size, scale) if end != CONFLICT else inf
            if residual < worst:
                worst = residual
                write(space, small, scale, b, value_out, multipliers_out)
        if worst < inf:
            status = OPTIMAL if worst <= tolerance else (ITERATION_LIMIT if end == LIMIT else UNCERTIFIED)
        if scale < UNUSABLE and prove(small, index, bound, b, end == CONFLICT):
            status, worst = INFEASIBLE, inf
            write(space, small, scale, b, value_out, multipliers_out)
        included = include_rows(space, small, index) if end == CONFLICT else 0
        while included > 0:
            y_space, y_small, y_index = allocate(n + included, included)
            largest = pose_residual(space, small, index, y_space, y_small, y_index)
            end, size, more = dual_active_set(y_space, y_small, y_index, REFINED, LOOSE)
            relax(small, index, y_space, y_index, size, largest)
            end, size, more = dual_active_set(space, small, index, REFINED, LOOSE)
            for j in range(n):
                value_out[b * n + j] = space[VALUE, j] * ldexp(1.0, scale)
            included = include_rows(space, small, index)
            restore(small, index, b, equality)
        report_out[3 * b] = status
        report_out[3 * b + 1] = changes
        report_out[3 * b + 2] = worst
