"""The referee's residuals for batches; compiled apart, since only tests and comparisons ask for it."""

from math import inf, ldexp

from numba import njit

from ._certificate import scaled_residuals
from ._scaling import halve, scale_problem
from ._workspace import BOUND, BY_ROW, EXPONENT, IMPOSSIBLE, KIND, TARGET, VALUE, Booleans, Floats, allocate


@njit(
    "void(Array(f8, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 1, 'C', readonly=True),"
    "Array(b1, 1, 'C', readonly=True), Array(f8, 2, 'C', readonly=True), Array(f8, 2, 'C', readonly=True),"
    "f8[:, ::1])",
    cache=True,
    error_model="numpy",
)
def certify_stacked(
    gradient: Floats,
    jacobian: Floats,
    bound: Floats,
    equality: Booleans,
    value: Floats,
    multipliers: Floats,
    residuals_out: Floats,
) -> None:
    """residuals_out (B, 4) = stationarity, primal, dual, complementarity of (d, μ) for each problem as given."""
    count, n = value.shape
    m = multipliers.shape[1]
    space, small, index = allocate(m, n)
    for b in range(count):
        scale = scale_problem(space, small, index, b, gradient, jacobian, bound, equality)
        for j in range(n):
            space[VALUE, j] = value[b, j]
        own, length = halve(space, VALUE)
        own = own if own > scale and length > 0.0 else scale
        for j in range(n):
            space[VALUE, j] = ldexp(value[b, j], -own)
            space[TARGET, j] = ldexp(space[TARGET, j], scale - own)
        for i in range(m):
            small[BOUND, i] = ldexp(small[BOUND, i], scale - own)
            small[BY_ROW, i] = ldexp(multipliers[b, i], index[EXPONENT, i] - own)
        residuals = scaled_residuals(space, small, index, 0.0)
        for r in range(4):
            residuals_out[b, r] = residuals[r] if residuals[r] < inf else inf
        for i in range(m):
            if index[KIND, i] == IMPOSSIBLE:
                residuals_out[b, 1] = inf
