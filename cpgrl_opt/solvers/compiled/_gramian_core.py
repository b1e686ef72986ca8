"""Problems of many parameters by their Gramian alone: before and after the one pass that combines the vectors.

    K = [g; J][g; J]ᵀ ──weigh──▶ μ ──▶ d = g + Jᵀμ, J d, ‖d‖ ──judge──▶ residuals

with the direct pass's own search for the active set. Compiled always: numbers are few, but Python's are not.
"""

from math import inf, sqrt

from ._direct import (
    BOUND,
    INSIDE,
    MU,
    OFF,
    OFFSET,
    OUTSIDE,
    SCALE,
    SLACK,
    X,
    factorize,
    find_active_set,
    measure,
    solve,
)
from ._entry_point import entry_point, inlined
from ._workspace import Booleans, Floats, Integers

_READ = "Array({}, {}, 'C', readonly=True)"


@inlined
def scale_gramian(
    K: Floats, bound: Floats, least: float, most: float, gram: Floats, small: Floats, state: Integers
) -> bool:
    """Ĝ, ĉ, b̂ of the rows that are on, and lengths. False where the square of a length is not between the bounds."""
    usable: bool = least < K[0, 0] < most
    for i in range(len(bound)):
        state[i] = OFF if bound[i] == -inf else INSIDE
        small[MU, i] = 0.0
        if state[i] != OFF:
            usable = usable and least < K[i + 1, i + 1] < most
            scale = 1.0 / sqrt(K[i + 1, i + 1])
            small[SCALE, i], small[BOUND, i] = scale, bound[i] * scale
            small[OFFSET, i] = small[BOUND, i] - K[i + 1, 0] * scale
            for k in range(i):
                if state[k] != OFF:
                    gram[i, k] = K[i + 1, k + 1] * scale * small[SCALE, k]
                    gram[k, i] = gram[i, k]
            gram[i, i] = 1.0
    return usable


@inlined
def is_well_apart(gram: Floats, factor: Floats, small: Floats, state: Integers, order: Integers, apart: float) -> bool:
    """Whether Σ 1/λ(Ĝ) ≤ apart."""
    on, total = 0, 0.0
    for i in range(len(state)):
        on += state[i] == INSIDE
    if factorize(gram, factor, small, state, order) < on:
        return False
    for column in range(on):
        small[X, :on] = 0.0
        small[X, column] = 1.0
        solve(factor, small, on)
        total += small[X, column]
    return total <= apart


@entry_point(
    f"void({_READ.format('f8', 2)}, {_READ.format('f8', 1)}, {_READ.format('b1', 1)}, {_READ.format('f8', 1)},"
    "f8[:, ::1], i8[:, ::1], f8[::1], f8[::1])",
    interpreted=(0, 0),
)
def weigh(
    K: Floats, bound: Floats, equality: Booleans, gates: Floats, work: Floats, index: Integers, weights: Floats,
    report: Floats,
) -> None:  # fmt: skip
    """(1, μ) into weights, exchanges into report; −1 there where rung "gramian" is shut, or a search does not end.

    gates: the least and the largest square, and what `is_well_apart` asks for. work: (8 + 2m, m), index: (2, m), for
    `judge` to read.
    """
    m = len(bound)
    small, gram, factor, state, order = work[:8], work[8 : 8 + m], work[8 + m :], index[0], index[1]
    report[0] = -1.0
    if not scale_gramian(K, bound, gates[0], gates[1], gram, small, state):
        return
    if not is_well_apart(gram, factor, small, state, order, gates[2]):
        return
    for i in range(m):
        state[i] = OUTSIDE if state[i] == INSIDE and not equality[i] else state[i]
    size, changes = find_active_set(True, gram, factor, small, state, order, equality, 0)
    if size >= 0:
        report[0] = changes
        weights[:] = 0.0
        weights[0] = 1.0
        for k in range(size):
            i = order[k]
            small[MU, i] = small[X, k]
            weights[i + 1] = small[X, k] * small[SCALE, i]


@entry_point(
    f"void({_READ.format('f8', 2)}, {_READ.format('b1', 1)}, {_READ.format('f8', 1)}, f8[:, ::1], i8[:, ::1],"
    f"{_READ.format('f8', 1)}, f8[::1])",
    interpreted=(0, 0),
)
def judge(
    K: Floats, equality: Booleans, gates: Floats, work: Floats, index: Integers, sums: Floats, report: Floats
) -> None:
    """Residuals of [r·r, J d …, d·d]; the first infinite where d is not to trust, see `measure`.

    So where d·d is less than gates[3] of g·g: it is what rounding of K leaves of it.
    """
    small, state, sigma = work[:8], index[0], sqrt(max(K[0, 0], sums[len(sums) - 1]))
    for i in range(len(equality)):
        if state[i] != OFF:
            small[SLACK, i] = sums[i + 1] * small[SCALE, i] - small[BOUND, i]
    worst = measure(small, state, equality, 0, sqrt(sums[0]), sigma, report)
    if not (worst < inf and sums[len(sums) - 1] >= gates[3] * K[0, 0]):
        report[0] = inf
