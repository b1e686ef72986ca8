"""The multiple-gradient descent algorithm: the shortest vector of the gradients' convex hull."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Float, Jacobian, Vector
from ..scaling import lengths, unit_rows
from ._dual_cone import nonnegative_least_squares
from .interface import Declaration, TaskMethod

# ‖d‖ that rounding leaves of 0, over Σwᵢ‖gᵢ‖.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True)
class MGDA(TaskMethod):
    """d = argmin {‖ω‖ : ω = Σ wᵢgᵢ, wᵢ ≥ 0, Σ wᵢ = 1}.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ. At the minimum ⟨d, gᵢ⟩ ≥ ‖d‖², equal
    where wᵢ > 0: d climbs for all tasks, or is 0 where no direction does. So J d ≥ 0, but d is in general neither
    near g nor of its length.
    Source: Désidéri 2012, Multiple-gradient descent algorithm, eq. 3, Lemma 2.1 and Theorem 2.2.
    """

    declaration: ClassVar[Declaration] = Declaration(
        "MGDA",
        "argmin ‖ω‖ over the convex hull of g and the rows",
        "Désidéri 2012, eq. 3, Lemma 2.1",
        "none: objective and constraints are tasks alike; d meets J d ≥ 0",
        {
            "check_claims_are_certified": "the shortest vector of the hull is not the vector nearest to g",
            "check_stationarity": "g has the weight w₀ < 1, and rows have weights that are not tight",
            "check_gradient_kept_when_feasible": "the rows pull at g in any case",
            "check_zero_only_when_optimal": "d = 0 where the hull holds 0, though some direction climbs without harm",
            "check_agreement_with_enumeration": "the shortest vector of the hull is not the vector nearest to g",
            "check_non_expansiveness": "the hull turns with g, and its shortest vector may move farther",
            "check_firm_non_expansiveness": "the hull turns with g, and its shortest vector may move farther",
            "check_row_scaling": "the lengths of the rows shape the hull",
            "check_scaling": "only one corner of the hull is scaled with g",
            "check_inactive_row": "every row is a corner of the hull",
        },
    )

    def combine(self, tasks: Jacobian) -> Vector:
        """d."""
        return shortest_of_hull(tasks)[0]


def shortest_of_hull(gradients: Jacobian) -> tuple[Vector, Float[np.ndarray, "k"]]:
    """d and w, (n,) and (k,), of gradients (k, n); d = 0 exactly where only rounding is left of it.

    w = u/Σu, u = argmin_{u ≥ 0} ‖Gᵀu‖² + s²(Σu − 1)²: for u = tw with w on the simplex the least over t is
    s²‖Gᵀw‖²/(s² + ‖Gᵀw‖²), which grows with ‖Gᵀw‖, whatever s > 0. Solved on unit gradients, uᵢ‖gᵢ‖ = ûᵢ s, with s
    the shortest, which is no shorter than d: long gradients beside short ones then cost no digits.
    """
    rows, size = unit_rows(gradients), lengths(gradients)
    shortest = float(size.min())
    if shortest == 0.0:
        return np.zeros(gradients.shape[1]), np.asarray((size == 0.0) / (size == 0.0).sum())
    columns = np.vstack([rows.jacobian.T, shortest / size])
    target = np.append(np.zeros(gradients.shape[1]), 1.0)
    weights = nonnegative_least_squares(columns, target)
    total = float((weights * (shortest / size)).sum())
    value = (weights / total) @ rows.jacobian
    if float(lengths(value)) <= _ROUNDING * float((weights / total).sum()):
        value = np.zeros_like(value)
    return shortest * value, np.asarray(weights / total * (shortest / size))
