"""The referee's residuals, as `cpgrl_opt.kkt_residuals` defines them."""

from math import inf, sqrt

from ._arithmetic import add, dot
from ._workspace import (
    BOUND,
    BY_ROW,
    EPS,
    EQUALITY,
    KIND,
    LENGTH,
    REST,
    ROWS,
    TARGET,
    VALUE,
    Floats,
    Integers,
    kernel,
)


@kernel
def scaled_residuals(space: Floats, small: Floats, index: Integers, margin: float) -> tuple[float, float, float, float]:
    """Stationarity, primal, dual, complementarity of VALUE and the multipliers BY_ROW. NaN where one is met."""
    sigma, own = sqrt(dot(space, TARGET, TARGET)), sqrt(dot(space, VALUE, VALUE))
    sigma = own if not own <= sigma else sigma
    sigma = 1.0 if sigma == 0.0 else sigma
    primal, dual, complementarity, total = 0.0, 0.0, 0.0, 0.0
    for j in range(space.shape[1]):
        space[REST, j] = space[VALUE, j] - space[TARGET, j]
    for i in range(small.shape[1]):
        if small[BOUND, i] == -inf:
            continue
        mu = small[BY_ROW, i] * small[LENGTH, i]
        # "not ≤" lets NaN through, ">" would lose it
        slack = (dot(space, ROWS + i, VALUE) - small[BOUND, i]) / small[LENGTH, i]
        if index[KIND, i] == EQUALITY:
            primal = primal if abs(slack) <= primal else abs(slack)
        else:
            both = abs(mu if mu < slack else slack)
            primal = primal if -slack <= primal else -slack
            dual = dual if -mu <= dual else -mu
            complementarity = complementarity if both <= complementarity else both
        if mu != 0.0:
            total += abs(mu)
            add(space, REST, -small[BY_ROW, i], ROWS + i)
    allowance = 8 * EPS * total if 8 * EPS * total < 1e-5 * sigma else 1e-5 * sigma
    stationarity = sqrt(dot(space, REST, REST)) + margin * total - allowance
    stationarity = 0.0 if stationarity <= 0.0 else stationarity
    return stationarity / sigma, primal / sigma, dual / sigma, complementarity / sigma
