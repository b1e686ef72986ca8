"""The direction that violates infeasible constraints least, and the proof that none satisfies them.

Two projections, both by the dual active set method. With K = {y : Ĵᵀy = 0, y ≥ 0 on I}:

    y = argmin_K ½‖y − b̂‖²   = (b̂ − Ĵd)₊ for every d of least violation
    d = argmin ½‖d − g‖²   s.t.  Ĵd ≥ b̂ − y,  with equality on E and where y > 0

y ≠ 0 exactly if the constraints are infeasible, and it is a Farkas vector: b̂ᵀy = ‖y‖².
Source: the KKT conditions of min ½‖(b̂ − Ĵd)₊‖².
"""

from ._arithmetic import dot, norm
from ._workspace import (
    ACTIVE,
    BOUND,
    BY_ROW,
    EQUALITY,
    INEQUALITY,
    KIND,
    OFF,
    ROWS,
    TARGET,
    VALUE,
    kernel,
)

FAR = -1e3  # rows with bounds below this stay out of y, which they would swamp, until d violates them


@kernel
def pose_residual_problem(space, small, index, dual_space, dual_small, dual_index, included):
    """Writes the problem of y: variables = included rows; n equalities Ĵᵀy = 0, then y ≥ 0. Returns max |b̂|."""
    m, n = small.shape[1], space.shape[1]
    largest = 0.0
    for i in range(m):
        if included[i]:
            largest = max(largest, abs(small[BOUND, i]))
    for i in range(dual_small.shape[1]):
        dual_small[BOUND, i] = 0.0
        for k in range(dual_space.shape[1]):
            dual_space[ROWS + i, k] = 0.0
    k = 0
    for i in range(m):
        if included[i]:
            for j in range(n):
                dual_space[ROWS + j, k] = space[ROWS + i, j]
            dual_space[ROWS + n + k, k] = 1.0
            dual_index[KIND, n + k] = INEQUALITY if index[KIND, i] == INEQUALITY else OFF
            dual_space[TARGET, k] = small[BOUND, i] / largest
            k += 1
    for j in range(n):
        length = norm(dual_space, ROWS + j)
        dual_index[KIND, j] = EQUALITY if length > 0.0 else OFF
        for k in range(dual_space.shape[1]):
            if length > 0.0:
                dual_space[ROWS + j, k] /= length
    return largest


@kernel
def read_residual(small, index, dual_space, dual_index, size, included, largest):
    """BY_ROW = y, 0 where a bound y ≥ 0 is active and on rows left out."""
    n = dual_index.shape[1] - dual_space.shape[1]
    for k in range(size):
        if dual_index[ACTIVE, k] >= n:
            dual_space[VALUE, dual_index[ACTIVE, k] - n] = 0.0
    k = 0
    for i in range(small.shape[1]):
        small[BY_ROW, i] = 0.0
        if included[i]:
            y = dual_space[VALUE, k] * largest
            small[BY_ROW, i] = max(y, 0.0) if index[KIND, i] == INEQUALITY else y
            k += 1


@kernel
def pose_relaxed_problem(space, small, index, near_space, near_small, near_index):
    """Writes the problem of d: the same rows with bounds b̂ − y, equalities where y > 0."""
    for j in range(space.shape[1]):
        near_space[TARGET, j] = space[TARGET, j]
    for i in range(small.shape[1]):
        for j in range(space.shape[1]):
            near_space[ROWS + i, j] = space[ROWS + i, j]
        near_small[BOUND, i] = small[BOUND, i] - small[BY_ROW, i]
        near_index[KIND, i] = index[KIND, i]
        if index[KIND, i] == INEQUALITY and small[BY_ROW, i] > 1e-13:
            near_index[KIND, i] = EQUALITY


@kernel
def include_violated(space, small, index, included):
    """Whether VALUE violates a row left out; such rows are included from now on."""
    missing = False
    scale = max(1.0, norm(space, VALUE))
    for i in range(small.shape[1]):
        if index[KIND, i] == INEQUALITY and not included[i]:
            if small[BOUND, i] - dot(space, ROWS + i, VALUE) > 1e-13 * scale:
                included[i] = True
                missing = True
    return missing


@kernel
def count_included(small, index, included, far):
    """Includes the rows whose bound is above far; returns how many are included."""
    count = 0
    for i in range(small.shape[1]):
        if index[KIND, i] != OFF and small[BOUND, i] > far:
            included[i] = True
        if included[i]:
            count += 1
    return count
