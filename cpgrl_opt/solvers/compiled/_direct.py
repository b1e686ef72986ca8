"""Problems whose rows are well apart, in one short pass: μ from the Gram matrix of the unit rows, then d = g + Ĵᵀμ.

    G = ĴĴᵀ,  c = b̂ − Ĵg:    G_𝒜𝒜 μ_𝒜 = c_𝒜,    μ ≥ 0 and Gμ ≥ c on I,    μ = 0 outside 𝒜

𝒜 changes by one row at a time, with a Cholesky factor anew each time. The Gram matrix squares the condition, so rows
within 0.01 rad of the others' span are left to `_projection`, as is whatever this pass does not finish: nothing leaves
it but certified optima. It is there for speed, and compiles so fast that few processes need to wait for the other.
Source: the projection's dual as a linear complementarity problem (Cottle, Pang & Stone 1992, §1).
"""

from math import inf, sqrt

import numpy as np

from ._arithmetic import add, dot
from ._entry_point import entry_point, kernel
from ._workspace import EPS, Booleans, Floats, Integers, numbers

OPTIMAL, OPEN = 0, -1
SHARP = 1e-14  # the worst residual, relative as the referee's, that an answer may have
APART, COPY = 1e-4, 1e-12  # squared distances from the others' span: well apart from here on; a combination up to here
MISSED = 1e-9  # a bound missed by more of itself may contradict another, however small that is beside g
SAFE = 1e150  # lengths between 1/SAFE and SAFE can be squared

BOUND, OFFSET, MU, LENGTH = numbers(4)  # b̂, c, μ, ‖Jᵢ‖; rows of small
OUTSIDE, INSIDE, COPIED, OFF = numbers(4)  # states of a constraint


@kernel
def prepare(
    rows: Floats,
    gram: Floats,
    small: Floats,
    state: Integers,
    problem: int,
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
) -> bool:
    """Ĵ, and g in the row after it; G, c and lengths; 𝒜 = E.

    False if a row that is on is 0 or beyond squaring, or any number of the constraints is not finite.
    """
    m, n = gram.shape[0], rows.shape[1]
    for j in range(n):
        rows[m, j] = gradient[problem * n + j]
    for i in range(m):
        at = problem * m + i
        state[i] = INSIDE if equality[at] else (OFF if bound[at] == -inf else OUTSIDE)
        small[MU, i] = 0.0
        for j in range(n):
            rows[i, j] = jacobian[at, j]
        length = sqrt(dot(rows, i, i))
        if not (bound[at] < inf and length < SAFE and (length > 1.0 / SAFE or state[i] == OFF)):
            return False
        if state[i] != OFF:
            small[LENGTH, i] = length
            small[BOUND, i] = bound[at] / length
            for j in range(n):
                rows[i, j] /= length
            small[OFFSET, i] = small[BOUND, i] - dot(rows, i, m)
            for k in range(i):
                if state[k] != OFF:
                    gram[i, k] = dot(rows, i, k)
                    gram[k, i] = gram[i, k]
            gram[i, i] = 1.0
    return True


@kernel
def factorize(gram: Floats, factor: Floats, state: Integers, order: Integers) -> int:
    """Cholesky factor of G over 𝒜 without copies, whose rows `order` lists; its size, or −1 if rows nearly depend."""
    size = 0
    for i in range(gram.shape[0]):
        if state[i] == INSIDE or state[i] == COPIED:
            pivot = gram[i, i]
            for k in range(size):
                s = gram[i, order[k]]
                for j in range(k):
                    s -= factor[size, j] * factor[k, j]
                factor[size, k] = s / factor[k, k]
                pivot -= factor[size, k] * factor[size, k]
            if COPY < pivot < APART:
                return -1
            state[i] = COPIED
            if pivot >= APART:
                state[i] = INSIDE
                factor[size, size] = sqrt(pivot)
                order[size] = i
                size += 1
    return size


@kernel
def solve(factor: Floats, x: Floats, size: int) -> None:
    """x ← (LLᵀ)⁻¹ x."""
    for i in range(size):
        for j in range(i):
            x[i] -= factor[i, j] * x[j]
        x[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            x[i] -= factor[j, i] * x[j]
        x[i] /= factor[i, i]


@kernel
def next_exchange(
    gram: Floats, small: Floats, state: Integers, order: Integers, x: Floats, size: int, equality: Booleans, first: int
) -> int:
    """The inequality whose multiplier is most negative, or else the one violated most, or else −1."""
    worst, found = 0.0, -1
    for k in range(size):
        if x[k] < worst and not equality[first + order[k]]:
            worst, found = x[k], order[k]
    if found < 0:
        for i in range(gram.shape[0]):
            if state[i] == OUTSIDE:
                violation, total = small[OFFSET, i], abs(small[OFFSET, i])
                for k in range(size):
                    violation -= gram[i, order[k]] * x[k]
                    total += abs(x[k])
                if violation > worst and violation > 4 * EPS * total:
                    worst, found = violation, i
    return found


@kernel
def refined(
    rows: Floats, small: Floats, order: Integers, factor: Floats, x: Floats, size: int, equality: Booleans, first: int
) -> None:
    """d = g + Ĵᵀμ into the row after g, corrected once by what it leaves of b̂ − Ĵd; μ into small."""
    m, n = small.shape[1], rows.shape[1]
    for j in range(n):
        rows[m + 1, j] = rows[m, j]
    for correction in range(2):
        for k in range(size):
            i = order[k]
            small[MU, i] += x[k]
            add(rows, m + 1, x[k], i)
        for k in range(size):
            i = order[k]
            if correction == 0:
                x[k] = small[BOUND, i] - dot(rows, i, m + 1)
            elif small[MU, i] < 0.0 and not equality[first + i]:
                small[MU, i] = 0.0
        if correction == 0:
            solve(factor, x, size)


@kernel
def worst_residual(rows: Floats, small: Floats, state: Integers, equality: Booleans, first: int) -> float:
    """The referee's `worst` of d and μ, without its allowance for rounding. "not ≤" lets NaN through."""
    m = small.shape[1]
    rest, worst = m + 2, 0.0
    for j in range(rows.shape[1]):
        rows[rest, j] = rows[m + 1, j] - rows[m, j]
    for i in range(m):
        if state[i] != OFF:
            mu, slack = small[MU, i], dot(rows, i, m + 1) - small[BOUND, i]
            residual = abs(slack if equality[first + i] or slack < mu else mu)
            worst = worst if residual <= worst else residual
            missed = abs(slack) if equality[first + i] else -slack
            if missed > MISSED * abs(small[BOUND, i]) and small[BOUND, i] != 0.0:  # rounding, beside a long g; or not
                return inf
            add(rows, rest, -mu, i)
    gradient, value, stationarity = dot(rows, m, m), dot(rows, m + 1, m + 1), sqrt(dot(rows, rest, rest))
    worst = worst if stationarity <= worst else stationarity
    sigma = sqrt(gradient if value <= gradient else value)
    if 1.0 / SAFE < sigma < SAFE:
        return worst / sigma
    return 0.0 if sigma == worst == 0.0 else inf


@entry_point(
    "void(b1, Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 1, 'C', readonly=True),"
    "Array(b1, 1, 'C', readonly=True), f8, f8[::1], f8[::1], f8[::1])",
    interpreted=(16, 200_000),  # at 1 to 2 µs of the interpreter each
)
def project_directly(
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
    """As `project_stacked`, but a status is OPTIMAL or OPEN, and nothing else is filled in where it is OPEN."""
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    rows, small = np.empty((m + 3, n)), np.empty((4, m))
    gram, factor, x = np.empty((m, m)), np.empty((m, m)), np.empty(m)
    state, order = np.empty(m, np.int64), np.empty(m, np.int64)
    for b in range(count):
        first, size, changes, entering = b * m, 0, -1, 0
        usable = prepare(rows, gram, small, state, b, gradient, jacobian, bound, equality)
        for i in range(m):
            usable = usable and not (tangent and state[i] == OUTSIDE)
        while usable and entering >= 0:
            changes += 1
            size = factorize(gram, factor, state, order)
            usable = size >= 0 and changes <= 2 * m
            for k in range(size):
                x[k] = small[OFFSET, order[k]]
            solve(factor, x, size)
            entering = next_exchange(gram, small, state, order, x, size, equality, first)
            if entering >= 0:
                state[entering] = OUTSIDE if state[entering] == INSIDE else INSIDE
        report_out[b], report_out[count + b], report_out[2 * count + b] = OPEN, 0.0, inf
        if usable:
            refined(rows, small, order, factor, x, size, equality, first)
            worst = worst_residual(rows, small, state, equality, first)
            if worst <= SHARP and worst <= tolerance:
                report_out[b] = OPTIMAL
                report_out[count + b] = changes
                report_out[2 * count + b] = worst
                for j in range(n):
                    value_out[b * n + j] = rows[m + 1, j]
                for i in range(m):
                    multipliers_out[b * m + i] = small[MU, i] / small[LENGTH, i] if state[i] != OFF else 0.0
