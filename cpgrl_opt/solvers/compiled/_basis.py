"""The active rows' orthonormal basis: J_active = Rᵀ Q, Q (q, n) with orthonormal rows, R (q, q) upper triangular."""

from math import sqrt

from . import _workspace as at
from ._arithmetic import add, add_product, dot
from ._entry_point import inlined, kernel

NEARLY_DEPENDENT = 1e-2  # with a diagonal element of R below this, projections are refined


@kernel
def solve_upper(small, row, size):
    """Row ← R⁻¹ row."""
    for i in range(size - 1, -1, -1):
        s = small[row, i]
        for j in range(i + 1, size):
            s -= small[at.TRIANGLE + i, j] * small[row, j]
        small[row, i] = s / small[at.TRIANGLE + i, i]


@kernel
def solve_lower(small, row, size):
    """Row ← R⁻ᵀ row."""
    for i in range(size):
        s = small[row, i]
        for j in range(i):
            s -= small[at.TRIANGLE + j, i] * small[row, j]
        small[row, i] = s / small[at.TRIANGLE + i, i]


@inlined
def find_slack(space, small, index, size, x, weight, sharp):
    """FORWARD ← weight·b − J_active x, in twice the precision if sharp."""
    for k in range(size):
        row, bound = at.ROWS + index[at.ACTIVE, k], weight * small[at.BOUND, index[at.ACTIVE, k]]
        if sharp:
            high, low = bound, 0.0
            for j in range(space.shape[1]):
                high, low = add_product(high, low, -space[row, j], space[x, j])
            small[at.FORWARD, k] = high + low
        else:
            small[at.FORWARD, k] = bound - dot(space, row, x)


@inlined
def find_rest(space, small, index, size, x, t, u, sharp):
    """REST ← t − x + Jᵀ_active u, in twice the precision if sharp."""
    for j in range(space.shape[1]):
        high, low = space[t, j] - space[x, j], 0.0
        if sharp:
            high, low = add_product(space[t, j], 0.0, -1.0, space[x, j])
            for k in range(size):
                high, low = add_product(high, low, small[u, k], space[at.ROWS + index[at.ACTIVE, k], j])
        space[at.REST, j] = high + low
    if not sharp:
        for k in range(size):
            add(space, at.REST, small[u, k], at.ROWS + index[at.ACTIVE, k])


@kernel
def project(space, small, index, size, x, t, u, weight, sharp):
    """Solves x − t = Jᵀ_active u, J_active x = weight·b for x, given t (rows of space), and u (row of small).

    Corrections by Q and R, from x = t, u = 0: two rounds where the rows are well apart. Otherwise, or if sharp,
    residuals in twice the precision until nothing changes; that contracts by eps·cond(R) a round, so that rows
    1e-9 rad apart cost three or four, and x does not suffer from the cancellation in t + Jᵀu.
    Source: Björck 1967; Higham, Accuracy and Stability of Numerical Algorithms, §20.5.
    """
    basis = at.ROWS + small.shape[1]
    for j in range(space.shape[1]):
        space[x, j], space[at.REST, j] = space[t, j], 0.0
    for k in range(size):
        small[u, k] = 0.0
        sharp = sharp or small[at.TRIANGLE + k, k] < NEARLY_DEPENDENT
    for attempt in range(0 if size == 0 else (8 if sharp else 2)):
        find_slack(space, small, index, size, x, weight, sharp)
        solve_lower(small, at.FORWARD, size)
        if attempt > 0:
            find_rest(space, small, index, size, x, t, u, sharp)
        for k in range(size):
            c = dot(space, basis + k, at.REST) if attempt > 0 else 0.0
            small[at.SPARE, k] = small[at.FORWARD, k] - c
            add(space, at.REST, small[at.SPARE, k], basis + k)
        solve_upper(small, at.SPARE, size)
        total, change = 0.0, 0.0
        for k in range(size):
            total += abs(small[u, k])
            change += abs(small[at.SPARE, k])
            small[u, k] += small[at.SPARE, k]
        add(space, x, 1.0, at.REST)
        if sharp and change <= 4 * at.EPS * total and dot(space, at.REST, at.REST) <= 16 * at.EPS**2 * dot(space, x, x):
            break


@kernel
def append(space, small, index, p, size, length):
    """Row p joins at position size: Q grows by STEP, its part orthogonal to Q, of this length."""
    basis = at.ROWS + small.shape[1]
    for j in range(space.shape[1]):
        space[basis + size, j] = space[at.STEP, j] / length
    for k in range(size):
        small[at.TRIANGLE + k, size] = dot(space, basis + k, at.ROWS + p)
    small[at.TRIANGLE + size, size] = length
    index[at.ACTIVE, size], index[at.USED, p] = p, 1


@kernel
def remove(small, index, position, size):
    """Takes a row out of the active set; Q and R are valid up to its position, the new rest is to be appended."""
    index[at.USED, index[at.ACTIVE, position]] = 0
    for k in range(position, size - 1):
        index[at.ACTIVE, k] = index[at.ACTIVE, k + 1]
        small[at.MULTIPLIER, k] = small[at.MULTIPLIER, k + 1]
    return size - 1


@inlined
def collect_equalities(space, small, index):
    """Their number; ACTIVE ← their numbers, SPARE ← their squared lengths, the rows of Q ← themselves."""
    basis, count = at.ROWS + small.shape[1], 0
    for i in range(small.shape[1]):
        index[at.USED, i] = 0
        if index[at.KIND, i] == at.EQUALITY:
            for j in range(space.shape[1]):
                space[basis + count, j] = space[at.ROWS + i, j]
            index[at.ACTIVE, count] = i
            small[at.SPARE, count] = dot(space, at.ROWS + i, at.ROWS + i)
            count += 1
    return count


@kernel
def equality_basis(space, small, index, tolerance):
    """Q and R of the equality rows, the farthest from the span so far first, down to a tolerance; returns their rank.

    ACTIVE lists the independent rows, then the dependent ones. In this order a row that is a combination of
    two nearly parallel ones is still seen to be one. Modified Gram–Schmidt, again where cancellation asks for
    it: "twice is enough" (Giraud, Langou & Rozložník 2005).
    """
    basis, count = at.ROWS + small.shape[1], collect_equalities(space, small, index)
    most = count if count < space.shape[1] else space.shape[1]
    for rank in range(most):
        best = rank
        for k in range(rank + 1, count):
            if small[at.SPARE, k] > small[at.SPARE, best]:
                best = k
        p = index[at.ACTIVE, best]
        index[at.ACTIVE, best], small[at.SPARE, best] = index[at.ACTIVE, rank], small[at.SPARE, rank]
        for j in range(space.shape[1]):
            space[at.STEP, j] = space[basis + best, j]
            space[basis + best, j] = space[basis + rank, j]
        for k in range(rank):
            add(space, at.STEP, -dot(space, basis + k, at.STEP), basis + k)
        length = sqrt(dot(space, at.STEP, at.STEP))
        if not length > tolerance:
            index[at.ACTIVE, rank] = p
            return rank
        append(space, small, index, p, rank, length)
        for k in range(rank + 1, count):
            add(space, basis + k, -dot(space, basis + rank, basis + k), basis + rank)
            small[at.SPARE, k] = dot(space, basis + k, basis + k)
    return most
