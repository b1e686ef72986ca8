"""Least-distance programming by nonnegative least squares: min ‖z‖ s.t. Gz ≥ h.

    u = argmin_{u ≥ 0} ‖Eu − f‖,  E = [Gᵀ; hᵀ],  f = (0, …, 0, 1),   r = Eu − f,   z = −r₁…ₖ / rₖ₊₁,   μ = −u / rₖ₊₁

Equalities go first, by elimination in an orthonormal basis of their null space.
Source: Lawson & Hanson, Solving Least Squares Problems, ch. 23, algorithms LDP and LSE.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Float
from ..direction import Status
from ..projection import RANK_TOLERANCE
from .small_problem import SmallAnswer, SmallProblem

# ‖z‖ beyond which r loses its digits; h is divided by the size found and the problem solved anew.
_LARGE = 10.0
_RESCALINGS = 4


def least_distance(small: SmallProblem) -> SmallAnswer:
    """x and μ of a small problem by scipy.optimize.nnls; INFEASIBLE (to be proven) where r = 0."""
    elimination = _eliminate(small)
    if not elimination.is_consistent:
        return SmallAnswer(None, None, failure=Status.INFEASIBLE)
    free = ~small.equality
    origin, basis = elimination.point, elimination.basis
    G = small.rows[free] @ basis
    h = small.bound[free] - small.rows[free] @ origin
    length = np.sqrt(np.einsum("ij,ij->i", G, G))
    usable = length > RANK_TOLERANCE
    if (h[~usable] > RANK_TOLERANCE).any():
        return SmallAnswer(None, None, failure=Status.INFEASIBLE)
    solution = _scaled_least_distance(G[usable] / length[usable, None], h[usable] / length[usable])
    if isinstance(solution, Status):
        return SmallAnswer(None, None, failure=solution)
    z, weights = solution
    x = origin + basis @ z
    multipliers = np.zeros(len(small.bound))
    multipliers[np.flatnonzero(free)[usable]] = weights / length[usable]
    multipliers[small.equality] = elimination.multipliers(x - small.center - multipliers @ small.rows)
    return SmallAnswer(x, multipliers)


@dataclass(frozen=True, eq=False)
class _Elimination:
    """{x : A_E x = b_E} = point + span(basis), point nearest to c; basis (k, f) orthonormal."""

    point: Float[np.ndarray, "k"]
    basis: Float[np.ndarray, "k f"]
    pseudo_inverse: Float[np.ndarray, "k e"]
    is_consistent: bool

    def multipliers(self, gap: Float[np.ndarray, "k"]) -> Float[np.ndarray, "e"]:
        """The least-norm λ with A_Eᵀλ nearest to the gap."""
        weights: np.ndarray = gap @ self.pseudo_inverse
        return weights


def _eliminate(small: SmallProblem) -> _Elimination:
    A, b, c = small.rows[small.equality], small.bound[small.equality], small.center
    left, values, right = np.linalg.svd(A, full_matrices=True)
    rank = int((values > RANK_TOLERANCE).sum())
    pseudo_inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    point = c
    for _ in range(3):  # nearly dependent rows cost the first pass half its digits
        point = point + pseudo_inverse @ (b - A @ point)
    error = np.abs(A @ point - b).max(initial=0.0)
    allowed = 1e-12 * max(1.0, float(np.abs(point).max(initial=0.0)))
    return _Elimination(point, right[rank:].T, pseudo_inverse, bool(error <= allowed))


def _scaled_least_distance(
    G: Float[np.ndarray, "p k"], h: Float[np.ndarray, "p"]
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "p"]] | Status:
    """(z, μ) of min ‖z‖ s.t. Gz ≥ h in units that make ‖z‖ about 1."""
    size = 1.0
    for _ in range(_RESCALINGS):
        solution = _least_distance(G, h / size)
        if isinstance(solution, Status):
            if solution == Status.ITERATION_LIMIT:
                return solution
            size *= 1e4  # r = 0 may mean a ‖z‖ that is too large to see
            continue
        z, weights = solution
        length = float(np.sqrt(z @ z))
        if length <= _LARGE:
            return z * size, weights * size
        size *= length
    return solution if isinstance(solution, Status) else (z * size / length, weights * size / length)


def _least_distance(
    G: Float[np.ndarray, "p k"], h: Float[np.ndarray, "p"]
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "p"]] | Status:
    from scipy.optimize import nnls

    count, k = G.shape
    if count == 0:
        return np.zeros(k), np.zeros(0)
    E = np.vstack([G.T, h])
    f = np.zeros(k + 1)
    f[k] = 1.0
    try:
        u, _ = nnls(E, f, maxiter=30 * count)
    except RuntimeError:
        return Status.ITERATION_LIMIT
    r = E @ u - f
    if not -r[k] > 1e-14:
        return Status.INFEASIBLE
    return -r[:k] / r[k], -u / r[k]
