"""The projection onto {d : J d ≥ 0} by its dual, a nonnegative least-squares problem in as many unknowns as rows.

    v* = argmin_{v ≥ 0} ½ vᵀJJᵀv + gᵀJᵀv = argmin_{v ≥ 0} ‖Jᵀv + g‖,    d = g + Jᵀv*

{Jᵀv : v ≥ 0} is the cone dual to it, so this is Moreau's decomposition. Solved on unit rows and a g of length 1, which
changes neither d nor which v vanish: v̂ᵢ = vᵢ‖Jᵢ‖. Source: Lawson & Hanson, ch. 23; Lopez-Paz & Ranzato 2017, eq. 11.
"""

import numpy as np

from ..arrays import Jacobian, Multipliers, Vector
from ..problem import lengths, unit_rows

# ‖ĝ + Ĵᵀv̂‖ that rounding leaves of a d = 0, over 1 + Σv̂.
_ROUNDING = 1e-14


def dual_projection(gradient: Vector, jacobian: Jacobian) -> tuple[Vector, Multipliers]:
    """d and v*; d = 0 exactly where only rounding is left of it. Raises as `dual_weights`."""
    weights = dual_weights(gradient, jacobian)
    value = gradient + weights @ jacobian
    terms = float(lengths(gradient)) + float(lengths(weights[:, None] * jacobian).sum())
    return (value if float(lengths(value)) > _ROUNDING * terms else np.zeros_like(value)), weights


def dual_weights(gradient: Vector, jacobian: Jacobian) -> Multipliers:
    """v*, (m,). Raises RuntimeError where the least-squares problem is not solved within its iterations."""
    from scipy.optimize import nnls

    size = float(lengths(gradient))
    rows = unit_rows(jacobian)
    on = rows.largest > 0
    weights = np.zeros(len(jacobian))
    if size == 0.0 or not on.any():
        return weights
    weights[on], _ = nnls(rows.jacobian[on].T, -(gradient / size), maxiter=30 * len(jacobian))
    return rows.per_length(weights * size)
