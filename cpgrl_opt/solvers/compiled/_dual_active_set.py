"""Goldfarb & Idnani's dual active set method for the identity metric, on unit rows.

Starts from the optimum under the equalities alone and takes in the most violated row, lowering the multipliers
of the rows in the way; a row whose multiplier reaches 0 leaves. The dual objective ½‖d − g‖² rises with
every row taken in, so no active set returns; rounding can still make one return, hence the limit.
Source: Goldfarb & Idnani, Mathematical Programming 27 (1983).
"""

import numpy as np

from ._arithmetic import add, copy, dot, norm
from ._basis import append, equality_basis, orthogonalise, refine, remove, solve_upper
from ._workspace import (
    ACTIVE,
    BOUND,
    CHANGE,
    COEFFICIENT,
    EPS,
    EQUALITY,
    INEQUALITY,
    KIND,
    MULTIPLIER,
    RANK,
    REFINED,
    REST,
    ROWS,
    SPARE,
    STEP,
    TARGET,
    THRESHOLD,
    TRIANGLE,
    USED,
    VALUE,
    kernel,
)

# How the method ends.
SETTLED, CONFLICT, LIMIT = 0, 1, 2
NEARLY_DEPENDENT = 1e-2  # a diagonal element of R below this: the last solve is refined
# A Farkas vector y on unit rows, max |y| = 1, proves infeasibility when it gains more than this (in units of the
# scaled problem) at a residual ‖Ĵᵀy‖ of rounding size.
CONCLUSIVE = 1e-10
FARKAS_ROUNDING = 64 * EPS


@kernel
def settle(space, small, index, size, refined):
    """d and μ of the active set from scratch, refined where rows are nearly dependent; rounding below 0 is cut."""
    copy(space, VALUE, TARGET)
    smallest = 1.0
    for k in range(size):
        small[MULTIPLIER, k] = 0.0
        smallest = min(smallest, small[TRIANGLE + k, k])
    sharp = refined or smallest < NEARLY_DEPENDENT
    refine(space, small, index, size, VALUE, TARGET, MULTIPLIER, 1.0, sharp)
    total = 0.0
    for k in range(size):
        total += abs(small[MULTIPLIER, k])
    for k in range(size):
        if index[KIND, index[ACTIVE, k]] == INEQUALITY and -EPS * total < small[MULTIPLIER, k] < 0.0:
            small[MULTIPLIER, k] = 0.0


@kernel
def most_violated(space, small, index):
    """The inequality outside the active set that d violates most, or −1."""
    scale = max(1.0, norm(space, VALUE))
    best, largest = -1, 0.0
    for i in range(small.shape[1]):
        if index[KIND, i] == INEQUALITY and index[USED, i] == 0:
            violation = small[BOUND, i] - dot(space, ROWS + i, VALUE)
            if violation > largest and violation > small[THRESHOLD, i] * scale:
                best, largest = i, violation
    return best


@kernel
def most_negative(small, index, size):
    """The position of the inequality with the most negative multiplier, or −1."""
    best, smallest = -1, 0.0
    for k in range(size):
        if index[KIND, index[ACTIVE, k]] == INEQUALITY and small[MULTIPLIER, k] < smallest:
            best, smallest = k, small[MULTIPLIER, k]
    return best


@kernel
def direction(space, small, index, p, size, refined):
    """Row p = Ĵᵀ_active CHANGE + STEP with STEP ⟂ the active rows; returns ‖STEP‖."""
    copy(space, STEP, ROWS + p)
    length = orthogonalise(space, small, STEP, size)
    for k in range(size):
        small[CHANGE, k] = small[COEFFICIENT, k]
    solve_upper(small, CHANGE, size)
    if refined and size > 0:
        for k in range(size):
            small[CHANGE, k] = -small[CHANGE, k]
        refine(space, small, index, size, STEP, ROWS + p, CHANGE, 0.0, REFINED)
        for k in range(size):
            small[CHANGE, k] = -small[CHANGE, k]
        length = norm(space, STEP)
    return length


@kernel
def blocking(small, index, size):
    """The position whose multiplier reaches 0 first when a row comes in, or −1, and the step until then."""
    largest = 1.0
    for k in range(size):
        largest = max(largest, abs(small[CHANGE, k]))
    best, step = -1, np.inf
    for k in range(size):
        if index[KIND, index[ACTIVE, k]] == INEQUALITY and small[CHANGE, k] > 16 * EPS * largest:
            ratio = small[MULTIPLIER, k] / small[CHANGE, k]
            if ratio < step:
                best, step = k, ratio
    return best, step


@kernel
def farkas(space, small, index, p, size, sign):
    """y = sign·(e_p − CHANGE on the active rows) into THRESHOLD if it proves infeasibility, else False."""
    m = small.shape[1]
    for i in range(m):
        small[SPARE, i] = 0.0
    small[SPARE, p] = sign
    largest = 1.0
    for k in range(size):
        i = index[ACTIVE, k]
        y = -sign * small[CHANGE, k]
        small[SPARE, i] = max(y, 0.0) if index[KIND, i] == INEQUALITY else y
        largest = max(largest, abs(y))
    gain, weight = 0.0, 0.0
    for j in range(space.shape[1]):
        space[REST, j] = 0.0
    for i in range(m):
        y = small[SPARE, i] / largest
        small[SPARE, i] = y
        if y != 0.0:
            gain += y * small[BOUND, i]
            weight += abs(y)
            add(space, REST, y, ROWS + i)
    if not (gain > CONCLUSIVE and norm(space, REST) <= FARKAS_ROUNDING * weight):
        return False
    copy(small, THRESHOLD, SPARE)
    return True


@kernel
def dependent_equalities_hold(space, small, index, size, refined):
    """Whether the equality rows outside the basis hold, or are too near to it to prove that they cannot."""
    for i in range(small.shape[1]):
        if index[KIND, i] == EQUALITY and index[USED, i] == 0:
            violation = small[BOUND, i] - dot(space, ROWS + i, VALUE)
            if abs(violation) > CONCLUSIVE:
                direction(space, small, index, i, size, refined)
                if farkas(space, small, index, i, size, 1.0 if violation > 0 else -1.0):
                    return False
    return True


@kernel
def dual_active_set(space, small, index, refined, sharpness):
    """Solves the scaled problem; returns how it ended, the size of the active set, and its changes.

    Leaves d in VALUE and μ, by position in ACTIVE, in MULTIPLIER; at a conflict a Farkas vector, by row, in
    THRESHOLD. refined: every step in twice the precision. sharpness: violations up to this, relative to
    max(1, ‖d‖), are rounding.
    """
    m, n = small.shape[1], space.shape[1]
    for i in range(m):
        small[THRESHOLD, i] = sharpness
        index[USED, i] = 0
    size = equality_basis(space, small, index)
    for k in range(size):
        index[USED, index[ACTIVE, k]] = 1
    settle(space, small, index, size, refined)
    if not dependent_equalities_hold(space, small, index, size, refined):
        return CONFLICT, size, 0
    limit = 20 + 10 * m
    changes, p, gained, settled = 0, -1, 0.0, True
    while changes < limit:
        if p < 0:
            p = most_violated(space, small, index)
            gained = 0.0
        if p < 0:
            if not settled:
                settle(space, small, index, size, refined)
                settled = True
                if refined:
                    continue
            k = most_negative(small, index, size) if refined else -1
            if k < 0:
                return SETTLED, size, changes
            size = remove(space, small, index, k, size)
            settle(space, small, index, size, refined)
            changes += 1
            continue
        changes += 1
        settled = False
        length = direction(space, small, index, p, size, refined)
        dependent = size >= n or not length > RANK
        violation = small[BOUND, p] - dot(space, ROWS + p, VALUE)
        k, step = blocking(small, index, size)
        if dependent and k < 0:
            if farkas(space, small, index, p, size, 1.0):
                return CONFLICT, size, changes
            small[THRESHOLD, p] = 2 * abs(violation)
            p = -1
            continue
        full = np.inf if dependent else max(violation, 0.0) / length**2
        taken = min(step, full)
        for j in range(size):
            small[MULTIPLIER, j] -= taken * small[CHANGE, j]
            if index[KIND, index[ACTIVE, j]] == INEQUALITY:
                small[MULTIPLIER, j] = max(small[MULTIPLIER, j], 0.0)
        gained += taken
        if not dependent:
            add(space, VALUE, taken, STEP)
        if full > step:
            size = remove(space, small, index, k, size)
            continue
        if refined:  # the refined step was for the decisions; the basis takes the plain one
            copy(space, STEP, ROWS + p)
            length = orthogonalise(space, small, STEP, size)
        append(space, small, STEP, size, length)
        index[ACTIVE, size] = p
        index[USED, p] = 1
        small[MULTIPLIER, size] = gained
        size += 1
        p = -1
        if refined:
            refine(space, small, index, size, VALUE, TARGET, MULTIPLIER, 1.0, REFINED)
    settle(space, small, index, size, refined)
    return LIMIT, size, changes
