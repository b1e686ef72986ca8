"""Every active set in turn: slow, simple, and therefore the oracle of the tests.

    for 𝒜 ⊆ {1 … m}, E ⊆ 𝒜:   x = argmin ‖x − c‖ s.t. Aᵢx = bᵢ (i ∈ 𝒜),   Aᵀμ = x − c,   μᵢ = 0 (i ∉ 𝒜)

and the answer is the (x, μ) with the least max(μᵢ < 0, Aᵢx < bᵢ). By Carathéodory's theorem independent 𝒜 suffice.
Source: Nocedal & Wright, Numerical Optimization, §16.5 (the combinatorial view of active sets).
"""

from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from ..arrays import Float, Int
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..settings import CheckedSettings
from .factorization import pivoted_qr
from .geometry import takes_geometry
from .interface import LoopsOverBatches
from .preparation import failure, solve_prepared
from .reduction import BackEndAnswer, ReducedProblem

MOST_CONSTRAINTS = 12  # 2¹² active sets


@takes_geometry
@dataclass(frozen=True, kw_only=True)
class Enumeration(LoopsOverBatches, CheckedSettings):
    """The best of all 2ᵐ active sets, for problems of at most 12 constraints.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    """

    tolerance: float = 1e-9
    polish: bool = True

    package: ClassVar[str] = "numpy"
    source: ClassVar[str] = "Nocedal & Wright 2006, §16.5"
    guarantee: ClassVar[str] = "exact: every active set is tried; m ≤ 12"

    def supports(self, problem: DirectionProblem) -> bool:
        """At most 12 constraints."""
        return problem.m <= MOST_CONSTRAINTS

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; see `Status`."""
        if not self.supports(problem):
            return failure(problem, Status.UNSUPPORTED)
        return solve_prepared(problem, enumerate_active_sets, tolerance=self.tolerance, polish=self.polish)


def enumerate_active_sets(reduced: ReducedProblem) -> BackEndAnswer:
    """The (x, μ) of least error over all independent active sets."""
    always = _independent_equalities(reduced)
    optional = np.flatnonzero(~reduced.equality)
    best_error, best, tried = np.inf, BackEndAnswer(None, None, failure=Status.NUMERICAL_ERROR), 0
    for size in range(min(len(optional), reduced.rows.shape[1] - len(always)) + 1):
        sets = np.array([[*always, *more] for more in combinations(optional, size)], dtype=np.intp)
        tried += len(sets)
        points, multipliers = _face_projections(reduced, sets)
        errors = _errors(reduced, points, multipliers)
        leader = int(errors.argmin()) if len(errors) else 0
        if len(errors) and errors[leader] < best_error:
            best_error = float(errors[leader])
            best = BackEndAnswer(points[leader], multipliers[leader])
    return BackEndAnswer(best.point, best.multipliers, tried, best.failure)


def _independent_equalities(reduced: ReducedProblem) -> Int[np.ndarray, "e"]:
    """Equalities that span the others; if the others contradict them, the error shows it."""
    index = np.flatnonzero(reduced.equality)
    if len(index) == 0:
        return index
    _, R, order = pivoted_qr(reduced.rows[index].T, RANK_TOLERANCE)
    spanning: np.ndarray = index[np.sort(order[: len(R)])]
    return spanning


def _face_projections(
    reduced: ReducedProblem, sets: Int[np.ndarray, "s a"]
) -> tuple[Float[np.ndarray, "i k"], Float[np.ndarray, "i p"]]:
    """x and μ for the independent ones of many active sets of one size, by one stacked QR."""
    if sets.shape[1] == 0:
        return reduced.center[None, :].copy(), np.zeros((1, len(reduced.bound)))
    Q, R = np.linalg.qr(reduced.rows[sets].swapaxes(1, 2))
    independent = np.abs(np.einsum("sii->si", R)).min(axis=1) > RANK_TOLERANCE
    Q, R, sets = Q[independent], R[independent], sets[independent]
    # Q z + (I − QQᵀ) c with Rᵀz = b keeps the digits that c + Aᵀμ would cancel.
    z = np.linalg.solve(R.swapaxes(1, 2), reduced.bound[sets][:, :, None])[:, :, 0]
    move = z - np.einsum("ska,k->sa", Q, reduced.center)
    multipliers = np.zeros((len(sets), len(reduced.bound)))
    np.put_along_axis(multipliers, sets, np.linalg.solve(R, move[:, :, None])[:, :, 0], axis=1)
    return reduced.center + np.einsum("ska,sa->sk", Q, move), multipliers


def _errors(
    reduced: ReducedProblem, points: Float[np.ndarray, "s k"], multipliers: Float[np.ndarray, "s p"]
) -> Float[np.ndarray, "s"]:
    """max((b − Ax)₊, (−μ)₊) on I, max |b − Ax| on E, in units of max(1, ‖x‖): one for each active set."""
    lack = reduced.bound - points @ reduced.rows.T
    lack = np.where(reduced.equality, np.abs(lack), lack)
    negative = np.where(reduced.equality, 0.0, -multipliers)
    size = np.maximum(1.0, np.sqrt(np.einsum("sk,sk->s", points, points)))
    errors: np.ndarray = np.maximum(lack, negative).max(axis=1, initial=0.0) / size
    return errors
