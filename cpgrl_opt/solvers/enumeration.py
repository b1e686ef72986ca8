"""Every active set in turn: slow, simple, and therefore the oracle of the tests.

    for 𝒜 ⊆ {1 … m}, E ⊆ 𝒜:   x = argmin ‖x − c‖ s.t. Aᵢx = bᵢ (i ∈ 𝒜),   Aᵀμ = x − c,   μᵢ = 0 (i ∉ 𝒜)

and the answer is the (x, μ) with the least max(μᵢ < 0, Aᵢx < bᵢ). By Carathéodory's theorem independent 𝒜 suffice.
Source: Nocedal & Wright, Numerical Optimization, §16.5 (the combinatorial view of active sets).
"""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np

from ..arrays import Float, Int
from ..direction import Status
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..scaling import demand
from .base import SmallSolver
from .factorization import pivoted_qr
from .small_problem import SmallAnswer, SmallProblem

MOST_CONSTRAINTS = 12  # 2¹² active sets


@dataclass(frozen=True, kw_only=True)
class Enumeration(SmallSolver):
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

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The (x, μ) of least error over all independent active sets."""
        always = _independent_equalities(small)
        optional = np.flatnonzero(~small.equality)
        best_error, best, tried = np.inf, SmallAnswer(None, None, failure=Status.NUMERICAL_ERROR), 0
        for size in range(min(len(optional), small.rows.shape[1] - len(always)) + 1):
            sets = np.array([[*always, *more] for more in combinations(optional, size)], dtype=np.intp)
            tried += len(sets)
            points, multipliers = _face_projections(small, sets)
            errors = _errors(small, points, multipliers)
            if errors.min(initial=np.inf) < best_error:
                leader = int(errors.argmin())
                best_error, best = float(errors[leader]), SmallAnswer(points[leader], multipliers[leader])
        return replace(best, iterations=tried)


def _independent_equalities(small: SmallProblem) -> Int[np.ndarray, "e"]:
    """Equalities that span the others; if the others contradict them, the error shows it."""
    index = np.flatnonzero(small.equality)
    if len(index) == 0:
        return index
    _, R, order = pivoted_qr(small.rows[index].T, RANK_TOLERANCE)
    return np.asarray(index[np.sort(order[: len(R)])])


def _face_projections(
    small: SmallProblem, sets: Int[np.ndarray, "s a"]
) -> tuple[Float[np.ndarray, "i k"], Float[np.ndarray, "i p"]]:
    """x and μ for the independent ones of many active sets of one size, by one stacked QR."""
    if sets.shape[1] == 0:
        return small.center[None, :].copy(), np.zeros((1, len(small.bound)))
    Q, R = np.linalg.qr(small.rows[sets].swapaxes(1, 2))
    independent = np.abs(np.einsum("sii->si", R)).min(axis=1) > RANK_TOLERANCE
    Q, R, sets = Q[independent], R[independent], sets[independent]
    # Q z + (I − QQᵀ) c with Rᵀz = b keeps the digits that c + Aᵀμ would cancel.
    z = np.linalg.solve(R.swapaxes(1, 2), small.bound[sets][:, :, None])[:, :, 0]
    move = z - np.einsum("ska,k->sa", Q, small.center)
    multipliers = np.zeros((len(sets), len(small.bound)))
    np.put_along_axis(multipliers, sets, np.linalg.solve(R, move[:, :, None])[:, :, 0], axis=1)
    return small.center + np.einsum("ska,sa->sk", Q, move), multipliers


def _errors(
    small: SmallProblem, points: Float[np.ndarray, "s k"], multipliers: Float[np.ndarray, "s p"]
) -> Float[np.ndarray, "s"]:
    """max((b − Ax)₊, (−μ)₊) on I, max |b − Ax| on E, in units of max(1, ‖x‖): one for each active set."""
    lack = demand(small.bound - points @ small.rows.T, small.equality)
    negative = np.where(small.equality, 0.0, -multipliers)
    size = np.maximum(1.0, np.sqrt(np.einsum("sk,sk->s", points, points)))
    return np.asarray(np.maximum(lack, negative).max(axis=1, initial=0.0) / size)
