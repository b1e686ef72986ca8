"""The active set of rows well apart, from the Gram matrix of the unit rows alone.

    Ĝ = ĴĴᵀ,  ĉ = b̂ − Ĵg:    Ĝ_𝒜𝒜 μ̂_𝒜 = ĉ_𝒜,    μ̂ ≥ 0 and Ĝμ̂ ≥ ĉ on I,    μ̂ = 0 outside 𝒜        μᵢ = μ̂ᵢ/‖Jᵢ‖

𝒜 changes by one row at a time.
Source: the projection's dual as a linear complementarity problem (Cottle, Pang & Stone 1992, §1).
"""

from ._entry_point import inlined
from ._workspace import EPS, numbers

APART, COPY = 1e-4, 1e-12  # squared distances from the others' span: well apart from here on; a combination up to here
# At a vertex further rows are missed by rounding: at 4 eps a dozen in 20 000 problems exchanged them without an end.
# The residual judges the answer in any case.
VERTEX = 16 * EPS

# Rows of small, one number a constraint: b̂, ĉ, 1/‖Jᵢ‖, μ̂, μ, Ĵᵢd − b̂ᵢ; two by the order of 𝒜: 1/D, solution; and of
# a face in a ball Ĵg, β, γ.
BOUND, OFFSET, SCALE, MU, WEIGHT, SLACK, INVERSE, X, PULL, BETA, GAMMA = numbers(11)
OUTSIDE, INSIDE, COPIED, OFF = numbers(4)  # states of a constraint


@inlined
def scale_row(i, length, bound, gram, small, state):
    """Row i of Ĝ, of b̂ and ĉ in place of that of JJᵀ and, for ĉ, of Jg; the rows before are scaled."""
    scale = 1.0 / length
    small[SCALE, i], small[BOUND, i] = scale, bound * scale
    small[OFFSET, i] = small[BOUND, i] - small[OFFSET, i] * scale
    for k in range(i):
        if state[k] != OFF:
            gram[i, k] = gram[i, k] * scale * small[SCALE, k]
            gram[k, i] = gram[i, k]
    gram[i, i] = 1.0


@inlined
def factorize(gram, factor, small, state, order):
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
def solve(factor, small, size):
    """X ← (LDLᵀ)⁻¹ X."""
    for i in range(size):
        for j in range(i):
            small[X, i] -= factor[i, j] * small[X, j]
    for i in range(size - 1, -1, -1):
        small[X, i] *= small[INVERSE, i]
        for j in range(i + 1, size):
            small[X, i] -= factor[j, i] * small[X, j]


@inlined
def most_negative(small, order, size, equality, first):
    """The inequality of 𝒜 whose multiplier is most negative, or −1."""
    worst, found = 0.0, -1
    for k in range(size):
        if small[X, k] < worst and not equality[first + order[k]]:
            worst, found = small[X, k], order[k]
    return found


@inlined
def most_violated(gram, small, state, order, size):
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
def find_active_set(usable, gram, factor, small, state, order, equality, first):
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
