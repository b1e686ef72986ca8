"""The multiple-gradient descent algorithm: the shortest vector of the gradients' convex hull."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..arrays import Jacobian
from ..direction import Direction
from ..problem import DirectionProblem, lengths
from .adapter import claimed_direction
from .interface import Declaration, is_cone, stacked_gradients, unsupported


@dataclass(frozen=True, kw_only=True)
class MGDA:
    """d = argmin {‖ω‖ : ω = Σ wᵢgᵢ, wᵢ ≥ 0, Σ wᵢ = 1}.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ. At the minimum ⟨d, gᵢ⟩ ≥ ‖d‖², equal
    where wᵢ > 0: d climbs for all tasks, or is 0 where no direction does. So J d ≥ 0, but d is in general neither
    near g nor of its length. tolerance: what the kit holds it to.
    Source: Désidéri 2012, Multiple-gradient descent algorithm, eq. 3, Lemma 2.1 and Theorem 2.2.
    """

    tolerance: float = 1e-6

    declaration: ClassVar[Declaration] = Declaration(
        "MGDA",
        "argmin ‖ω‖ over the convex hull of g and the rows",
        "Désidéri 2012, eq. 3, Lemma 2.1",
        "none: objective and constraints are tasks alike; d meets J d ≥ 0",
    )

    def supports(self, problem: DirectionProblem) -> bool:
        """J d ≥ 0."""
        return is_cone(problem)

    def solve(self, problem: DirectionProblem) -> Direction:
        """d, claimed to be OPTIMAL."""
        if not self.supports(problem):
            return unsupported(problem)
        tasks = stacked_gradients(problem)
        return claimed_direction(problem, hull_weights(tasks) @ tasks, self.tolerance)


def hull_weights(gradients: Jacobian) -> Float[np.ndarray, "m"]:
    """w of the shortest vector of the hull; (k, n) → (k,).

    w = u/Σu, u = argmin_{u ≥ 0} ‖Gᵀu‖² + s²(Σu − 1)²: for u = tw with w on the simplex the least over t is
    s²‖Gᵀw‖²/(s² + ‖Gᵀw‖²), which grows with ‖Gᵀw‖, whatever s > 0. s: the longest gradient.
    """
    from scipy.optimize import nnls

    longest = float(lengths(gradients).max())
    if longest == 0.0:
        return np.full(len(gradients), 1.0 / len(gradients))
    columns = np.vstack([gradients.T / longest, np.ones(len(gradients))])
    target = np.append(np.zeros(gradients.shape[1]), 1.0)
    weights, _ = nnls(columns, target, maxiter=30 * len(gradients))
    return np.asarray(weights / weights.sum())
