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
# A row missed by more than this of the least that any row asks for may contradict others, however little that is beside
# a long g: ten times what `infeasibility` calls rounding would let contradictions pass, a tenth only costs time.
MISSED = 1e-9
SAFE = 1e150  # lengths between 1/SAFE and SAFE can be squared

# Rows of small, one number a constraint: b̂, ĉ, 1/‖Jᵢ‖, μ̂, μ, Ĵᵢd − b̂ᵢ; the last two by the order of 𝒜: 1/D, solution.
BOUND, OFFSET, SCALE, MU, WEIGHT, SLACK, INVERSE, X = numbers(8)
OUTSIDE, INSIDE, COPIED, OFF = numbers(4)  # states of a constraint


@inlined
def prepare(
    tangent: bool,
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
        if tangent and state[i] == OUTSIDE:
            return False
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
def most_negative(small: Floats, order: Integers, size: int, equality: Booleans, first: int) -> int:
    """The inequality of 𝒜 whose multiplier is most negative, or −1."""
    worst, found = 0.0, -1
    for k in range(size):
        if small[X, k] < worst and not equality[first + order[k]]:
            worst, found = small[X, k], order[k]
    return found


@inlined
def most_violated(gram: Floats, small: Floats, state: Integers, order: Integers, size: int) -> int:
    """The inequality outside 𝒜 that is violated most, or −1."""
    worst, found = 0.0, -1
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
    usable: bool,
    gram: Floats,
    factor: Floats,
    small: Floats,
    state: Integers,
    order: Integers,
    equality: Booleans,
    first: int,
) -> tuple[int, int]:
    """How many rows 𝒜 has, −1 where rows nearly depend or exchanges have no end; and exchanges. μ̂_𝒜 into X."""
    size, changes, found = -1, -1, 0 if usable else -1
    while found >= 0:
        changes += 1
        size = factorize(gram, factor, small, state, order)
        size = -1 if changes > 2 * gram.shape[0] else size
        for k in range(size):
            small[X, k] = small[OFFSET, order[k]]
        solve(factor, small, size)
        found = most_negative(small, order, size, equality, first)
        if found < 0 and size >= 0:
            found = most_violated(gram, small, state, order, size)
        if found >= 0:
            state[found] = OUTSIDE if state[found] == INSIDE else INSIDE
    return size, changes


@inlined
def add_rows(
    out: Floats, at: int, sign: float, jacobian: Floats, first: int, small: Floats, order: Integers, size: int
) -> None:
    """Row `at` of out += sign · Jᵀw over 𝒜; three rows at a time, for each number of out to be loaded less often."""
    for k in range(0, size, 3):
        a, b, c = order[k], order[min(k + 1, size - 1)], order[min(k + 2, size - 1)]
        u = sign * small[WEIGHT, a]
        v = sign * small[WEIGHT, b] if k + 1 < size else 0.0
        w = sign * small[WEIGHT, c] if k + 2 < size else 0.0
        for j in range(jacobian.shape[1]):
            out[at, j] += u * jacobian[first + a, j] + v * jacobian[first + b, j] + w * jacobian[first + c, j]


@inlined
def measure(
    small: Floats, state: Integers, equality: Booleans, first: int, stationarity: float, sigma: float, parts: Floats
) -> float:
    """The referee's residuals of μ, slack and ‖r‖, without its allowance for rounding, into parts; the worst of them.

    Dual is 0 here. "not ≤" lets NaN through.
    """
    primal, complementarity, asked = 0.0, 0.0, inf
    for i in range(small.shape[1]):
        if state[i] != OFF:
            mu, slack = small[MU, i], small[SLACK, i]
            asks = abs(small[BOUND, i]) if equality[first + i] else small[BOUND, i]
            asked = asks if 0.0 < asks < asked else asked
            if slack != slack:  # NaN, which the comparisons with the next row's would lose
                return inf
            missed = abs(slack) if equality[first + i] else -slack
            primal = primal if missed <= primal else missed
            if not equality[first + i]:
                least = abs(slack if slack < mu else mu)
                complementarity = complementarity if least <= complementarity else least
    if primal > MISSED * asked:  # rounding, beside a long g; or not
        return inf
    worst = primal if complementarity <= primal else complementarity
    worst = worst if stationarity <= worst else stationarity
    if not 1.0 / SAFE < sigma < SAFE:
        parts[:] = 0.0
        return 0.0 if sigma == worst == 0.0 else inf
    parts[0], parts[1], parts[2], parts[3] = stationarity / sigma, primal / sigma, 0.0, complementarity / sigma
    return worst / sigma


@inlined
def begin(problem: int, gradient: Floats, value: Floats) -> None:
    """d ← g."""
    for j in range(value.shape[1]):
        value[problem, j] = gradient[problem, j]


@inlined
def move(
    problem: int,
    jacobian: Floats,
    small: Floats,
    state: Integers,
    order: Integers,
    size: int,
    value: Floats,
    outside: bool,
) -> None:
    """μ̂ += X, d with it; slack of the rows of 𝒜, and of those outside where these are asked for."""
    first = problem * small.shape[1]
    for k in range(size):
        i = order[k]
        small[MU, i] += small[X, k]
        small[WEIGHT, i] = small[X, k] * small[SCALE, i]
    add_rows(value, problem, 1.0, jacobian, first, small, order, size)
    for i in range(small.shape[1]):
        if state[i] == INSIDE or (outside and state[i] != OFF):
            small[SLACK, i] = inner(jacobian, first + i, value, problem) * small[SCALE, i] - small[BOUND, i]


@inlined
def correct(factor: Floats, small: Floats, order: Integers, size: int) -> None:
    """X ← the change of μ̂ that takes away the slack of the rows of 𝒜."""
    for k in range(size):
        small[X, k] = -small[SLACK, order[k]]
    solve(factor, small, size)


@inlined
def judge(
    problem: int,
    gradient: Floats,
    jacobian: Floats,
    equality: Booleans,
    small: Floats,
    state: Integers,
    order: Integers,
    size: int,
    value: Floats,
    rest: Floats,
    parts: Floats,
) -> float:
    """μ into WEIGHT, the residuals of d and μ into parts; the worst of these."""
    first = problem * small.shape[1]
    for k in range(size):
        i = order[k]
        if small[MU, i] < 0.0 and not equality[first + i]:
            small[MU, i] = 0.0
        small[WEIGHT, i] = small[MU, i] * small[SCALE, i]
    for j in range(value.shape[1]):
        rest[0, j] = value[problem, j] - gradient[problem, j]
    add_rows(rest, 0, -1.0, jacobian, first, small, order, size)
    length, square = inner(gradient, problem, gradient, problem), inner(value, problem, value, problem)
    stationarity, sigma = sqrt(inner(rest, 0, rest, 0)), sqrt(length if square <= length else square)
    worst: float = measure(small, state, equality, first, stationarity, sigma, parts)
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
    """The worst residual of d, inf where there is none, and how often 𝒜 changed. tangent: takes no inequality.

    The work is done by functions of a few loops each, one after the other for all problems. In longer ones, and where
    they branch, numba counts references to each array, which takes a fifth of the time.
    """
    usable = prepare(tangent, problem, gradient, jacobian, bound, equality, gram, small, state)
    size, changes = find_active_set(usable, gram, factor, small, state, order, equality, problem * small.shape[1])
    begin(problem, gradient, value)
    for correction in range(2):  # once, by what d leaves of b̂ − Ĵd
        move(problem, jacobian, small, state, order, size, value, correction == 1)
        correct(factor, small, order, size)
    worst = judge(problem, gradient, jacobian, equality, small, state, order, size, value, rest, parts)
    return worst if size >= 0 else inf, changes


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
