"""Goldfarb & Idnani's dual active set method for the identity metric, on unit rows.

Starts from the optimum under the equalities alone and takes in the most violated row, lowering the multipliers
of the rows in the way; a row whose multiplier reaches 0 leaves. The dual objective ½‖d − g‖² rises with
every row taken in, so no active set returns; rounding can still make one return, hence the limit.
Source: Goldfarb & Idnani, Mathematical Programming 27 (1983).
"""

from math import inf, sqrt

from . import _workspace as at
from ._arithmetic import add, dot
from ._basis import append, equality_basis, project, remove
from ._entry_point import inlined, kernel
from ._workspace import numbers

# Attempts; the violations, relative to max(1, ‖d‖), that each takes for rounding; and the residual length below which
# a row counts as a combination of others. Copies and rotated copies leave rounding of 1e-15·√n; a row left out is
# violated by at most 1e-13·‖d‖, well inside the promised 1e-12. LENIENT takes rows for dependent, too, that rounding
# of the others could make so; LOOSE is for constraints that hold by a hair; POLISHING, in two grades, for equalities
# that may give.
PLAIN, REFINED, LENIENT, LAST, LOOSE, POLISHING = numbers(6)
ROUNDING = (2e-15, 2e-15, 2e-15, 1e-13, 1e-14, 2e-15, 2e-15)
RANK = (1e-13, 1e-13, 1e-13, 1e-13, 1e-13, 1e-5, 1e-3)

# How the method ends, and how a row comes in: as far as it asks, until another blocks the way, or not at all.
SETTLED, CONFLICT, LIMIT = 0, 1, 2
TAKEN, BLOCKED, LEFT_OUT, REFUTED = numbers(4)
# A Farkas vector y on unit rows, max |y| = 1, proves infeasibility when it gains more than this (in units of the
# scaled problem) at a residual ‖Ĵᵀy‖ of rounding size.
CONCLUSIVE = 1e-10
FARKAS_ROUNDING = 64 * at.EPS


@kernel
def settle(space, small, index, size, sharp):
    """d and μ of the active set from scratch; returns the position of the most negative multiplier, or −1.

    A negative multiplier of rounding size is cut to 0.
    """
    project(space, small, index, size, at.VALUE, at.TARGET, at.MULTIPLIER, 1.0, sharp)
    total = 0.0
    for k in range(size):
        total += abs(small[at.MULTIPLIER, k])
    best, smallest = -1, 0.0
    for k in range(size):
        if index[at.KIND, index[at.ACTIVE, k]] == at.INEQUALITY and small[at.MULTIPLIER, k] < 0.0:
            if small[at.MULTIPLIER, k] > -at.EPS * total:
                small[at.MULTIPLIER, k] = 0.0
            elif small[at.MULTIPLIER, k] < smallest:
                best, smallest = k, small[at.MULTIPLIER, k]
    return best


@kernel
def most_violated(space, small, index):
    """The row outside the active set that d violates most, or −1. A row that is off has bound −inf, or is 0 ≥ 0."""
    scale = sqrt(dot(space, at.VALUE, at.VALUE))
    scale = scale if scale > 1.0 else 1.0
    best, largest = -1, 0.0
    for i in range(small.shape[1]):
        if index[at.USED, i] == 0:
            violation = small[at.BOUND, i] - dot(space, at.ROWS + i, at.VALUE)
            violation = abs(violation) if index[at.KIND, i] == at.EQUALITY else violation
            if violation > largest and violation > small[at.THRESHOLD, i] * scale:
                best, largest = i, violation
    return best


@kernel
def blocking(small, index, size):
    """The position whose multiplier reaches 0 first as a row comes in, or −1, and the step until then; Σ|CHANGE|."""
    total = 1.0
    for k in range(size):
        total += abs(small[at.CHANGE, k])
    best, step = -1, inf
    for k in range(size):
        if index[at.KIND, index[at.ACTIVE, k]] == at.INEQUALITY and small[at.CHANGE, k] < -16 * at.EPS * total:
            ratio = -small[at.MULTIPLIER, k] / small[at.CHANGE, k]
            if ratio < step:
                best, step = k, ratio
    return best, step, total


@kernel
def farkas(space, small, index, p, size, sign):
    """y = sign·(e_p + CHANGE on the active rows) into THRESHOLD if it proves infeasibility, else False."""
    m, largest = small.shape[1], 1.0
    for i in range(m):
        small[at.SPARE, i] = 0.0
    small[at.SPARE, p] = sign
    for k in range(size):
        i, y = index[at.ACTIVE, k], sign * small[at.CHANGE, k]
        if y > 0.0 or index[at.KIND, i] == at.EQUALITY:
            small[at.SPARE, i] = y
            largest = abs(y) if abs(y) > largest else largest
    gain, weight = 0.0, 0.0
    for j in range(space.shape[1]):
        space[at.REST, j] = 0.0
    for i in range(m):
        y = small[at.SPARE, i] / largest
        small[at.SPARE, i] = y
        if y != 0.0:
            gain += y * small[at.BOUND, i]
            weight += abs(y)
            add(space, at.REST, y, at.ROWS + i)
    if not (gain > CONCLUSIVE and sqrt(dot(space, at.REST, at.REST)) <= FARKAS_ROUNDING * weight):
        return False
    for i in range(m):
        small[at.THRESHOLD, i] = small[at.SPARE, i]
    return True


@inlined
def take_in(space, small, index, attempt, p, size, length, gained):
    """Row p comes in: d and μ move until it is met, or the multiplier of another row is 0.

    length: of its part outside the span, STEP. Returns how that ends, the position in the way, and p's multiplier.
    """
    violation = small[at.BOUND, p] - dot(space, at.ROWS + p, at.VALUE)
    k, step, weight = blocking(small, index, size)
    exact = index[at.KIND, p] == at.EQUALITY  # one that depends on those in the basis
    nearly = length <= FARKAS_ROUNDING * weight  # a perturbation of the rows by rounding makes it so
    dependent = exact or size >= space.shape[1] or not length > RANK[PLAIN] or (nearly and attempt == LENIENT)
    if exact or (k < 0 and (dependent or nearly)):
        if farkas(space, small, index, p, size, 1.0 if violation > 0.0 else -1.0):
            return REFUTED, k, gained
        if dependent:
            small[at.THRESHOLD, p] = 2 * abs(violation)
            return LEFT_OUT, k, gained
    full = inf if dependent else (violation / (length * length) if violation > 0.0 else 0.0)
    taken = step if step < full else full
    for j in range(size):
        small[at.MULTIPLIER, j] += taken * small[at.CHANGE, j]
        if small[at.MULTIPLIER, j] < 0.0 and index[at.KIND, index[at.ACTIVE, j]] == at.INEQUALITY:
            small[at.MULTIPLIER, j] = 0.0
    if not dependent:
        add(space, at.VALUE, taken, at.STEP)
    return BLOCKED if step < full else TAKEN, k, gained + taken


@inlined
def begin(space, small, index, attempt):
    """Q and R of the equalities, whose rank it returns; THRESHOLD ← the violations that are rounding."""
    for i in range(small.shape[1]):
        small[at.THRESHOLD, i] = CONCLUSIVE if index[at.KIND, i] == at.EQUALITY else ROUNDING[attempt]
        if attempt >= POLISHING and index[at.KIND, i] == at.EQUALITY:
            small[at.THRESHOLD, i] = inf
    return equality_basis(space, small, index, RANK[attempt])


@kernel
def dual_active_set(space, small, index, attempt):
    """Solves the scaled problem; returns how it ended, the size of the active set, and its changes.

    Leaves d in VALUE and μ, by position in ACTIVE, in MULTIPLIER; at a conflict a Farkas vector, by row, in
    THRESHOLD. attempt: index of ROUNDING; all but the first make every projection in twice the precision, check
    the end once more and may drop what turns out negative.
    """
    size, sharp = begin(space, small, index, attempt), attempt > PLAIN
    # built: rows in Q and R; stale: d and μ were stepped to, not solved for; p: the row that is coming in
    built, stale, p, worst, gained, changes = size, True, -1, -1, 0.0, -1
    while changes < 20 + 10 * small.shape[1]:
        if built == size and p < 0:
            if not (stale and (sharp or changes < 0)):
                p, gained = most_violated(space, small, index), 0.0
            if p < 0:
                resume = stale and (sharp or changes < 0)
                if stale:
                    worst, stale = settle(space, small, index, size, sharp), False
                if resume:
                    changes += changes < 0
                    continue
                if worst < 0 or not sharp:
                    return SETTLED, size, changes
                size, built, stale = remove(small, index, worst, size), worst, True
                changes += 1
                continue
        row = p if built == size else index[at.ACTIVE, built]
        project(space, small, index, built, at.STEP, at.ROWS + row, at.CHANGE, 0.0, sharp)
        length = sqrt(dot(space, at.STEP, at.STEP))
        if built == size:
            changes, stale = changes + 1, True
            end, k, gained = take_in(space, small, index, attempt, p, size, length, gained)
            if end == REFUTED:
                return CONFLICT, size, changes
            if end == LEFT_OUT:
                p = -1
                continue
            if end == BLOCKED:
                size, built = remove(small, index, k, size), k
                continue
            small[at.MULTIPLIER, size] = gained
            size, p = size + 1, -1
        append(space, small, index, row, built, length)
        built += 1
    return LIMIT, size, changes
