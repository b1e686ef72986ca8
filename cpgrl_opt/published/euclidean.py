"""The coordinates in which a metric is Euclidean, for methods and laws that know no metric."""

import numpy as np

from ..problem import DirectionProblem, without_geometry


def euclidean(problem: DirectionProblem) -> DirectionProblem:
    """The problem of (g′, J′, b) in the coordinates d′ = Lᵀd, where M = I, and without its ball; not checked anew.

    Numbers of 1e±150 in g or J and in M may overflow: see whether it is finite.
    """
    if problem.metric is None and problem.radius is None:
        return problem
    flat = without_geometry(problem)
    if problem.whitening is None:
        return flat
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        g, J = problem.whitening.rows(flat.gradient), problem.whitening.rows(flat.jacobian)
    return DirectionProblem.trusted(g, J, problem.bound, problem.equality)
