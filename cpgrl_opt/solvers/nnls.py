"""Least-distance programming by nonnegative least squares: an exact method independent of the default solver's.

    min ‖z‖  s.t.  Gz ≥ h:
    u = argmin_{u ≥ 0} ‖Eu − f‖,  E = [Gᵀ; hᵀ],  f = (0, …, 0, 1),   r = Eu − f,   z = −r₁…ₖ / rₖ₊₁,   μ = −u / rₖ₊₁

Equalities go first, by elimination in an orthonormal basis of their null space.
Source: Lawson & Hanson, Solving Least Squares Problems, ch. 23, algorithms LDP and LSE.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Float
from ..direction import Status
from ..projection import RANK_TOLERANCE
from .base import SmallSolver
from .small_problem import SmallAnswer, SmallProblem

# ‖z‖ beyond which r loses its digits; h is divided by the size found and the problem solved anew.
_LARGE = 10.0
_RESCALINGS = 4  # units of 1, 1e4, 1e8 and 1e12 are tried
_Found = tuple[np.ndarray, np.ndarray]  # z, μ
_EMPTY = SmallAnswer(None, None, failure=Status.INFEASIBLE)  # to be proven


@dataclass(frozen=True, kw_only=True)
class NNLS(SmallSolver):
    """min ½‖d − g‖² s.t. Jd ≥ b as a nonnegative least-squares problem in m unknowns; equalities by elimination.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    """

    tolerance: float = 1e-9
    polish: bool = True

    package: ClassVar[str] = "scipy"
    source: ClassVar[str] = "Lawson & Hanson 1974, ch. 23 (LDP)"
    guarantee: ClassVar[str] = "finite active-set method (scipy), certified or UNCERTIFIED"

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """x and μ by scipy's NNLS."""
        return least_distance(small)


def least_distance(small: SmallProblem) -> SmallAnswer:
    """x and μ of a small problem by scipy.optimize.nnls; INFEASIBLE (to be proven) where r = 0."""
    eliminated = _eliminate(small)
    if eliminated is None:
        return _EMPTY
    origin, basis, pseudo_inverse = eliminated
    free = ~small.equality
    G = small.rows[free] @ basis
    h = small.bound[free] - small.rows[free] @ origin
    length = np.sqrt(np.einsum("ij,ij->i", G, G))
    usable = length > RANK_TOLERANCE
    if (h[~usable] > RANK_TOLERANCE).any():
        return _EMPTY
    found = _solve_scaled(G[usable] / length[usable, None], h[usable] / length[usable])
    if isinstance(found, Status):
        return SmallAnswer(None, None, failure=found)
    z, weights = found
    x, multipliers = origin + basis @ z, np.zeros(len(small.bound))
    multipliers[np.flatnonzero(free)[usable]] = weights / length[usable]
    # The λ of least norm with A_Eᵀλ nearest to what is left.
    multipliers[small.equality] = (x - small.center - multipliers @ small.rows) @ pseudo_inverse
    return SmallAnswer(x, multipliers)


def _eliminate(small: SmallProblem) -> tuple[np.ndarray, Float[np.ndarray, "k f"], Float[np.ndarray, "k e"]] | None:
    """{x : A_E x = b_E} as its point nearest to c and an orthonormal basis, and A_E⁺; None where nothing meets them."""
    A, b, c = small.rows[small.equality], small.bound[small.equality], small.center
    left, values, right = np.linalg.svd(A, full_matrices=True)
    rank = int((values > RANK_TOLERANCE).sum())
    pseudo_inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    point = c
    for _ in range(3):  # nearly dependent rows cost the first pass half its digits
        point = point + pseudo_inverse @ (b - A @ point)
    error = np.abs(A @ point - b).max(initial=0.0)
    allowed = 1e-12 * max(1.0, float(np.abs(point).max(initial=0.0)))
    return (point, right[rank:].T, pseudo_inverse) if error <= allowed else None


def _solve_scaled(G: Float[np.ndarray, "p k"], h: Float[np.ndarray, "p"]) -> _Found | Status:
    """z and μ of min ‖z‖ s.t. Gz ≥ h, in units that make ‖z‖ about 1."""
    size = 1.0
    for _ in range(_RESCALINGS):
        unit, found = size, _solve(G, h / size)
        if found == Status.ITERATION_LIMIT:
            break
        if isinstance(found, Status):
            size *= 1e4  # r = 0 may mean a ‖z‖ that is too large to see
            continue
        length = float(np.sqrt(found[0] @ found[0]))
        if length <= _LARGE:
            break
        size *= length
    return found if isinstance(found, Status) else (found[0] * unit, found[1] * unit)


def _solve(G: Float[np.ndarray, "p k"], h: Float[np.ndarray, "p"]) -> _Found | Status:
    from scipy.optimize import nnls

    count, k = G.shape
    if count == 0:
        return np.zeros(k), np.zeros(0)
    E, f = np.vstack([G.T, h]), np.append(np.zeros(k), 1.0)
    try:
        u, _ = nnls(E, f, maxiter=30 * count)
    except RuntimeError:
        return Status.ITERATION_LIMIT
    r = E @ u - f
    return (-r[:k] / r[k], -u / r[k]) if -r[k] > 1e-14 else Status.INFEASIBLE
