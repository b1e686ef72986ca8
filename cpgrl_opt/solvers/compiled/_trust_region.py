"""The usual trust region in one short pass: rows well apart, a ball that binds.

    max gᵀd  s.t.  Ĵd ≥ b̂ on I,  = on E,  ‖d‖ ≤ R:       d = q + p/κ,   μ̂ = κβ − γ on 𝒜
    Ĝβ = b̂,  Ĝγ = Ĵg  on 𝒜,    q = Ĵᵀβ,  p = g − Ĵᵀγ,   κ = ‖p‖/√(R² − ‖q‖²)

𝒜 is that of the projection of g/κ, the direct pass's; κ and 𝒜 are found in turns until they agree. All else is left to
`trust_region`. Nothing leaves this pass but optima with the referee's residuals. Source: see `trust_region`, `_direct`.
"""

from math import inf, sqrt

import numpy as np

from ._arithmetic import inner
from ._direct import (
    BOUND,
    MISSED,
    MU,
    OFF,
    OFFSET,
    OPEN,
    OPTIMAL,
    SAFE,
    SCALE,
    SLACK,
    WEIGHT,
    X,
    add_rows,
    find_active_set,
    prepare,
    solve,
)
from ._entry_point import entry_point, inlined
from ._workspace import Booleans, Floats, Integers, numbers

SHARP = 1e-13  # the worst residual, relative as the referee's, that an answer may have
MOST_TURNS = 12
NEGLIGIBLE = 1e-6  # ‖p‖/‖g‖ below it is left to those who tell it from rounding

# Rows of parts: q, p, the rest; and of face, one number a constraint: Ĵg, β, γ.
Q, P, REST = numbers(3)
PULL, BETA, GAMMA = numbers(3)


@inlined
def set_offsets(kappa: float, small: Floats, face: Floats) -> None:
    """ĉ = κb̂ − Ĵg, of which the direct pass finds 𝒜 and μ̂."""
    for i in range(small.shape[1]):
        small[OFFSET, i] = kappa * small[BOUND, i] - face[PULL, i]


@inlined
def push(
    at: int, row: int, jacobian: Floats, first: int, factor: Floats, small: Floats, order: Integers, size: int,
    parts: Floats, face: Floats,
) -> None:  # fmt: skip
    """parts[at] += Ĵᵀx, face[row] += x, with Ĝx = X on 𝒜."""
    solve(factor, small, size)
    for k in range(size):
        face[row, order[k]] += small[X, k]
        small[WEIGHT, order[k]] = small[X, k] * small[SCALE, order[k]]
    add_rows(parts, at, 1.0, jacobian, first, small, order, size)


@inlined
def split_face(
    problem: int, gradient: Floats, jacobian: Floats, factor: Floats, small: Floats, order: Integers, size: int,
    parts: Floats, face: Floats,
) -> None:  # fmt: skip
    """q, p, β and γ (negative), each corrected once by what it leaves of its equations."""
    first = problem * small.shape[1]
    for j in range(parts.shape[1]):
        parts[Q, j], parts[P, j] = 0.0, gradient[problem, j]
    for i in range(small.shape[1]):
        face[BETA, i], face[GAMMA, i] = 0.0, 0.0
    for _ in range(2):
        for k in range(size):
            i = order[k]
            small[X, k] = small[BOUND, i] - inner(jacobian, first + i, parts, Q) * small[SCALE, i]
        push(Q, BETA, jacobian, first, factor, small, order, size, parts, face)
        for k in range(size):
            small[X, k] = -inner(jacobian, first + order[k], parts, P) * small[SCALE, order[k]]
        push(P, GAMMA, jacobian, first, factor, small, order, size, parts, face)


@inlined
def find_face(
    usable: bool, problem: int, radius: float, strength: float, gradient: Floats, jacobian: Floats, equality: Booleans,
    gram: Floats, factor: Floats, small: Floats, state: Integers, order: Integers, parts: Floats, face: Floats,
) -> tuple[float, int, int]:  # fmt: skip
    """κ, how many rows its 𝒜 has (−1 where κ and 𝒜 do not come to agree), and exchanges."""
    first, total, turn, agreed = problem * small.shape[1], 0, 0 if usable else MOST_TURNS, -1
    kappa = strength / radius
    while turn < MOST_TURNS:
        set_offsets(kappa, small, face)
        size, changes = find_active_set(True, gram, factor, small, state, order, equality, first)
        total += changes
        if size >= 0 and turn > 0 and changes == 0:
            agreed, turn = size, MOST_TURNS
        elif size >= 0:
            split_face(problem, gradient, jacobian, factor, small, order, size, parts, face)
            room = radius * radius - inner(parts, Q, parts, Q)
            length = sqrt(inner(parts, P, parts, P))
            turn = turn + 1 if length > NEGLIGIBLE * strength else MOST_TURNS
            kappa = length / sqrt(room) if room > 0.0 else 8.0 * kappa
        else:
            turn = MOST_TURNS
    return kappa, agreed, total


@inlined
def judge_in_ball(
    problem: int, radius: float, strength: float, kappa: float, size: int, gradient: Floats, jacobian: Floats,
    equality: Booleans, small: Floats, state: Integers, order: Integers, value: Floats, parts: Floats, face: Floats,
    residuals: Floats,
) -> float:  # fmt: skip
    """d, μ into WEIGHT, the referee's residuals; the worst of these, inf where a bound is missed or NaN comes up."""
    first = problem * small.shape[1]
    for i in range(small.shape[1]):
        small[WEIGHT, i] = 0.0
        small[MU, i] = 0.0
    for k in range(size):
        i = order[k]
        mu = kappa * face[BETA, i] + face[GAMMA, i]
        small[MU, i] = mu if mu > 0.0 or equality[first + i] else 0.0
        small[WEIGHT, i] = small[MU, i] * small[SCALE, i]
    for j in range(value.shape[1]):
        value[problem, j] = parts[Q, j] + parts[P, j] / kappa
        parts[REST, j] = kappa * value[problem, j] - gradient[problem, j]
    add_rows(parts, REST, -1.0, jacobian, first, small, order, size)
    length = sqrt(inner(value, problem, value, problem))
    named, asked = radius, inf
    for i in range(small.shape[1]):
        if state[i] != OFF:
            b = abs(small[BOUND, i])
            named = b if 0.0 < b < named else named
            asked = b if 0.0 < b < asked and (equality[first + i] or small[BOUND, i] > 0.0) else asked
            small[SLACK, i] = inner(jacobian, first + i, value, problem) * small[SCALE, i] - small[BOUND, i]
    unit = length if length > named else named
    primal, complementarity = (length - radius) / unit, abs((radius - length) / unit)
    primal = primal if primal > 0.0 else 0.0
    if kappa * unit / strength < complementarity:
        complementarity = kappa * unit / strength
    for i in range(small.shape[1]):
        if state[i] != OFF:
            slack, mu = small[SLACK, i] / unit, small[MU, i] / strength
            if slack != slack:
                return inf
            missed = abs(slack) if equality[first + i] else -slack
            primal = primal if missed <= primal else missed
            if not equality[first + i]:
                least = abs(slack if slack < mu else mu)
                complementarity = complementarity if least <= complementarity else least
    if primal * unit > MISSED * asked:
        return inf
    residuals[0], residuals[1] = sqrt(inner(parts, REST, parts, REST)) / strength, primal
    residuals[2], residuals[3] = 0.0, complementarity
    worst = primal if complementarity <= primal else complementarity
    return worst if residuals[0] <= worst else residuals[0]


@entry_point(
    "void(b1, Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 1, 'C', readonly=True),"
    "Array(b1, 1, 'C', readonly=True), Array(f8, 1, 'C', readonly=True), f8, f8[::1], f8[::1], f8[::1])",
    interpreted=(16, 100_000),
)
def climb_directly(
    tangent: bool,
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
    radius: Floats,
    tolerance: float,
    value_out: Floats,
    multipliers_out: Floats,
    report_out: Floats,
) -> None:
    """As `project_directly`, of B problems in balls; report: status, exchanges, residuals, κ, (7, B)."""
    n, count = jacobian.shape[1], radius.shape[0]
    m = jacobian.shape[0] // count if count > 0 else 0
    gradients, values = gradient.reshape((count, n)), value_out.reshape((count, n))
    gram, factor, small, parts = np.empty((m, m)), np.empty((m, m)), np.empty((8, m)), np.empty((3, n))
    state, order, face, residuals = np.empty(m, np.int64), np.empty(m, np.int64), np.empty((3, m)), np.empty(4)
    for b in range(count):
        usable = prepare(tangent, b, gradients, jacobian, bound, equality, gram, small, state)
        strength = sqrt(inner(gradients, b, gradients, b))
        usable = usable and 1.0 / SAFE < strength < SAFE and 1.0 / SAFE < radius[b] < SAFE
        for i in range(m):
            face[PULL, i] = 0.0
            if usable and state[i] != OFF:
                face[PULL, i] = inner(jacobian, b * m + i, gradients, b) * small[SCALE, i]
        kappa, size, changes = find_face(
            usable, b, radius[b], strength, gradients, jacobian, equality,
            gram, factor, small, state, order, parts, face,
        )  # fmt: skip
        report_out[b], report_out[count + b] = OPEN, 0.0
        if size >= 0:
            worst = judge_in_ball(
                b, radius[b], strength, kappa, size, gradients, jacobian, equality, small, state, order, values,
                parts, face, residuals,
            )  # fmt: skip
            if worst <= SHARP and worst <= tolerance:
                report_out[b], report_out[count + b], report_out[6 * count + b] = OPTIMAL, changes, kappa
                for k in range(4):
                    report_out[(2 + k) * count + b] = residuals[k]
                for i in range(m):
                    multipliers_out[b * m + i] = small[WEIGHT, i]
