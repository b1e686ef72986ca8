"""The projection onto {d : J d ≥ 0} by its dual, a nonnegative least-squares problem in as many unknowns as rows.

    v* = argmin_{v ≥ 0} ½ vᵀJJᵀv + gᵀJᵀv = argmin_{v ≥ 0} ‖Jᵀv + g‖,    d = g + Jᵀv*

{Jᵀv : v ≥ 0} is the cone dual to it, so this is Moreau's decomposition. Solved on unit rows and a g of length 1, which
changes neither d nor which v vanish: v̂ᵢ = vᵢ‖Jᵢ‖. Source: Lawson & Hanson, ch. 23; Lopez-Paz & Ranzato 2017, eq. 11.
"""

import numpy as np

from ..arrays import Jacobian, Multipliers, Vector
from ..problem import DirectionProblem
from ..scaling import lengths, unit_rows
from ..solvers import SOLVERS

# ‖ĝ + Ĵᵀv̂‖ that rounding leaves of a d = 0, over 1 + Σv̂.
_ROUNDING = 1e-14
# Cᵀ(t − Cu) at the optimum, C's columns being of length √2 at most: nnls leaves 1e-14 or so, and 1e-2 where it stops
# early.
_OPTIMALITY = 1e-10


def dual_projection(gradient: Vector, jacobian: Jacobian) -> tuple[Vector, Multipliers]:
    """d and v*; d = 0 exactly where only rounding is left of it. Raises as `dual_weights`."""
    weights = dual_weights(gradient, jacobian)
    value = gradient + weights @ jacobian
    terms = float(lengths(gradient)) + float(lengths(weights[:, None] * jacobian).sum())
    return (value if float(lengths(value)) > _ROUNDING * terms else np.zeros_like(value)), weights


def dual_weights(gradient: Vector, jacobian: Jacobian) -> Multipliers:
    """v*, (m,). Raises RuntimeError where the least-squares problem is not solved within its iterations."""
    size = float(lengths(gradient))
    rows = unit_rows(jacobian)
    on = rows.largest > 0
    weights = np.zeros(len(jacobian))
    if size == 0.0 or not on.any():
        return weights
    weights[on] = nonnegative_least_squares(rows.jacobian[on].T, -(gradient / size))
    return rows.per_length(weights * size)


def nonnegative_least_squares(columns: Jacobian, target: Vector) -> Multipliers:
    """argmin_{u ≥ 0} ‖Cu − t‖, C's columns and t of length 1 or so. Raises RuntimeError beyond nnls' iterations.

    Where scipy's nnls stops early, as it does on some columns that depend (scipy issue 25389), u are the multipliers of
    the projection of −t onto {v : Cᵀv ≥ 0}. Source: Lawson & Hanson, ch. 23; Moreau 1962.
    """
    from scipy.optimize import nnls

    weights: Multipliers = nnls(columns, target, maxiter=30 * columns.shape[1])[0]
    if (columns.T @ (target - columns @ weights) <= _OPTIMALITY).all():
        return weights
    return SOLVERS["active-set"].solve(DirectionProblem(-target, columns.T)).multipliers
