"""The exact projection onto {d : Jᵢd ≥ bᵢ on I, Jᵢd = bᵢ on E} for B problems of one shape: the entry point."""

from math import inf, sqrt

import numpy as np

from . import _workspace as at
from ._arithmetic import add, add_product, dot
from ._dual_active_set import CONFLICT, LIMIT, dual_active_set
from ._entry_point import GIVEN, entry_point, inlined, kernel
from ._scaling import UNUSABLE, scale_problem
from ._workspace import allocate

OPTIMAL, INFEASIBLE, UNCERTIFIED, ITERATION_LIMIT, NUMERICAL_ERROR, UNSUPPORTED = range(6)
# The referee's own rows are rounded: it may see this times Σ|μ̂| more in the stationarity than there is.
MARGIN = 2 * at.EPS
ALLOWED = 1e-5  # the referee's, see `certify`


@kernel
def rest_in_twice_the_precision(space, small):
    """d − g − Jᵀμ into REST, where the referee forms it in rational arithmetic."""
    for j in range(space.shape[1]):
        high, low = add_product(space[at.VALUE, j], 0.0, -1.0, space[at.TARGET, j])
        for i in range(small.shape[1]):
            if small[at.BOUND, i] > -inf:
                high, low = add_product(high, low, -small[at.THRESHOLD, i], space[at.ROWS + i, j])
        space[at.REST, j] = high + low


@inlined
def round_as_unscaled(space, small, index, size, scale):
    """d and μ as they round when unscaled: VALUE, and THRESHOLD by row; unscaled μ in SPARE, d − g in REST."""
    factor = np.ldexp(1.0, scale)
    for j in range(space.shape[1]):
        space[at.VALUE, j] = space[at.VALUE, j] * factor / factor
        space[at.REST, j] = space[at.VALUE, j] - space[at.TARGET, j]
    for i in range(small.shape[1]):
        small[at.THRESHOLD, i], small[at.SPARE, i] = 0.0, 0.0
    for k in range(size):
        i = index[at.ACTIVE, k]
        small[at.SPARE, i] = np.ldexp(small[at.MULTIPLIER, k], scale - index[at.EXPONENT, i])
        small[at.THRESHOLD, i] = np.ldexp(small[at.SPARE, i], index[at.EXPONENT, i] - scale)


@kernel
def measure(space, small, index, parts):
    """The referee's residuals of d in VALUE and μ in THRESHOLD into parts; the worst, infinite for no numbers.

    REST: d − g, and d − g − Jᵀμ afterwards.
    """
    parts[:] = 0.0
    total, unsound = 0.0, 0.0  # unsound: NaN from the first infinity or NaN on, which a comparison would forget
    for i in range(small.shape[1]):
        if small[at.BOUND, i] > -inf:
            mu = small[at.THRESHOLD, i] * small[at.LENGTH, i]
            slack = (dot(space, at.ROWS + i, at.VALUE) - small[at.BOUND, i]) / small[at.LENGTH, i]
            missed = abs(slack) if index[at.KIND, i] == at.EQUALITY else -slack
            parts[1] = parts[1] if missed <= parts[1] else missed
            if index[at.KIND, i] != at.EQUALITY:
                least = abs(slack if slack < mu else mu)
                parts[2] = parts[2] if -mu <= parts[2] else -mu
                parts[3] = parts[3] if least <= parts[3] else least
            total += abs(mu)
            unsound += 0.0 * slack
            add(space, at.REST, -small[at.THRESHOLD, i], at.ROWS + i)
    sigma, own = sqrt(dot(space, at.TARGET, at.TARGET)), sqrt(dot(space, at.VALUE, at.VALUE))
    sigma = own if not own <= sigma else sigma
    margin, allowance = MARGIN * total, 8 * at.EPS * total
    if not allowance < ALLOWED * sigma:
        rest_in_twice_the_precision(space, small)
        margin, allowance = 0.0, ALLOWED * sigma
    stationarity = sqrt(dot(space, at.REST, at.REST)) + margin - allowance
    parts[0] = 0.0 if stationarity <= 0.0 else stationarity
    worst = 0.0
    for k in range(4):
        if sigma != 0.0:
            parts[k] /= sigma
        worst = worst if parts[k] <= worst else parts[k]
    return worst if unsound + 0.0 * parts[0] == 0.0 else inf


@inlined
def prove(index, small, first, bound, is_conflict):
    """Whether a Farkas vector, unscaled, is in SPARE: that of the conflict, or ±1 for a row of zeros that asks."""
    found = is_conflict
    for i in range(small.shape[1]):
        if is_conflict:
            small[at.SPARE, i] = np.ldexp(small[at.THRESHOLD, i], -index[at.EXPONENT, i])
    for i in range(small.shape[1]):
        if index[at.KIND, i] == at.IMPOSSIBLE:
            found = True
            small[at.SPARE, :] = 0.0
            small[at.SPARE, i] = 1.0 if bound[first + i] > 0.0 else -1.0
    return found


@entry_point(
    f"void(b1, i8, {GIVEN}, f8, f8[::1], f8[::1], f8[::1])",
    interpreted=(64, 30_000),  # at up to 20 µs each: nearly dependent rows are projected again and again
)
def project_stacked(
    tangent, attempt, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report_out
):
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
        for i in range(b * m, (b + 1) * m):
            if tangent and not equality[i] and bound[i] > -inf:
                status, scale = UNSUPPORTED, UNUSABLE
        if scale < UNUSABLE:
            end, size, changes = dual_active_set(space, small, index, attempt)
            if end != CONFLICT:
                round_as_unscaled(space, small, index, size, scale)
                worst = measure(space, small, index, parts)
            if worst < inf:
                status = OPTIMAL if worst <= tolerance else (ITERATION_LIMIT if end == LIMIT else UNCERTIFIED)
            if prove(index, small, b * m, bound, end == CONFLICT):
                status = INFEASIBLE
        given = status < NUMERICAL_ERROR
        for j in range(n):
            value_out[b * n + j] = space[at.VALUE, j] * np.ldexp(1.0, scale) if given else 0.0
        for i in range(m):
            multipliers_out[b * m + i] = small[at.SPARE, i] if given else 0.0
        report_out[b], report_out[count + b] = status, changes
        for k in range(4):
            report_out[(2 + k) * count + b] = parts[k] if worst < inf else inf
