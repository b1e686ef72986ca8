"""The usual long problem in few calls: μ from the Gramian, one pass that combines the vectors, and its judgement.

What is usual: the gates of rung "gramian" are open, the direct pass finds the active set, and the certificate is within
1e-12. All else is for `span`. Both see the same Gramian and take the same gates.
"""

from typing import Any

import numpy as np

from ..direction import Direction, KKTResiduals, Status
from ..problem import DirectionProblem
from ..reduction import EXACT, GATES, OUT_OF_SPAN
from ..vectors import REPRESENTABLE
from .compiled._gramian_core import judge, weigh


def solve_by_gramian(problem: DirectionProblem, vectors: Any, tolerance: float) -> Direction | None:
    """The certified direction; None where the problem is not usual. M = I, no radius."""
    K, m = vectors.gramian(), len(problem.bound)
    work, index, weights = np.empty((8 + 2 * m, m)), np.empty((2, m), np.int64), np.empty(1 + m)
    changes = weigh.run(K, problem.bound, problem.equality, *GATES, work, index, weights)
    if changes < 0:
        return None
    value, sums = vectors.combine_usually(weights)
    parts = judge.run(K, problem.equality, OUT_OF_SPAN, work, index, sums)
    if not max(parts) <= min(tolerance, EXACT) or (problem.is_tree and not sums[-1] <= REPRESENTABLE):
        return None
    residuals = tuple.__new__(KKTResiduals, parts)  # as in `exact_core`
    return Direction.make(value, weights[1:], Status.OPTIMAL, changes, residuals, "gramian")
