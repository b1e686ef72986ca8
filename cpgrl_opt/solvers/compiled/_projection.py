"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E} for B problems of one shape: the entry point."""

from math import inf, sqrt

import numpy as np

from ._arithmetic import add, add_product, dot
from ._dual_active_set import CONFLICT, LIMIT, dual_active_set
from ._entry_point import entry_point, kernel
from ._scaling import UNUSABLE, scale_problem
from ._workspace import (
    ACTIVE,
    BOUND,
    EPS,
    EQUALITY,
    EXPONENT,
    IMPOSSIBLE,
    KIND,
    LENGTH,
    MULTIPLIER,
    REST,
    ROWS,
    SPARE,
    TARGET,
    THRESHOLD,
    VALUE,
    Booleans,
    Floats,
    Integers,
    allocate,
)

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
# The referee's own rows are rounded: it may see this times Σ|μ̂| more in the stationarity than there is.
MARGIN = 2 * EPS
ALLOWED = 1e-5


@kernel
def rest_in_twice_the_precision(space: Floats, small: Floats) -> None:
    """d − g − Jᵀμ into REST, where the referee forms it in rational arithmetic."""
    for j in range(space.shape[1]):
        high, low = add_product(space[VALUE, j], 0.0, -1.0, space[TARGET, j])
        for i in range(small.shape[1]):
            if small[BOUND, i] > -inf:
                high, low = add_product(high, low, -small[THRESHOLD, i], space[ROWS + i, j])
        space[REST, j] = high + low


@kernel
def measure(space: Floats, small: Floats, index: Integers, size: int, scale: int, parts: Floats) -> float:
    """The referee's residuals of d and μ as they round when unscaled, into parts; the worst, infinite for no numbers.

    Leaves μ, unscaled and by row, in SPARE.
    """
    factor = np.ldexp(1.0, scale)
    for j in range(space.shape[1]):
        space[VALUE, j] = space[VALUE, j] * factor / factor
        space[REST, j] = space[VALUE, j] - space[TARGET, j]
    for i in range(small.shape[1]):
        small[THRESHOLD, i] = 0.0
        small[SPARE, i] = 0.0
    for k in range(size):
        i = index[ACTIVE, k]
        small[SPARE, i] = np.ldexp(small[MULTIPLIER, k], scale - index[EXPONENT, i])
        small[THRESHOLD, i] = np.ldexp(small[SPARE, i], index[EXPONENT, i] - scale)
    parts[:] = 0.0
    total, unsound = 0.0, 0.0  # unsound: NaN from the first infinity or NaN on, which a comparison would forget
    for i in range(small.shape[1]):
        if small[BOUND, i] > -inf:
            mu = small[THRESHOLD, i] * small[LENGTH, i]
            slack = (dot(space, ROWS + i, VALUE) - small[BOUND, i]) / small[LENGTH, i]
            missed = abs(slack) if index[KIND, i] == EQUALITY else -slack
            parts[1] = parts[1] if missed <= parts[1] else missed
            if index[KIND, i] != EQUALITY:
                least = abs(slack if slack < mu else mu)
                parts[2] = parts[2] if -mu <= parts[2] else -mu
                parts[3] = parts[3] if least <= parts[3] else least
            total += abs(mu)
            unsound += 0.0 * slack
            add(space, REST, -small[THRESHOLD, i], ROWS + i)
    sigma, own = sqrt(dot(space, TARGET, TARGET)), sqrt(dot(space, VALUE, VALUE))
    sigma = own if not own <= sigma else sigma
    margin, allowance = MARGIN * total, 8 * EPS * total
    if not allowance < ALLOWED * sigma:
        rest_in_twice_the_precision(space, small)
        margin, allowance = 0.0, ALLOWED * sigma
    stationarity = sqrt(dot(space, REST, REST)) + margin - allowance
    parts[0] = 0.0 if stationarity <= 0.0 else stationarity
    worst = 0.0
    for k in range(4):
        if sigma != 0.0:
            parts[k] /= sigma
        worst = worst if parts[k] <= worst else parts[k]
    return worst if unsound + 0.0 * parts[0] == 0.0 else inf


@entry_point(
    "void(b1, i8, Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True),"
    "Array(f8, 1, 'C', readonly=True), Array(b1, 1, 'C', readonly=True), f8, f8[::1], f8[::1], f8[::1])",
    interpreted=(64, 30_000),  # at up to 20 µs each: nearly dependent rows are projected again and again
)
def project_stacked(
    tangent: bool,
    attempt: int,
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

    report_out (6·B,): B statuses, changes of the active set, and each of the residuals, in the order of `KKTResiduals`.
    tangent: takes no inequality.
    INFEASIBLE comes with a Farkas vector, and with a value that is yet to be found.
    """
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    space, small, index = allocate(m, n)
    parts = np.empty(4)
    for b in range(count):
        status, end, size, changes, worst = NUMERICAL_ERROR, LIMIT, 0, 0, inf
        scale = scale_problem(space, small, index, b, gradient, jacobian, bound, equality)
        for i in range(m):
            if tangent and not equality[b * m + i] and bound[b * m + i] > -inf:
                status, scale = UNSUPPORTED, UNUSABLE
        if scale < UNUSABLE:
            end, size, changes = dual_active_set(space, small, index, attempt)
        if scale < UNUSABLE and end != CONFLICT:
            worst = measure(space, small, index, size, scale, parts)
            if worst < inf:
                status = OPTIMAL if worst <= tolerance else (ITERATION_LIMIT if end == LIMIT else UNCERTIFIED)
        for i in range(m):
            if end == CONFLICT:
                status = INFEASIBLE
                small[SPARE, i] = np.ldexp(small[THRESHOLD, i], -index[EXPONENT, i])
        for i in range(m):
            if scale < UNUSABLE and index[KIND, i] == IMPOSSIBLE:
                status = INFEASIBLE
                for k in range(m):
                    small[SPARE, k] = 0.0
                small[SPARE, i] = 1.0 if bound[b * m + i] > 0.0 else -1.0
        given = status < NUMERICAL_ERROR
        for j in range(n):
            value_out[b * n + j] = space[VALUE, j] * np.ldexp(1.0, scale) if given else 0.0
        for i in range(m):
            multipliers_out[b * m + i] = small[SPARE, i] if given else 0.0
        report_out[b] = status
        report_out[count + b] = changes
        for k in range(4):
            report_out[(2 + k) * count + b] = parts[k] if worst < inf else inf
