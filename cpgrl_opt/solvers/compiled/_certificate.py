"""The referee's residuals, as `cpgrl_opt.kkt_residuals` defines them, inside the kernels and for batches."""

from math import inf

import numpy as np
from numba import njit

from ._arithmetic import add, dot, norm
from ._scaling import impossible_zero_row, length_of, scale_problem
from ._workspace import (
    BOUND,
    BY_ROW,
    EPS,
    EQUALITY,
    INEQUALITY,
    KIND,
    LENGTH,
    REST,
    ROWS,
    TARGET,
    TRIANGLE,
    VALUE,
    kernel,
)


@kernel
def larger(a, b):
    """max(a, b), NaN if b is: a comparison with NaN is false."""
    return a if b <= a else b


@kernel
def scaled_residuals(space, small, index):
    """Stationarity, primal, dual, complementarity of VALUE and the multipliers BY_ROW."""
    sigma = max(norm(space, TARGET), norm(space, VALUE))
    if sigma == 0.0:
        sigma = 1.0
    primal, dual, complementarity, total = 0.0, 0.0, 0.0, 0.0
    for j in range(space.shape[1]):
        space[REST, j] = space[VALUE, j] - space[TARGET, j]
    for i in range(small.shape[1]):
        mu = small[BY_ROW, i]
        if index[KIND, i] == INEQUALITY:
            slack = dot(space, ROWS + i, VALUE) - small[BOUND, i]
            primal = larger(primal, -slack)
            dual = larger(dual, -mu)
            complementarity = larger(complementarity, abs(min(mu, slack)))
        elif index[KIND, i] == EQUALITY:
            primal = larger(primal, abs(dot(space, ROWS + i, VALUE) - small[BOUND, i]))
        if mu != 0.0:
            total += abs(mu)
            add(space, REST, -mu, ROWS + i)
    stationarity = larger(0.0, norm(space, REST) - min(8 * EPS * total, 1e-5 * sigma))
    return stationarity / sigma, primal / sigma, dual / sigma, complementarity / sigma


@njit(
    "void(Array(f8, 2, 'C', readonly=True), Array(f8, 3, 'C', readonly=True), Array(f8, 2, 'C', readonly=True),"
    "Array(b1, 2, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 2, 'C', readonly=True),"
    "f8[:, ::1])",
    cache=True,
    error_model="numpy",
)
def certify_batch(gradient, jacobian, bound, equality, value, multipliers, residuals_out):
    """residuals_out (B, 4) = stationarity, primal, dual, complementarity of (d, μ) for each problem as given."""
    count, m, n = jacobian.shape
    space, small, index = np.empty((ROWS + m, n)), np.empty((TRIANGLE, m)), np.empty((3, m), np.int64)
    for k in range(count):
        scale = scale_problem(space, small, index, gradient[k], jacobian[k], bound[k], equality[k])
        own = max(length_of(value[k]), scale)
        for j in range(n):
            space[VALUE, j] = value[k, j] / own
            space[TARGET, j] *= scale / own
        for i in range(m):
            small[BOUND, i] *= scale / own
            small[BY_ROW, i] = multipliers[k, i] * (small[LENGTH, i] / own)
        residuals = scaled_residuals(space, small, index)
        for r in range(4):
            residuals_out[k, r] = residuals[r] if residuals[r] < inf else inf
        if impossible_zero_row(small, bound[k], equality[k]) >= 0:
            residuals_out[k, 1] = inf
