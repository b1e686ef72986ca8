"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E}, for B problems of one shape."""

from math import inf, isfinite, ldexp

from numba import njit

from ._certificate import scaled_residuals
from ._dual_active_set import CONFLICT, LAST, LIMIT, LOOSE, PLAIN, POLISHING, dual_active_set
from ._least_violation import include_rows, pose_residual, relax, restore
from ._scaling import UNUSABLE, scale_problem
from ._workspace import (
    ACTIVE,
    BY_ROW,
    EPS,
    EQUALITY,
    EXPONENT,
    IMPOSSIBLE,
    INCLUDED,
    KIND,
    MULTIPLIER,
    ORIGIN,
    SPARE,
    TARGET,
    THRESHOLD,
    VALUE,
    Booleans,
    Floats,
    Integers,
    allocate,
    kernel,
)

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
# The referee's own rows are rounded: it may see this times Σ|μ̂| more in the stationarity than there is.
MARGIN = 1.25 * EPS
EXACT = 1e-12  # worst residual that ends the attempts


@kernel
def by_row(small: Floats, index: Integers, size: int) -> None:
    """BY_ROW = the multipliers, which are in order of activation."""
    for i in range(small.shape[1]):
        small[BY_ROW, i] = 0.0
    for k in range(size):
        small[BY_ROW, index[ACTIVE, k]] = small[MULTIPLIER, k]


@kernel
def pose_polishing(space: Floats, small: Floats, index: Integers) -> None:
    """The problem of the point nearest to d that keeps the rows with multipliers, as far as they are well apart.

    Where rows at an angle θ from opposing are active, another row can be violated by eps/θ though moving d by as much
    changes theirs by eps only, and μ ~ 1/θ allows for the move.
    """
    for j in range(space.shape[1]):
        space[ORIGIN, j] = space[TARGET, j]
        space[TARGET, j] = space[VALUE, j]
    for i in range(small.shape[1]):
        index[INCLUDED, i] = index[KIND, i]
        if small[BY_ROW, i] != 0.0:
            index[KIND, i] = EQUALITY


@kernel
def end_polishing(space: Floats, small: Floats, index: Integers) -> None:
    """The problem as it was, with the polished d."""
    for j in range(space.shape[1]):
        space[TARGET, j] = space[ORIGIN, j]
    for i in range(small.shape[1]):
        index[KIND, i] = index[INCLUDED, i]


@kernel
def judge(space: Floats, small: Floats, index: Integers, scale: int) -> float:
    """The worst residual of VALUE and BY_ROW as they round when unscaled; leaves μ, unscaled, in SPARE."""
    factor = ldexp(1.0, scale)
    for j in range(space.shape[1]):
        space[VALUE, j] = space[VALUE, j] * factor / factor
    for i in range(small.shape[1]):
        small[SPARE, i] = 0.0
        if small[BY_ROW, i] != 0.0:
            small[SPARE, i] = ldexp(small[BY_ROW, i], scale - index[EXPONENT, i])
            small[BY_ROW, i] = ldexp(small[SPARE, i], index[EXPONENT, i] - scale)
    worst = 0.0
    for residual in scaled_residuals(space, small, index, MARGIN):
        if not residual <= worst:
            worst = residual
    return worst


@kernel
def write(space: Floats, small: Floats, scale: int, problem: int, value_out: Floats, multipliers_out: Floats) -> None:
    """The answer: VALUE, unscaled, and the multipliers in SPARE."""
    factor = ldexp(1.0, scale)
    for j in range(space.shape[1]):
        value_out[problem * space.shape[1] + j] = space[VALUE, j] * factor
    for i in range(small.shape[1]):
        multipliers_out[problem * small.shape[1] + i] = small[SPARE, i]


@kernel
def overflows(answer: Floats, first: int, count: int) -> bool:
    """Whether a number left the range of float64 in the problem's own units."""
    finite = True
    for i in range(first, first + count):
        finite = finite and isfinite(answer[i])
    return not finite


@kernel
def prove(small: Floats, index: Integers, bound: Floats, problem: int, conflict: bool) -> bool:
    """The Farkas vector into SPARE: that of a zero row that asks for something, else that of the conflict.

    Returns whether there is one.
    """
    m, impossible, shift = small.shape[1], -1, 0
    for i in range(m):
        index[INCLUDED, i] = 0
        small[BY_ROW, i] = 0.0
        if index[KIND, i] == IMPOSSIBLE:
            impossible = i
        if conflict and small[THRESHOLD, i] != 0.0 and index[EXPONENT, i] < shift - 1000:
            shift = index[EXPONENT, i] + 1000  # or y would overflow; any multiple of it will do
    for i in range(m):
        if impossible >= 0:
            small[SPARE, i] = 0.0
        elif conflict:
            small[SPARE, i] = ldexp(small[THRESHOLD, i], shift - index[EXPONENT, i])
    if impossible >= 0:
        small[SPARE, impossible] = 1.0 if bound[problem * m + impossible] > 0.0 else -1.0
    return conflict or impossible >= 0


@njit(
    "void(b1, Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 1, 'C', readonly=True),"
    "Array(b1, 1, 'C', readonly=True), f8, f8[::1], f8[::1], f8[::1])",
    cache=True,
    error_model="numpy",
    no_cfunc_wrapper=True,
)
def project_stacked(
    tangent: bool,
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
    tolerance: float,
    value_out: Floats,
    multipliers_out: Floats,
    report_out: Floats,
) -> None:
    """B problems of one shape, each array with theirs one after the other: (B·n,), (B·m, n), (B·m,), (B·m,).

    report_out (3·B,): status, iterations, worst residual of each. tangent: no inequalities taken.
    """
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    space, small, index = allocate(m, n)
    goal = EXACT if tolerance > EXACT else tolerance
    for b in range(count):
        status, changes, worst, attempt, end = NUMERICAL_ERROR, 0, inf, PLAIN, LIMIT
        scale = scale_problem(space, small, index, b, gradient, jacobian, bound, equality)
        for j in range(n):
            value_out[b * n + j] = 0.0
        for i in range(b * m, b * m + m):
            multipliers_out[i] = 0.0
            if tangent and not equality[i] and bound[i] > -inf:
                status, scale = UNSUPPORTED, UNUSABLE
        while scale < UNUSABLE and attempt <= LAST and not worst <= goal and end != CONFLICT:
            end, size, more = dual_active_set(space, small, index, attempt)
            changes += more
            if end != CONFLICT:
                by_row(small, index, size)
            rounds = 0 if end == CONFLICT else (1 if attempt == PLAIN else 3)
            for polished in range(rounds):
                if polished > 0:
                    pose_polishing(space, small, index)
                    dual_active_set(space, small, index, POLISHING + polished - 1)
                    end_polishing(space, small, index)
                residual = judge(space, small, index, scale)
                if residual < worst:
                    worst = residual
                    write(space, small, scale, b, value_out, multipliers_out)
                if worst <= goal:
                    break
            attempt += 1
        if worst < inf:
            status = OPTIMAL if worst <= tolerance else (ITERATION_LIMIT if end == LIMIT else UNCERTIFIED)
        if scale < UNUSABLE and prove(small, index, bound, b, end == CONFLICT):
            status, worst = INFEASIBLE, inf
            write(space, small, scale, b, value_out, multipliers_out)
        included = include_rows(space, small, index) if end == CONFLICT else 0
        while included > 0:
            y_space, y_small, y_index = allocate(n + included, included)
            largest = pose_residual(space, small, index, y_space, y_small, y_index)
            end, size, more = dual_active_set(y_space, y_small, y_index, LOOSE)
            relax(small, index, y_space, y_index, size, largest)
            end, size, more = dual_active_set(space, small, index, LOOSE)
            for j in range(n):
                value_out[b * n + j] = space[VALUE, j] * ldexp(1.0, scale)
            included = include_rows(space, small, index)
            restore(small, index, b, equality)
        if overflows(value_out, b * n, n) or overflows(multipliers_out, b * m, m):
            status, worst = NUMERICAL_ERROR, inf
            for j in range(b * n, b * n + n):
                value_out[j] = 0.0
            for i in range(b * m, b * m + m):
                multipliers_out[i] = 0.0
        report_out[3 * b] = status
        report_out[3 * b + 1] = changes
        report_out[3 * b + 2] = worst
