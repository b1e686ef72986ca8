"""Problems whose rows are well apart, in one short pass: μ from the Gram matrix of the unit rows, then d = g + Jᵀμ.

The rows themselves are not scaled: lengths meet them in numbers of Ĝ only (see `_exchange`). The Gram matrix squares
the condition, so rows within 0.01 rad of the others' span are left to `_projection`, as is whatever this pass does not
finish: nothing leaves it but certified optima. It is there for speed, and compiles so fast that few processes need to
wait for the other.
"""

from math import inf, sqrt

import numpy as np

from . import _exchange as at
from ._arithmetic import inner
from ._entry_point import GIVEN, entry_point, inlined
from ._exchange import WEIGHT, find_active_set, scale_row, solve

OPTIMAL, OPEN = 0, -1
SHARP = 1e-14  # the worst residual, relative as the referee's, that an answer may have
# A row missed by more than this of the least that any row asks for may contradict others, however little that is beside
# a long g: ten times what `infeasibility` calls rounding would let contradictions pass, a tenth only costs time.
MISSED = 1e-9
SAFE = 1e150  # lengths between 1/SAFE and SAFE can be squared


@inlined
def prepare(tangent, problem, gradient, jacobian, bound, equality, gram, small, state):
    """Ĝ, ĉ, b̂ and lengths; 𝒜 = E.

    False if a row that is on is 0 or beyond squaring, or any number of the constraints is not finite.
    """
    m = gram.shape[0]
    first = problem * m
    for i in range(m):
        row = first + i
        state[i] = at.INSIDE if equality[row] else (at.OFF if bound[row] == -inf else at.OUTSIDE)
        small[at.MU, i], small[WEIGHT, i] = 0.0, 0.0
        if tangent and state[i] == at.OUTSIDE:
            return False
        length = sqrt(inner(jacobian, row, jacobian, row))
        if not (bound[row] < inf and length < SAFE and (length > 1.0 / SAFE or state[i] == at.OFF)):
            return False
        if state[i] != at.OFF:
            small[at.OFFSET, i] = inner(jacobian, row, gradient, problem)
            for k in range(i):
                if state[k] != at.OFF:
                    gram[i, k] = inner(jacobian, row, jacobian, first + k)
            scale_row(i, length, bound[row], gram, small, state)
    return True


@inlined
def add_rows(out, row, sign, jacobian, first, small, order, size):
    """The row of out += sign · Jᵀw over 𝒜; three rows at a time, for each number of out to be loaded less often."""
    for k in range(0, size, 3):
        a, b, c = order[k], order[min(k + 1, size - 1)], order[min(k + 2, size - 1)]
        u = sign * small[WEIGHT, a]
        v = sign * small[WEIGHT, b] if k + 1 < size else 0.0
        w = sign * small[WEIGHT, c] if k + 2 < size else 0.0
        for j in range(jacobian.shape[1]):
            out[row, j] += u * jacobian[first + a, j] + v * jacobian[first + b, j] + w * jacobian[first + c, j]


@inlined
def push(out, row, name, jacobian, first, small, order, size):
    """The row of out += ĴᵀX over 𝒜, the row `name` of small += X."""
    for k in range(size):
        i = order[k]
        small[name, i] += small[at.X, k]
        small[WEIGHT, i] = small[at.X, k] * small[at.SCALE, i]
    add_rows(out, row, 1.0, jacobian, first, small, order, size)


@inlined
def begin(problem, gradient, value):
    """d ← g."""
    for j in range(value.shape[1]):
        value[problem, j] = gradient[problem, j]


@inlined
def find_slack(outside, problem, jacobian, small, state, value):
    """Ĵd − b̂ of the rows of 𝒜, and of those outside where these are asked for."""
    first = problem * small.shape[1]
    for i in range(small.shape[1]):
        if state[i] == at.INSIDE or (outside and state[i] != at.OFF):
            small[at.SLACK, i] = inner(jacobian, first + i, value, problem) * small[at.SCALE, i] - small[at.BOUND, i]


@inlined
def move(outside, problem, jacobian, small, state, order, size, value):
    """μ̂ += X, d with it; and the slack that is left."""
    push(value, problem, at.MU, jacobian, problem * small.shape[1], small, order, size)
    find_slack(outside, problem, jacobian, small, state, value)


@inlined
def correct(factor, small, order, size):
    """X ← the change of μ̂ that takes away the slack of the rows of 𝒜."""
    for k in range(size):
        small[at.X, k] = -small[at.SLACK, order[k]]
    solve(factor, small, size)


@inlined
def find_rest(kappa, problem, gradient, jacobian, equality, small, order, size, value, rest, row):
    """‖κd − g − Jᵀμ‖, its vector into a row of rest; μ into WEIGHT, not below 0 on I."""
    first = problem * small.shape[1]
    for k in range(size):
        i = order[k]
        if small[at.MU, i] < 0.0 and not equality[first + i]:
            small[at.MU, i] = 0.0
        small[WEIGHT, i] = small[at.MU, i] * small[at.SCALE, i]
    for j in range(value.shape[1]):
        rest[row, j] = kappa * value[problem, j] - gradient[problem, j]
    add_rows(rest, row, -1.0, jacobian, first, small, order, size)
    return sqrt(inner(rest, row, rest, row))


@inlined
def survey(small, state, equality, first, length, force):
    """What rows are missed by at the most, the worst min(μ̂, slack), and the least that any row asks for.

    length, force: the units of slack and of μ̂. The first is infinite where a slack is NaN.
    """
    primal, complementarity, asked = 0.0, 0.0, inf
    for i in range(small.shape[1]):
        if state[i] != at.OFF:
            mu, slack = small[at.MU, i] / force, small[at.SLACK, i] / length
            asks = abs(small[at.BOUND, i]) if equality[first + i] else small[at.BOUND, i]
            asked = asks if 0.0 < asks < asked else asked
            if slack != slack:  # NaN, which the comparisons with the next row's would lose
                return inf, inf, 0.0
            missed = abs(slack) if equality[first + i] else -slack
            primal = primal if missed <= primal else missed
            if not equality[first + i]:
                least = abs(slack if slack < mu else mu)
                complementarity = complementarity if least <= complementarity else least
    return primal, complementarity, asked


@inlined
def measure(small, state, equality, first, stationarity, sigma, parts):
    """The referee's residuals of μ, slack and ‖r‖, without its allowance for rounding, into parts; the worst of them.

    Dual is 0 here. "not ≤" lets NaN through.
    """
    primal, complementarity, asked = survey(small, state, equality, first, 1.0, 1.0)
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
def judge(problem, gradient, jacobian, equality, small, state, order, size, value, rest, parts):
    """μ into WEIGHT, the residuals of d and μ into parts; the worst of these."""
    stationarity = find_rest(1.0, problem, gradient, jacobian, equality, small, order, size, value, rest, 0)
    length, square = inner(gradient, problem, gradient, problem), inner(value, problem, value, problem)
    sigma = sqrt(length if square <= length else square)
    return measure(small, state, equality, problem * small.shape[1], stationarity, sigma, parts)


@inlined
def solve_problem(
    tangent, problem, gradient, jacobian, bound, equality, gram, factor, small, state, order, value, rest, parts
):
    """The worst residual of d, inf where there is none, and how often 𝒜 changed. tangent: takes no inequality.

    The work is done by functions of a few loops each, one after the other for all problems. In longer ones, and where
    they branch, numba counts references to each array, which takes a fifth of the time.
    """
    first = problem * small.shape[1]
    usable = prepare(tangent, problem, gradient, jacobian, bound, equality, gram, small, state)
    size, changes = find_active_set(usable, gram, factor, small, state, order, equality, first)
    begin(problem, gradient, value)
    for correction in range(2):  # once, by what d leaves of b̂ − Ĵd
        move(correction == 1, problem, jacobian, small, state, order, size, value)
        correct(factor, small, order, size)
    worst = judge(problem, gradient, jacobian, equality, small, state, order, size, value, rest, parts)
    return worst if size >= 0 else inf, changes


@inlined
def report(is_optimal, problem, changes, parts, small, multipliers_out, report_out):
    """Status, changes, residuals and, of what is OPTIMAL, μ; report_out: (rows, B)."""
    report_out[0, problem], report_out[1, problem] = OPTIMAL if is_optimal else OPEN, changes if is_optimal else 0.0
    for k in range(4):
        report_out[2 + k, problem] = parts[k]
    for i in range(small.shape[1]):
        multipliers_out[problem * small.shape[1] + i] = small[WEIGHT, i] if is_optimal else 0.0


@entry_point(
    f"void(b1, {GIVEN}, f8, f8[::1], f8[::1], f8[::1])",
    interpreted=(16, 200_000),  # at 1 to 2 µs of the interpreter each
)
def project_directly(tangent, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report_out):
    """As `project_stacked`, but a status is OPTIMAL or OPEN, and then value, multipliers and residuals mean nothing."""
    n = jacobian.shape[1]
    count = gradient.shape[0] // n
    m = jacobian.shape[0] // count if count > 0 else 0
    gradients, values = gradient.reshape((count, n)), value_out.reshape((count, n))
    reports = report_out.reshape((6, count))
    gram, factor, small, rest = np.empty((m, m)), np.empty((m, m)), np.empty((8, m)), np.empty((1, n))
    state, order, parts = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(4)
    for b in range(count):
        worst, changes = solve_problem(
            tangent, b, gradients, jacobian, bound, equality, gram, factor, small, state, order, values, rest, parts
        )
        report(worst <= SHARP and worst <= tolerance, b, changes, parts, small, multipliers_out, reports)
