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

_SQUARE, _VECTOR, _TRUTHS = READ.format("f8", 2), READ.format("f8", 1), READ.format("b1", 1)


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


@entry_point(f"i8({_SQUARE}, {_VECTOR}, {_TRUTHS}, f8, f8, f8, f8[:, ::1], i8[:, ::1], f8[::1])")
def weigh(K, bound, equality, least, most, apart, work, index, weights):
    """(1, μ) into weights; how many exchanges, −1 where rung "gramian" is shut, or a search does not end.

    least, most: squares; apart: what `is_well_apart` asks for. work: (8 + 2m, m), index: (2, m), for `judge` to read.
    """
    m = len(bound)
    small, gram, factor, state, order = work[:8], work[8 : 8 + m], work[8 + m :], index[0], index[1]
    if not scale_gramian(K, bound, least, most, gram, small, state):
        return -1
    if not is_well_apart(gram, factor, small, state, order, apart):
        return -1
    for i in range(m):
        state[i] = at.OUTSIDE if state[i] == at.INSIDE and not equality[i] else state[i]
    size, changes = find_active_set(True, gram, factor, small, state, order, equality, 0)
    weights[:] = 0.0
    weights[0] = 1.0
    for k in range(size):
        i = order[k]
        small[at.MU, i] = small[at.X, k]
        weights[i + 1] = small[at.X, k] * small[at.SCALE, i]
    return changes if size >= 0 else -1


@entry_point(f"UniTuple(f8, 4)({_SQUARE}, {_TRUTHS}, f8, f8[:, ::1], i8[:, ::1], {_VECTOR})")
def judge(K, equality, out_of_span, work, index, sums):
    """Residuals of [r·r, J d …, d·d]; the first infinite where d is not to trust, see `measure`.

    So where d·d is less than out_of_span of g·g: it is what rounding of K leaves of it.
    """
    small, state, sigma, parts = work[:8], index[0], sqrt(max(K[0, 0], sums[len(sums) - 1])), np.zeros(4)
    for i in range(len(equality)):
        if state[i] != at.OFF:
            small[at.SLACK, i] = sums[i + 1] * small[at.SCALE, i] - small[at.BOUND, i]
    worst = measure(small, state, equality, 0, sqrt(sums[0]), sigma, parts)
    is_trusted = worst < inf and sums[len(sums) - 1] >= out_of_span * K[0, 0]
    return parts[0] if is_trusted else inf, parts[1], parts[2], parts[3]
