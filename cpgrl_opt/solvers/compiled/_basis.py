"""The active rows' orthonormal basis: Ĵ_active = Rᵀ Q, Q (q, n) with orthonormal rows, R (q, q) upper triangular.

Modified Gram–Schmidt, again where cancellation asks for it: "twice is enough" (Giraud, Langou & Rozložník 2005).
"""

from math import sqrt

from ._arithmetic import add, add_product, copy, dot, sharp_slack
from ._workspace import (
    ACTIVE,
    BOUND,
    COEFFICIENT,
    EPS,
    EQUALITY,
    FORWARD,
    KIND,
    MULTIPLIER,
    RANK,
    REST,
    ROWS,
    SPARE,
    TRIANGLE,
    USED,
    kernel,
)


@kernel
def orthogonalise(space, small, vector, size):
    """Takes the part along Q[:size] off a vector of length 1; COEFFICIENT = Q vector; returns the length left."""
    basis = ROWS + small.shape[1]
    for k in range(size):
        small[COEFFICIENT, k] = 0.0
    squared = 1.0
    for _ in range(3):
        before = squared
        for k in range(size):
            c = dot(space, basis + k, vector)
            small[COEFFICIENT, k] += c
            add(space, vector, -c, basis + k)
        squared = dot(space, vector, vector)
        if squared > 0.5 * before:
            break
    return sqrt(squared)


@kernel
def append(space, small, vector, size, length):
    """Q and R grow by an orthogonalised vector of this length and its COEFFICIENT."""
    row = ROWS + small.shape[1] + size
    for j in range(space.shape[1]):
        space[row, j] = space[vector, j] / length
    for k in range(size):
        small[TRIANGLE + k, size] = small[COEFFICIENT, k]
    small[TRIANGLE + size, size] = length


@kernel
def remove(space, small, index, position, size):
    """Takes a row out of the active set; those behind it are orthogonalised from scratch. Returns the new size."""
    index[USED, index[ACTIVE, position]] = 0
    first = ROWS + small.shape[1]
    for k in range(position, size - 1):
        index[ACTIVE, k] = index[ACTIVE, k + 1]
        small[MULTIPLIER, k] = small[MULTIPLIER, k + 1]
        copy(space, first + k, ROWS + index[ACTIVE, k])
        append(space, small, first + k, k, orthogonalise(space, small, first + k, k))
    return size - 1


@kernel
def solve_upper(small, row, size):
    """Row ← R⁻¹ row."""
    for i in range(size - 1, -1, -1):
        s = small[row, i]
        for j in range(i + 1, size):
            s -= small[TRIANGLE + i, j] * small[row, j]
        small[row, i] = s / small[TRIANGLE + i, i]


@kernel
def solve_lower(small, row, size):
    """Row ← R⁻ᵀ row."""
    for i in range(size):
        s = small[row, i]
        for j in range(i):
            s -= small[TRIANGLE + j, i] * small[row, j]
        small[row, i] = s / small[TRIANGLE + i, i]


@kernel
def _swap(space, small, index, a, b):
    basis = ROWS + small.shape[1]
    small[SPARE, a], small[SPARE, b] = small[SPARE, b], small[SPARE, a]
    index[ACTIVE, a], index[ACTIVE, b] = index[ACTIVE, b], index[ACTIVE, a]
    for j in range(space.shape[1]):
        space[basis + a, j], space[basis + b, j] = space[basis + b, j], space[basis + a, j]
    for k in range(TRIANGLE, TRIANGLE + a):
        small[k, a], small[k, b] = small[k, b], small[k, a]


@kernel
def equality_basis(space, small, index):
    """Q and R of the equality rows, the farthest from the span so far first; returns their rank.

    ACTIVE lists the independent rows, then the dependent ones. In this order a row that is a combination of
    two nearly parallel ones is still seen to be one.
    """
    m = small.shape[1]
    basis = ROWS + m
    count = 0
    for i in range(m):
        if index[KIND, i] == EQUALITY:
            copy(space, basis + count, ROWS + i)
            index[ACTIVE, count] = i
            small[SPARE, count] = 1.0
            count += 1
    for rank in range(count):
        best = rank
        for k in range(rank + 1, count):
            if small[SPARE, k] > small[SPARE, best]:
                best = k
        if best != rank:
            _swap(space, small, index, rank, best)
        length = sqrt(small[SPARE, rank])
        if length < 0.7:
            for k in range(rank):
                c = dot(space, basis + k, basis + rank)
                small[TRIANGLE + k, rank] += c
                add(space, basis + rank, -c, basis + k)
            length = sqrt(dot(space, basis + rank, basis + rank))
        if not length > RANK:
            return rank
        small[TRIANGLE + rank, rank] = length
        for j in range(space.shape[1]):
            space[basis + rank, j] /= length
        for k in range(rank + 1, count):
            c = dot(space, basis + rank, basis + k)
            small[TRIANGLE + rank, k] = c
            add(space, basis + k, -c, basis + rank)
            small[SPARE, k] = dot(space, basis + k, basis + k)
    return count


@kernel
def refine(space, small, index, size, x, t, u, weight, sharp):
    """Refinement of x − t = Ĵᵀ_active u, Ĵ_active x = weight·b̂ for x and t in rows of space, u in a row of small.

    Corrections by Q and R. Plain: two rounds, the first of which solves when started from x = t, u = 0; x comes
    from the basis, since t + Ĵᵀu cancels where u is large. Sharp: residuals in twice the precision until nothing
    changes; contracts by eps·cond(R) a round, so that rows 1e-9 rad apart cost two or three.
    Source: Björck 1967; Higham, Accuracy and Stability of Numerical Algorithms, §20.5.
    """
    basis = ROWS + small.shape[1]
    for _ in range(6 if sharp else 2):
        for j in range(space.shape[1]):
            space[REST, j] = space[t, j] - space[x, j]
        if sharp:
            for j in range(space.shape[1]):
                high, low = add_product(space[t, j], 0.0, -1.0, space[x, j])
                for k in range(size):
                    high, low = add_product(high, low, small[u, k], space[ROWS + index[ACTIVE, k], j])
                space[REST, j] = high + low
        for k in range(size):
            i = index[ACTIVE, k]
            if sharp:
                small[FORWARD, k] = sharp_slack(space, ROWS + i, x, weight * small[BOUND, i])
            else:
                small[FORWARD, k] = weight * small[BOUND, i] - dot(space, ROWS + i, x)
                add(space, REST, small[u, k], ROWS + i)
        solve_lower(small, FORWARD, size)
        for k in range(size):
            c = dot(space, basis + k, REST)
            small[SPARE, k] = small[FORWARD, k] - c
            add(space, REST, -c, basis + k)
        for k in range(size):
            add(space, REST, small[FORWARD, k], basis + k)
        solve_upper(small, SPARE, size)
        total, change = 0.0, 0.0
        for k in range(size):
            total += abs(small[u, k])
            change += abs(small[SPARE, k])
            small[u, k] += small[SPARE, k]
        add(space, x, 1.0, REST)
        if change <= 4 * EPS * total and dot(space, REST, REST) <= (4 * EPS) ** 2 * dot(space, x, x):
            break
