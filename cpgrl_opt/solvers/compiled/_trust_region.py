"""The usual trust region in one short pass: rows well apart, a ball that binds.

    max gᵀd  s.t.  Ĵd ≥ b̂ on I,  = on E,  ‖d‖ ≤ R:       d = q + p/κ,   μ̂ = κβ − γ on 𝒜
    Ĝβ = b̂,  Ĝγ = Ĵg  on 𝒜,    q = Ĵᵀβ,  p = g − Ĵᵀγ,   κ = ‖p‖/√(R² − ‖q‖²)

𝒜 is that of the projection of g/κ, the direct pass's; κ and 𝒜 are found in turns until they agree. All else is left to
`trust_region`. Nothing leaves this pass but optima with the referee's residuals. Source: see `trust_region`, `_direct`.
"""

from math import inf, sqrt

import numpy as np

from . import _exchange as at
from ._arithmetic import inner
from ._direct import MISSED, SAFE, find_rest, find_slack, prepare, push, report, survey
from ._entry_point import GIVEN, READ, entry_point, inlined
from ._exchange import find_active_set, solve
from ._workspace import numbers

SHARP = 1e-13  # the worst residual, relative as the referee's, that an answer may have
MOST_TURNS = 12  # of κ and 𝒜 until they agree; what takes more is for `trust_region`
NEGLIGIBLE = 1e-6  # ‖p‖/‖g‖ below it is left to those who tell it from rounding

Q, P, REST = numbers(3)  # rows of vectors: q, p, the rest


@inlined
def set_offsets(kappa, small):
    """ĉ = κb̂ − Ĵg, of which the direct pass finds 𝒜 and μ̂."""
    for i in range(small.shape[1]):
        small[at.OFFSET, i] = kappa * small[at.BOUND, i] - small[at.PULL, i]


@inlined
def split_face(problem, gradient, jacobian, factor, small, order, size, vectors):
    """q, p, β and γ (negative), each corrected once by what it leaves of its equations."""
    first = problem * small.shape[1]
    for j in range(vectors.shape[1]):
        vectors[Q, j], vectors[P, j] = 0.0, gradient[problem, j]
    for i in range(small.shape[1]):
        small[at.BETA, i], small[at.GAMMA, i] = 0.0, 0.0
    for _ in range(2):
        for k in range(size):
            i = order[k]
            small[at.X, k] = small[at.BOUND, i] - inner(jacobian, first + i, vectors, Q) * small[at.SCALE, i]
        solve(factor, small, size)
        push(vectors, Q, at.BETA, jacobian, first, small, order, size)
        for k in range(size):
            small[at.X, k] = -inner(jacobian, first + order[k], vectors, P) * small[at.SCALE, order[k]]
        solve(factor, small, size)
        push(vectors, P, at.GAMMA, jacobian, first, small, order, size)


@inlined
def find_face(
    usable, problem, radius, strength, gradient, jacobian, equality, gram, factor, small, state, order, vectors
):
    """κ, how many rows its 𝒜 has (−1 where κ and 𝒜 do not come to agree), and exchanges."""
    first, total, turn, agreed = problem * small.shape[1], 0, 0 if usable else MOST_TURNS, -1
    kappa = strength / radius
    while turn < MOST_TURNS:
        set_offsets(kappa, small)
        size, changes = find_active_set(True, gram, factor, small, state, order, equality, first)
        total += changes
        if size >= 0 and turn > 0 and changes == 0:
            agreed, turn = size, MOST_TURNS
        elif size >= 0:
            split_face(problem, gradient, jacobian, factor, small, order, size, vectors)
            room = radius * radius - inner(vectors, Q, vectors, Q)
            length = sqrt(inner(vectors, P, vectors, P))
            turn = turn + 1 if length > NEGLIGIBLE * strength else MOST_TURNS
            kappa = length / sqrt(room) if room > 0.0 else 8.0 * kappa
        else:
            turn = MOST_TURNS
    return kappa, agreed, total


@inlined
def judge_in_ball(
    problem, radius, strength, kappa, size, gradient, jacobian, equality, small, state, order, value, vectors, parts
):
    """d, μ into WEIGHT, the referee's residuals into parts; the worst, inf where a bound is missed or NaN comes up."""
    first = problem * small.shape[1]
    for i in range(small.shape[1]):
        small[at.WEIGHT, i], small[at.MU, i] = 0.0, 0.0
    for k in range(size):
        small[at.MU, order[k]] = kappa * small[at.BETA, order[k]] + small[at.GAMMA, order[k]]
    for j in range(value.shape[1]):
        value[problem, j] = vectors[Q, j] + vectors[P, j] / kappa
    rest = find_rest(kappa, problem, gradient, jacobian, equality, small, order, size, value, vectors, REST)
    find_slack(True, problem, jacobian, small, state, value)
    length, named = sqrt(inner(value, problem, value, problem)), radius
    for i in range(small.shape[1]):
        if state[i] != at.OFF:
            b = abs(small[at.BOUND, i])
            named = b if 0.0 < b < named else named
    unit = length if length > named else named
    primal, complementarity, asked = survey(small, state, equality, first, unit, strength)
    outside, pull, room = (length - radius) / unit, kappa * unit / strength, abs((radius - length) / unit)
    primal = outside if outside > primal else primal
    room = pull if pull < room else room
    complementarity = complementarity if room <= complementarity else room
    if primal * unit > MISSED * asked:
        return inf
    parts[0], parts[1], parts[2], parts[3] = rest / strength, primal, 0.0, complementarity
    worst = primal if complementarity <= primal else complementarity
    return worst if parts[0] <= worst else parts[0]


@entry_point(f"void(b1, {GIVEN}, {READ.format('f8', 1)}, f8, f8[::1], f8[::1], f8[::1])", interpreted=(16, 100_000))
def climb_directly(
    tangent, gradient, jacobian, bound, equality, radius, tolerance, value_out, multipliers_out, report_out
):
    """As `project_directly`, of B problems in balls; report: status, exchanges, residuals, κ, (7, B)."""
    n, count = jacobian.shape[1], radius.shape[0]
    m = jacobian.shape[0] // count if count > 0 else 0
    gradients, values = gradient.reshape((count, n)), value_out.reshape((count, n))
    reports = report_out.reshape((7, count))
    gram, factor, small, vectors = np.empty((m, m)), np.empty((m, m)), np.empty((11, m)), np.empty((3, n))
    state, order, parts = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(4)
    for b in range(count):
        usable = prepare(tangent, b, gradients, jacobian, bound, equality, gram, small, state)
        strength, worst = sqrt(inner(gradients, b, gradients, b)), inf
        usable = usable and 1.0 / SAFE < strength < SAFE and 1.0 / SAFE < radius[b] < SAFE
        for i in range(m):
            small[at.PULL, i] = 0.0
            if usable and state[i] != at.OFF:
                small[at.PULL, i] = inner(jacobian, b * m + i, gradients, b) * small[at.SCALE, i]
        kappa, size, changes = find_face(
            usable, b, radius[b], strength, gradients, jacobian, equality, gram, factor, small, state, order, vectors
        )
        if size >= 0:
            worst = judge_in_ball(
                b, radius[b], strength, kappa, size, gradients, jacobian, equality, small, state, order, values,
                vectors, parts,
            )  # fmt: skip
        reports[6, b] = kappa
        report(worst <= SHARP and worst <= tolerance, b, changes, parts, small, multipliers_out, reports)
