"""Problems whose rows are well apart, in one short pass: μ from the Gram matrix of the unit rows, then d = g + Jᵀμ.

    Ĝ = ĴĴᵀ,  ĉ = b̂ − Ĵg:    Ĝ_𝒜𝒜 μ̂_𝒜 = ĉ_𝒜,    μ̂ ≥ 0 and Ĝμ̂ ≥ ĉ on I,    μ̂ = 0 outside 𝒜        μᵢ = μ̂ᵢ/‖Jᵢ‖

𝒜 changes by one row at a time. The rows themselves are not scaled: lengths meet them in numbers of Ĝ only. The Gram
matrix squares the condition, so rows within 0.01 rad of the others' span are left to `_projection`, as is whatever this
pass does not finish: nothing leaves it but certified optima. It is there for speed, and compiles so fast that few
processes need to wait for the other.
Source: the projection's dual as a linear complementarity problem (Cottle, Pang & Stone 1992, §1).
"""

from math import inf, sqrt

import numpy as np

from ._arithmetic import inner
from ._entry_point import entry_point, inlined
from ._workspace import EPS, Booleans, Floats, Integers, numbers

OPTIMAL, OPEN = 0, -1
SHARP = 1e-14  # the worst residual, relative as the referee's, that an answer may have
APART, COPY = 1e-4, 1e-12  # squared distances from the others' span: well apart from here on; a combination up to here
# At a vertex further rows are missed by rounding: at 4 eps a dozen in 20 000 problems exchanged them without an end.
# The residual judges the answer in any case.
VERTEX = 16 * EPS
MISSED = 1e-9  # a bound missed by more of itself may contradict another, however small that is beside g
SAFE = 1e150  # lengths between 1/SAFE and SAFE can be squared

# Rows of small, one number a constraint: b̂, ĉ, 1/‖Jᵢ‖, μ̂, μ, Ĵᵢd − b̂ᵢ; the last two by the order of 𝒜: 1/D, solution.
BOUND, OFFSET, SCALE, MU, WEIGHT, SLACK, INVERSE, X = numbers(8)
OUTSIDE, INSIDE, COPIED, OFF = numbers(4)  # states of a constraint


@inlined
def prepare(
    problem: int,
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
    gram: Floats,
    small: Floats,
    state: Integers,
) -> bool:
    """Ĝ, ĉ, b̂ and lengths; 𝒜 = E.

    False if a row that is on is 0 or beyond squaring, or any number of the constraints is not finite.
    """
    m = gram.shape[0]
    first = problem * m
    for i in range(m):
        at = first + i
        state[i] = INSIDE if equality[at] else (OFF if bound[at] == -inf else OUTSIDE)
        small[MU, i], small[WEIGHT, i] = 0.0, 0.0
        length = sqrt(inner(jacobian, at, jacobian, at))
        if not (bound[at] < inf and length < SAFE and (length > 1.0 / SAFE or state[i] == OFF)):
            return False
        if state[i] != OFF:
            scale = 1.0 / length
            small[SCALE, i], small[BOUND, i] = scale, bound[at] * scale
            small[OFFSET, i] = small[BOUND, i] - inner(jacobian, at, gradient, problem) * scale
            for k in range(i):
                if state[k] != OFF:
                    gram[i, k] = inner(jacobian, at, jacobian, first + k) * scale * small[SCALE, k]
                    gram[k, i] = gram[i, k]
            gram[i, i] = 1.0
    return True


@inlined
def factorize(gram: Floats, factor: Floats, small: Floats, state: Integers, order: Integers) -> int:
    """Ĝ = LDLᵀ over 𝒜 without copies, whose rows `order` lists; its size, or −1 if rows nearly depend.

    L without its diagonal into factor, 1/D into small.
    """
    size = 0
    for i in range(gram.shape[0]):
        if state[i] == INSIDE or state[i] == COPIED:
            for k in range(size):
                s = gram[i, order[k]]
                for j in range(k):
                    s -= factor[size, j] * factor[k, j]
                factor[size, k] = s
            pivot = gram[i, i]
            for k in range(size):
                s = factor[size, k]
                factor[size, k] = s * small[INVERSE, k]
                pivot -= s * factor[size, k]
            if COPY < pivot < APART:
                return -1
            state[i] = COPIED
            if pivot >= APART:
                state[i], order[size] = INSIDE, i
                small[INVERSE, size] = 1.0 / pivot
                size += 1
    return size


@inlined
def solve(factor: Floats, small: Floats, size: int) -> None:
    """X ← (LDLᵀ)⁻¹ X."""
    for i in range(size):
        for j in range(i):
            small[X, i] -= factor[i, j] * small[X, j]
    for i in range(size - 1, -1, -1):
        small[X, i] *= small[INVERSE, i]
        for j in range(i + 1, size):
            small[X, i] -= factor[j, i] * small[X, j]


@inlined
def next_exchange(
    gram: Floats, small: Floats, state: Integers, order: Integers, size: int, equality: Booleans, first: int
) -> int:
    """The inequality whose multiplier is most negative, or else the one violated most, or else −1."""
    worst, found = 0.0, -1
    for k in range(size):
        if small[X, k] < worst and not equality[first + order[k]]:
            worst, found = small[X, k], order[k]
    if found < 0:
        for i in range(gram.shape[0]):
            if state[i] == OUTSIDE:
                violation, total = small[OFFSET, i], abs(small[OFFSET, i])
                for k in range(size):
                    violation -= gram[i, order[k]] * small[X, k]
                    total += abs(small[X, k])
                if violation > worst and violation > VERTEX * total:
                    worst, found = violation, i
    return found


@inlined
def find_active_set(
    gram: Floats, factor: Floats, small: Floats, state: Integers, order: Integers, equality: Booleans, first: int
) -> tuple[int, int]:
    """How many rows 𝒜 has, −1 where rows nearly depend or exchanges have no end; and exchanges. μ̂_𝒜 into X."""
    m = gram.shape[0]
    size, changes, found = 0, -1, 0
    while found >= 0:
        changes += 1
        size = factorize(gram, factor, small, state, order)
        if size < 0 or changes > 2 * m:
            return -1, changes
        for k in range(size):
            small[X, k] = small[OFFSET, order[k]]
        solve(factor, small, size)
        found = next_exchange(gram, small, state, order, size, equality, first)
        if found >= 0:
            state[found] = OUTSIDE if state[found] == INSIDE else INSIDE
    return size, changes


@inlined
def add_rows(
    out: Floats, at: int, sign: float, jacobian: Floats, first: int, weights: Floats, order: Integers, size: int
) -> None:
    """Row `at` of out += sign · Jᵀw over 𝒜; three rows at a time, for each number of out to be loaded less often."""
    for k in range(0, size, 3):
        a, b, c = order[k], order[min(k + 1, size - 1)], order[min(k + 2, size - 1)]
        u = sign * weights[a]
        v = sign * weights[b] if k + 1 < size else 0.0
        w = sign * weights[c] if k + 2 < size else 0.0
        for j in range(jacobian.shape[1]):
            out[at, j] += u * jacobian[first + a, j] + v * jacobian[first + b, j] + w * jacobian[first + c, j]


@inlined
def measure(
    small: Floats, state: Integers, equality: Booleans, first: int, stationarity: float, sigma: float, parts: Floats
) -> float:
    """The referee's residuals of μ, slack and ‖r‖, without its allowance for rounding, into parts; the worst of them.

    Dual is 0 here. "not ≤" lets NaN through.
    """
    primal, complementarity = 0.0, 0.0
    for i in range(small.shape[1]):
        if state[i] != OFF:
            mu, slack = small[MU, i], small[SLACK, i]
            if slack != slack:  # NaN, which the comparisons with the next row's would lose
                return inf
            missed = abs(slack) if equality[first + i] else -slack
            primal = primal if missed <= primal else missed
            if not equality[first + i]:
                least = abs(slack if slack < mu else mu)
                complementarity = complementarity if least <= complementarity else least
            if missed > MISSED * abs(small[BOUND, i]) and small[BOUND, i] != 0.0:  # rounding, beside a long g; or not
                return inf
    worst = primal if complementarity <= primal else complementarity
    worst = worst if stationarity <= worst else stationarity
    if not 1.0 / SAFE < sigma < SAFE:
        parts[:] = 0.0
        return 0.0 if sigma == worst == 0.0 else inf
    parts[0], parts[1], parts[2], parts[3] = stationarity / sigma, primal / sigma, 0.0, complementarity / sigma
    return worst / sigma


@inlined
def answer(
    problem: int,
    gradient: Floats,
    jacobian: Floats,
    equality: Booleans,
    factor: Floats,
    small: Floats,
    state: Integers,
    order: Integers,
    size: int,
    value: Floats,
    rest: Floats,
    parts: Floats,
) -> float:
    """d and μ of 𝒜, corrected once by what d leaves of b̂ − Ĵd; residuals into parts, the worst returned."""
    m, n = small.shape[1], value.shape[1]
    first = problem * m
    for j in range(n):
        value[problem, j] = gradient[problem, j]
    for correction in range(2):
        for k in range(size):
            i = order[k]
            small[MU, i] += small[X, k]
            small[WEIGHT, i] = small[X, k] * small[SCALE, i]
        add_rows(value, problem, 1.0, jacobian, first, small[WEIGHT], order, size)
        for i in range(m):
            if state[i] == INSIDE or (correction == 1 and state[i] != OFF):
                small[SLACK, i] = inner(jacobian, first + i, value, problem) * small[SCALE, i] - small[BOUND, i]
        if correction == 0:
            for k in range(size):
                small[X, k] = -small[SLACK, order[k]]
            solve(factor, small, size)
    for k in range(size):
        i = order[k]
        if small[MU, i] < 0.0 and not equality[first + i]:
            small[MU, i] = 0.0
        small[WEIGHT, i] = small[MU, i] * small[SCALE, i]
    for j in range(n):
        rest[0, j] = value[problem, j] - gradient[problem, j]
    add_rows(rest, 0, -1.0, jacobian, first, small[WEIGHT], order, size)
    length, square = inner(gradient, problem, gradient, problem), inner(value, problem, value, problem)
    sigma = sqrt(length if square <= length else square)
    worst: float = measure(small, state, equality, first, sqrt(inner(rest, 0, rest, 0)), sigma, parts)
    return worst


@inlined
def solve_problem(
    tangent: bool,
    problem: int,
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
    gram: Floats,
    factor: Floats,
    small: Floats,
    state: Integers,
    order: Integers,
    value: Floats,
    rest: Floats,
    parts: Floats,
) -> tuple[float, int]:
    """The worst residual of d, inf where there is none, and how often 𝒜 changed. tangent: takes no inequality."""
    m = small.shape[1]
    if not prepare(problem, gradient, jacobian, bound, equality, gram, small, state):
        return inf, 0
    for i in range(m):
        if tangent and state[i] == OUTSIDE:
            return inf, 0
    size, changes = find_active_set(gram, factor, small, state, order, equality, problem * m)
    if size < 0:
        return inf, 0
    worst = answer(problem, gradient, jacobian, equality, factor, small, state, order, size, value, rest, parts)
    return worst, changes


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
    """As `project_stacked`, but a status is OPTIMAL or OPEN, and then value, multipliers and residuals mean nothing."""
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    gradients, values = gradient.reshape((count, n)), value_out.reshape((count, n))
    gram, factor, small, rest = np.empty((m, m)), np.empty((m, m)), np.empty((8, m)), np.empty((1, n))
    state, order, parts = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(4)
    for b in range(count):
        worst, changes = solve_problem(
            tangent, b, gradients, jacobian, bound, equality, gram, factor, small, state, order, values, rest, parts
        )
        report_out[b], report_out[count + b] = OPEN, 0.0
        if worst <= SHARP and worst <= tolerance:
            report_out[b], report_out[count + b] = OPTIMAL, changes
            for k in range(4):
                report_out[(2 + k) * count + b] = parts[k]
            for i in range(m):
                multipliers_out[b * m + i] = small[WEIGHT, i]
