"""Goldfarb & Idnani's dual active set method for the identity metric, on unit rows.

Starts from the optimum under the equalities alone and takes in the most violated row, lowering the multipliers
of the rows in the way; a row whose multiplier reaches 0 leaves. The dual objective ½‖d − g‖² rises with
every row taken in, so no active set returns; rounding can still make one return, hence the limit.
Source: Goldfarb & Idnani, Mathematical Programming 27 (1983).
"""

from math import inf, sqrt

from ._arithmetic import add, dot
from ._basis import append, equality_basis, project, remove
from ._entry_point import kernel
from ._workspace import (
    ACTIVE,
    BOUND,
    CHANGE,
    EPS,
    EQUALITY,
    INEQUALITY,
    KIND,
    MULTIPLIER,
    REST,
    ROWS,
    SPARE,
    STEP,
    TARGET,
    THRESHOLD,
    USED,
    VALUE,
    Floats,
    Integers,
    numbers,
)

# Attempts; the violations, relative to max(1, ‖d‖), that each takes for rounding; and the residual length below which
# a row counts as a combination of others. Copies and rotated copies leave rounding of 1e-15·√n; a row left out is
# violated by at most 1e-13·‖d‖, well inside the promised 1e-12. LENIENT takes rows for dependent, too, that rounding
# of the others could make so; LOOSE is for constraints that hold by a hair; POLISHING, in two grades, for equalities
# that may give.
PLAIN, REFINED, LENIENT, LAST, LOOSE, POLISHING = numbers(6)
ROUNDING = (2e-15, 2e-15, 2e-15, 1e-13, 1e-14, 2e-15, 2e-15)
RANK = (1e-13, 1e-13, 1e-13, 1e-13, 1e-13, 1e-5, 1e-3)

# How the method ends.
SETTLED, CONFLICT, LIMIT = 0, 1, 2
# A Farkas vector y on unit rows, max |y| = 1, proves infeasibility when it gains more than this (in units of the
# scaled problem) at a residual ‖Ĵᵀy‖ of rounding size.
CONCLUSIVE = 1e-10
FARKAS_ROUNDING = 64 * EPS


@kernel
def settle(space: Floats, small: Floats, index: Integers, size: int, sharp: bool) -> int:
    """d and μ of the active set from scratch; returns the position of the most negative multiplier, or −1.

    A negative multiplier of rounding size is cut to 0.
    """
    project(space, small, index, size, VALUE, TARGET, MULTIPLIER, 1.0, sharp)
    total = 0.0
    for k in range(size):
        total += abs(small[MULTIPLIER, k])
    best, smallest = -1, 0.0
    for k in range(size):
        if index[KIND, index[ACTIVE, k]] == INEQUALITY and small[MULTIPLIER, k] < 0.0:
            if small[MULTIPLIER, k] > -EPS * total:
                small[MULTIPLIER, k] = 0.0
            elif small[MULTIPLIER, k] < smallest:
                best, smallest = k, small[MULTIPLIER, k]
    return best


@kernel
def most_violated(space: Floats, small: Floats, index: Integers) -> int:
    """The row outside the active set that d violates most, or −1. A row that is off has bound −inf, or is 0 ≥ 0."""
    scale = sqrt(dot(space, VALUE, VALUE))
    scale = scale if scale > 1.0 else 1.0
    best, largest = -1, 0.0
    for i in range(small.shape[1]):
        if index[USED, i] == 0:
            violation = small[BOUND, i] - dot(space, ROWS + i, VALUE)
            violation = abs(violation) if index[KIND, i] == EQUALITY else violation
            if violation > largest and violation > small[THRESHOLD, i] * scale:
                best, largest = i, violation
    return best


@kernel
def blocking(small: Floats, index: Integers, size: int) -> tuple[int, float, float]:
    """The position whose multiplier reaches 0 first as a row comes in, or −1, and the step until then; Σ|CHANGE|."""
    total = 1.0
    for k in range(size):
        total += abs(small[CHANGE, k])
    best, step = -1, inf
    for k in range(size):
        if index[KIND, index[ACTIVE, k]] == INEQUALITY and small[CHANGE, k] < -16 * EPS * total:
            ratio = -small[MULTIPLIER, k] / small[CHANGE, k]
            if ratio < step:
                best, step = k, ratio
    return best, step, total


@kernel
def farkas(space: Floats, small: Floats, index: Integers, p: int, size: int, sign: float) -> bool:
    """y = sign·(e_p + CHANGE on the active rows) into THRESHOLD if it proves infeasibility, else False."""
    m, largest = small.shape[1], 1.0
    for i in range(m):
        small[SPARE, i] = 0.0
    small[SPARE, p] = sign
    for k in range(size):
        i = index[ACTIVE, k]
        y = sign * small[CHANGE, k]
        if y > 0.0 or index[KIND, i] == EQUALITY:
            small[SPARE, i] = y
            largest = abs(y) if abs(y) > largest else largest
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
    if not (gain > CONCLUSIVE and sqrt(dot(space, REST, REST)) <= FARKAS_ROUNDING * weight):
        return False
    for i in range(m):
        small[THRESHOLD, i] = small[SPARE, i]
    return True


@kernel
def dual_active_set(space: Floats, small: Floats, index: Integers, attempt: int) -> tuple[int, int, int]:
    """Solves the scaled problem; returns how it ended, the size of the active set, and its changes.

    Leaves d in VALUE and μ, by position in ACTIVE, in MULTIPLIER; at a conflict a Farkas vector, by row, in
    THRESHOLD. attempt: index of ROUNDING; all but the first make every projection in twice the precision, check
    the end once more and may drop what turns out negative.
    """
    m, sharp = small.shape[1], attempt > PLAIN
    size = equality_basis(space, small, index, RANK[attempt])
    for i in range(m):
        small[THRESHOLD, i] = CONCLUSIVE if index[KIND, i] == EQUALITY else ROUNDING[attempt]
        if attempt >= POLISHING and index[KIND, i] == EQUALITY:
            small[THRESHOLD, i] = inf
    # built: rows in Q and R; stale: d and μ were stepped to, not solved for; p: the row that is coming in
    built, stale, p, worst, gained, changes = size, True, -1, -1, 0.0, -1
    while changes < 20 + 10 * m:
        if built == size and p < 0:
            if not (stale and (sharp or changes < 0)):
                p = most_violated(space, small, index)
                gained = 0.0
            if p < 0:
                resume = sharp or changes < 0
                if stale:
                    worst = settle(space, small, index, size, sharp)
                    stale = False
                    if resume:
                        changes += changes < 0
                        continue
                if worst < 0 or not sharp:
                    return SETTLED, size, changes
                size = remove(small, index, worst, size)
                built, stale = worst, True
                changes += 1
                continue
        row = p if built == size else index[ACTIVE, built]
        project(space, small, index, built, STEP, ROWS + row, CHANGE, 0.0, sharp)
        length = sqrt(dot(space, STEP, STEP))
        if built == size:
            changes += 1
            stale = True
            violation = small[BOUND, p] - dot(space, ROWS + p, VALUE)
            k, step, weight = blocking(small, index, size)
            exact = index[KIND, p] == EQUALITY  # one that depends on those in the basis
            nearly = length <= FARKAS_ROUNDING * weight  # a perturbation of the rows by rounding makes it so
            dependent = exact or size >= space.shape[1] or not length > RANK[PLAIN] or (nearly and attempt == LENIENT)
            if exact or (k < 0 and (dependent or nearly)):
                if farkas(space, small, index, p, size, 1.0 if violation > 0.0 else -1.0):
                    return CONFLICT, size, changes
                if dependent:
                    small[THRESHOLD, p] = 2 * abs(violation)
                    p = -1
                    continue
            full = inf if dependent else (violation / (length * length) if violation > 0.0 else 0.0)
            taken = step if step < full else full
            gained += taken
            for j in range(size):
                small[MULTIPLIER, j] += taken * small[CHANGE, j]
                if small[MULTIPLIER, j] < 0.0 and index[KIND, index[ACTIVE, j]] == INEQUALITY:
                    small[MULTIPLIER, j] = 0.0
            if not dependent:
                add(space, VALUE, taken, STEP)
            if step < full:
                size = remove(small, index, k, size)
                built = k
                continue
            small[MULTIPLIER, size] = gained
            size += 1
            p = -1
        append(space, small, index, row, built, length)
        built += 1
    return LIMIT, size, changes
