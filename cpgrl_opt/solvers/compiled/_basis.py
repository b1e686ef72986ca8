"""The active rows' orthonormal basis: J_active = Rᵀ Q, Q (q, n) with orthonormal rows, R (q, q) upper triangular."""

from math import sqrt

from ._arithmetic import add, add_product, dot
from ._entry_point import kernel
from ._workspace import (
    ACTIVE,
    BOUND,
    EPS,
    EQUALITY,
    FORWARD,
    KIND,
    MULTIPLIER,
    REST,
    ROWS,
    SPARE,
    STEP,
    TRIANGLE,
    USED,
    Floats,
    Integers,
)

NEARLY_DEPENDENT = 1e-2  # with a diagonal element of R below this, projections are refined


@kernel
def solve_upper(small: Floats, row: int, size: int) -> None:
    """Row ← R⁻¹ row."""
    for i in range(size - 1, -1, -1):
        s = small[row, i]
        for j in range(i + 1, size):
            s -= small[TRIANGLE + i, j] * small[row, j]
        small[row, i] = s / small[TRIANGLE + i, i]


@kernel
def solve_lower(small: Floats, row: int, size: int) -> None:
    """Row ← R⁻ᵀ row."""
    for i in range(size):
        s = small[row, i]
        for j in range(i):
            s -= small[TRIANGLE + j, i] * small[row, j]
        small[row, i] = s / small[TRIANGLE + i, i]


@kernel
def project(
    space: Floats, small: Floats, index: Integers, size: int, x: int, t: int, u: int, weight: float, sharp: bool
) -> None:
    """Solves x − t = Jᵀ_active u, J_active x = weight·b for x, given t (rows of space), and u (row of small).

    Corrections by Q and R, from x = t, u = 0: two rounds where the rows are well apart. Otherwise, or if sharp,
    residuals in twice the precision until nothing changes; that contracts by eps·cond(R) a round, so that rows
    1e-9 rad apart cost three or four, and x does not suffer from the cancellation in t + Jᵀu.
    Source: Björck 1967; Higham, Accuracy and Stability of Numerical Algorithms, §20.5.
    """
    n, basis = space.shape[1], ROWS + small.shape[1]
    for j in range(n):
        space[x, j] = space[t, j]
    if size == 0:
        return
    for k in range(size):
        small[u, k] = 0.0
        sharp = sharp or small[TRIANGLE + k, k] < NEARLY_DEPENDENT
    for attempt in range(8 if sharp else 2):
        for k in range(size):
            i = ROWS + index[ACTIVE, k]
            if sharp:
                high, low = weight * small[BOUND, i - ROWS], 0.0
                for j in range(n):
                    high, low = add_product(high, low, -space[i, j], space[x, j])
                small[FORWARD, k] = high + low
            else:
                small[FORWARD, k] = weight * small[BOUND, i - ROWS] - dot(space, i, x)
        solve_lower(small, FORWARD, size)
        for j in range(n):
            high, low = space[t, j] - space[x, j], 0.0
            if sharp and attempt > 0:
                high, low = add_product(space[t, j], 0.0, -1.0, space[x, j])
                for k in range(size):
                    high, low = add_product(high, low, small[u, k], space[ROWS + index[ACTIVE, k], j])
            space[REST, j] = high + low
        for k in range(size):
            if attempt > 0 and not sharp:
                add(space, REST, small[u, k], ROWS + index[ACTIVE, k])
        for k in range(size):
            c = dot(space, basis + k, REST) if attempt > 0 else 0.0
            small[SPARE, k] = small[FORWARD, k] - c
            add(space, REST, small[SPARE, k], basis + k)
        solve_upper(small, SPARE, size)
        total, change = 0.0, 0.0
        for k in range(size):
            total += abs(small[u, k])
            change += abs(small[SPARE, k])
            small[u, k] += small[SPARE, k]
        add(space, x, 1.0, REST)
        if sharp and change <= 4 * EPS * total and dot(space, REST, REST) <= 16 * EPS * EPS * dot(space, x, x):
            break


@kernel
def append(space: Floats, small: Floats, index: Integers, p: int, size: int, length: float) -> None:
    """Row p joins at position size: Q grows by STEP, its part orthogonal to Q, of this length."""
    basis = ROWS + small.shape[1]
    for j in range(space.shape[1]):
        space[basis + size, j] = space[STEP, j] / length
    for k in range(size):
        small[TRIANGLE + k, size] = dot(space, basis + k, ROWS + p)
    small[TRIANGLE + size, size] = length
    index[ACTIVE, size] = p
    index[USED, p] = 1


@kernel
def remove(small: Floats, index: Integers, position: int, size: int) -> int:
    """Takes a row out of the active set; Q and R are valid up to its position, the new rest is to be appended."""
    index[USED, index[ACTIVE, position]] = 0
    for k in range(position, size - 1):
        index[ACTIVE, k] = index[ACTIVE, k + 1]
        small[MULTIPLIER, k] = small[MULTIPLIER, k + 1]
    return size - 1


@kernel
def equality_basis(space: Floats, small: Floats, index: Integers, tolerance: float) -> int:
    """Q and R of the equality rows, the farthest from the span so far first, down to a tolerance; returns their rank.

    ACTIVE lists the independent rows, then the dependent ones. In this order a row that is a combination of
    two nearly parallel ones is still seen to be one. Modified Gram–Schmidt, again where cancellation asks for
    it: "twice is enough" (Giraud, Langou & Rozložník 2005).
    """
    m, basis, count = small.shape[1], ROWS + small.shape[1], 0
    for i in range(m):
        index[USED, i] = 0
        if index[KIND, i] == EQUALITY:
            for j in range(space.shape[1]):
                space[basis + count, j] = space[ROWS + i, j]
            index[ACTIVE, count] = i
            small[SPARE, count] = dot(space, ROWS + i, ROWS + i)
            count += 1
    for rank in range(count if count < space.shape[1] else space.shape[1]):
        best = rank
        for k in range(rank + 1, count):
            if small[SPARE, k] > small[SPARE, best]:
                best = k
        p = index[ACTIVE, best]
        index[ACTIVE, best] = index[ACTIVE, rank]
        small[SPARE, best] = small[SPARE, rank]
        for j in range(space.shape[1]):
            space[STEP, j] = space[basis + best, j]
            space[basis + best, j] = space[basis + rank, j]
        for k in range(rank):
            add(space, STEP, -dot(space, basis + k, STEP), basis + k)
        length = sqrt(dot(space, STEP, STEP))
        if not length > tolerance:
            index[ACTIVE, rank] = p
            return rank
        append(space, small, index, p, rank, length)
        for k in range(rank + 1, count):
            add(space, basis + k, -dot(space, basis + rank, basis + k), basis + rank)
            small[SPARE, k] = dot(space, basis + k, basis + k)
    return count if count < space.shape[1] else space.shape[1]
