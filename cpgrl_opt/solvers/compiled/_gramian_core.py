"""Problems of many parameters by their Gramian alone: before and after the one pass that combines the vectors.

    K = [g; J][g; J]ᵀ ──weigh──▶ μ ──▶ d = g + Jᵀμ, J d, ‖d‖ ──judge──▶ residuals

with the direct pass's own search for the active set. Compiled always: numbers are few, but Python's are not.
"""

from math import inf, sqrt

import numpy as np

from . import _exchange as at
from ._direct import measure
from ._entry_point import READ, entry_point, inlined
from ._exchange import factorize, find_active_set, scale_row, solve

_SQUARES, _ROWS, _TRUTHS = READ.format("f8", 3), READ.format("f8", 2), READ.format("b1", 2)


@inlined
def scale_gramian(K, bound, least, most, gram, small, state):
    """Ĝ, ĉ, b̂ of the rows that are on, and lengths. False where the square of a length is not between the bounds."""
    usable = least < K[0, 0] < most
    for i in range(len(bound)):
        state[i], small[at.MU, i] = at.OFF if bound[i] == -inf else at.INSIDE, 0.0
        if state[i] != at.OFF:
            usable = usable and least < K[i + 1, i + 1] < most
            small[at.OFFSET, i] = K[i + 1, 0]
            gram[i, :i] = K[i + 1, 1 : i + 1]
            scale_row(i, sqrt(K[i + 1, i + 1]), bound[i], gram, small, state)
    return usable


@inlined
def is_well_apart(gram, factor, small, state, order, apart):
    """Whether Σ 1/λ(Ĝ) ≤ apart."""
    on, total = 0, 0.0
    for i in range(len(state)):
        on += state[i] == at.INSIDE
    if factorize(gram, factor, small, state, order) < on:
        return False
    for column in range(on):
        small[at.X, :on] = 0.0
        small[at.X, column] = 1.0
        solve(factor, small, on)
        total += small[at.X, column]
    return total <= apart


@inlined
def weigh_problem(K, bound, equality, least, most, apart, gram, factor, small, state, order, weights):
    """(1, μ) into weights; how many exchanges, −1 where rung "gramian" is shut, or a search does not end."""
    if not scale_gramian(K, bound, least, most, gram, small, state):
        return -1
    if not is_well_apart(gram, factor, small, state, order, apart):
        return -1
    for i in range(len(bound)):
        state[i] = at.OUTSIDE if state[i] == at.INSIDE and not equality[i] else state[i]
    size, changes = find_active_set(True, gram, factor, small, state, order, equality, 0)
    weights[:] = 0.0
    weights[0] = 1.0
    for k in range(size):
        i = order[k]
        small[at.MU, i] = small[at.X, k]
        weights[i + 1] = small[at.X, k] * small[at.SCALE, i]
    return changes if size >= 0 else -1


@entry_point(f"void({_SQUARES}, {_ROWS}, {_TRUTHS}, f8, f8, f8, f8[:, :, ::1], i8[:, ::1], f8[:, ::1], i8[::1])")
def weigh(K, bound, equality, least, most, apart, notes, states, weights, changes):
    """Of B problems: weights (B, 1 + m) and exchanges (B,), see `weigh_problem`. K: (B, 1 + m, 1 + m).

    least, most: squares; apart: what `is_well_apart` asks for. notes: (B, 8, m), states: (B, m), for `judge` to read.
    """
    m = bound.shape[1]
    gram, factor, order = np.empty((m, m)), np.empty((m, m)), np.empty(m, np.int64)
    for b in range(len(K)):
        small, state = notes[b], states[b]
        changes[b] = weigh_problem(
            K[b], bound[b], equality[b], least, most, apart, gram, factor, small, state, order, weights[b]
        )


@entry_point(f"void({_SQUARES}, {_TRUTHS}, f8, f8[:, :, ::1], i8[:, ::1], {_ROWS}, f8[:, ::1])")
def judge(K, equality, out_of_span, notes, states, sums, parts):
    """Residuals (B, 4) of sums [r·r, J d …, d·d], (B, 2 + m); the first infinite where d is not to trust.

    So it is by `measure`, and where d·d is less than out_of_span of g·g: it is what rounding of K leaves of it.
    """
    for b in range(len(K)):
        small, state, square = notes[b], states[b], sums[b, sums.shape[1] - 1]
        for i in range(len(state)):
            if state[i] != at.OFF:
                small[at.SLACK, i] = sums[b, i + 1] * small[at.SCALE, i] - small[at.BOUND, i]
        sigma = sqrt(max(K[b, 0, 0], square))
        parts[b] = 0.0
        worst = measure(small, state, equality[b], 0, sqrt(sums[b, 0]), sigma, parts[b])
        if not (worst < inf and square >= out_of_span * K[b, 0, 0]):
            parts[b, 0] = inf
