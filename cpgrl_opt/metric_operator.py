"""A metric that is known by what it does to a vector: v ↦ Mv asked of a callable, v ↦ M⁻¹v by conjugate gradients.

Nothing of size n² is formed. M should be symmetric and positive definite: two fixed vectors u, v tell a visible
asymmetry, uᵀMv ≠ vᵀMu, and every vector that is multiplied is looked at, vᵀMv > 0. A problem is solved in the few
coordinates of its own gradients:

    K = V M⁻¹ Vᵀ = L Lᵀ,   V = [g; J],  U = M⁻¹V:     x = coordinates of d in the span,   d = Uᵀw,  Lᵀw = x

U is kept, (1 + m, n): nothing else of size n is. K is as exact as it, so that a row whose unit length leaves less than
100 tolerances of its square outside the others' span counts as dependent; what that costs the referee sees, who
measures with M itself. One more coordinate holds what a given d has outside the span.
Source: Hestenes & Stiefel 1952; Golub & Van Loan, Matrix Computations, §4.2, §11.3.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Bool, Float, Int, Jacobian, Number, Vector
from .direction import Status
from .validation import real_values, require_count, require_number

# Of M⁻¹v, and most products for it. Conjugate gradients reach 1e-14 in float64, and 1e-15 never; a decade more takes a
# tenth of the products. At n = 300 cond(M) = 1e2 takes 136 of them, and cond(M) = 1e4 all of the thousand.
TOLERANCE, ITERATIONS = 1e-12, 1000
# What may be left between uᵀMv and vᵀMu, of ‖u‖‖Mv‖ + ‖v‖‖Mu‖: products in float32 leave 2e-8, whatever n.
_ASYMMETRY = 1e-5
# For ‖r‖, of which one digit tells as much as ten.
_LOOSE = 1e-6
# g's part outside the rows' span is needed in its direction only, which U has: rounding of K may name its length. Below
# it, of g·g = 1, is what rounding leaves of 0: an eps or two for each coordinate.
_ROUNDING = 1e-13


class OperatorMetric:
    """M as a callable; ValueError where it visibly is no metric of n parameters.

    tolerance: ‖Mx − v‖/‖v‖ of x = M⁻¹v; iterations: the most of them for one x.
    """

    def __init__(
        self, product: Callable[[Any], Any], n: int, tolerance: Number = TOLERANCE, iterations: Number = ITERATIONS
    ) -> None:
        require_limits(tolerance, iterations)
        self.product, self.n, self.tolerance, self.iterations = product, n, float(tolerance), int(iterations)
        shape = getattr(product, "shape", (n, n))
        if tuple(shape) != (n, n):
            raise ValueError(f"metric should have shape {(n, n)}; found {tuple(shape)}")
        u, v = np.random.default_rng(0).standard_normal((2, n))
        Mu, Mv = self.times(u), self.times(v)
        if not abs(u @ Mv - v @ Mu) <= _ASYMMETRY * (_norm(u) * _norm(Mv) + _norm(v) * _norm(Mu)):
            raise ValueError(f"metric should be symmetric; found uᵀMv = {u @ Mv:.9g} and vᵀMu = {v @ Mu:.9g}")

    def times(self, vector: Vector) -> Vector:
        """Mv; ValueError for what is no vector of n finite numbers, and where vᵀMv ≤ 0."""
        # Both are copied: what is handed over may be written to, and what comes may be a buffer that is used again.
        try:
            found = np.array(real_values("what metric returns", self.product(vector.copy())))
        except TypeError as error:
            raise ValueError(f"metric should be a function of one vector; found {self.product!r}: {error}") from error
        if found.shape != (self.n,) or not np.isfinite(found).all():
            what = f"shape {found.shape}" if found.shape != (self.n,) else f"{found[~np.isfinite(found)][0]}"
            raise ValueError(f"metric should return {self.n} finite numbers; found {what}")
        curvature = float(vector @ found)
        if not curvature > 0.0 and vector.any() and _norm(vector) > 1e-140:
            raise ValueError(f"metric should be positive definite; found vᵀMv = {curvature:.3g}")
        return found

    def solve(self, vector: Vector, tolerance: float | None = None) -> tuple[Vector, bool]:
        """M⁻¹v, and whether the tolerance was reached within the iterations."""
        from scipy.sparse.linalg import LinearOperator, cg  # first use only: importing the package stays light

        largest = float(np.abs(vector).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(self.n), True
        unit = float(np.ldexp(1.0, int(np.frexp(largest)[1])))
        target = vector / unit
        M = LinearOperator((self.n, self.n), matvec=lambda v: self.times(np.ravel(v)), dtype=np.float64)
        goal = (self.tolerance if tolerance is None else tolerance) * _norm(target)
        x, rest, left = np.zeros(self.n), target, self.iterations
        while left > 0:  # the recurrence of the residual drifts; begun anew it does not
            steps = itertools.count()
            more, _ = cg(M, rest, rtol=0.0, atol=0.5 * goal, maxiter=left, callback=lambda _, s=steps: next(s))
            x, left = x + more, left - max(next(steps), 1)
            rest = target - self.times(x)
            if _norm(rest) <= goal:
                return x * unit, True
        return x * unit, False


@dataclass(frozen=True, eq=False)
class Span:
    """Of g and the rows that are on, where M = I: U, √Kᵢᵢ, L of unit vectors, and the vectors of its columns.

    failure: NUMERICAL_ERROR where a square leaves float64, UNCERTIFIED where a tolerance is not reached.
    """

    metric: OperatorMetric
    gradient: Vector
    jacobian: Jacobian
    images: Float[np.ndarray, "channels n"]
    lengths: Float[np.ndarray, "channels"]
    factor: Float[np.ndarray, "channels k"]
    basis: Int[np.ndarray, "k"]
    failure: Status | None

    @classmethod
    def of(cls, metric: OperatorMetric, g: Vector, J: Jacobian, on: Bool[np.ndarray, "m"]) -> "Span":
        """By 1 + m solves; rows that are off are 0."""
        U, reached, is_some = np.zeros((1 + len(J), len(g))), True, np.append(g.any(), J.any(axis=1) & on)
        for i in np.flatnonzero(is_some):
            U[i], is_found = metric.solve(g if i == 0 else J[i - 1])
            reached = reached and is_found
        with np.errstate(all="ignore"):
            K = np.where(is_some[:, None], np.vstack([U @ g, J @ U.T]), 0.0)
            lengths = np.sqrt(K.diagonal())
            is_tame = np.isfinite(K).all() and ((lengths > 1e-140) | ~is_some).all() and (lengths < 1e140).all()
            unit = np.where(lengths > 0.0, lengths, 1.0)
            factor, basis = _factor(0.5 * (K + K.T) / unit / unit[:, None], 100.0 * metric.tolerance)
        failure = Status.NUMERICAL_ERROR if not is_tame else None if reached else Status.UNCERTIFIED
        return cls(metric, g, J, U, lengths, factor, basis, failure)

    @property
    def rows(self) -> Float[np.ndarray, "channels k"]:
        """g and J in coordinates, the last 0."""
        return np.hstack([self.lengths[:, None] * self.factor, np.zeros((len(self.lengths), 1))])

    def direction(self, d: Vector) -> Float[np.ndarray, "k"]:
        """x of d, and the length of what it has outside the span."""
        return self.coordinates(d, self.metric.times(d))

    def original(self, x: Float[np.ndarray, "k"]) -> Vector:
        """d = Uᵀw."""
        return np.asarray(self._weights(x[:-1]) @ self.images)

    def of_force(self, force: Vector) -> Float[np.ndarray, "k"]:
        """Of M⁻¹ times it; NaN where that is not reached."""
        z, reached = self.metric.solve(force, _LOOSE)
        return self.coordinates(z, force) if reached else np.full(len(self.basis) + 1, np.nan)

    def coordinates(self, d: Vector, Md: Vector) -> Float[np.ndarray, "k"]:
        """L⁻¹Vd, and √(eᵀMe) of e = d − Uᵀw: dᵀMd − x·x would leave 1e-8 of rounding."""
        products = np.append(self.gradient @ d, self.jacobian @ d)[self.basis]
        x = np.linalg.solve(self.factor[self.basis], products / self.lengths[self.basis])
        weights = self._weights(x)
        apart = Md - weights[0] * self.gradient - weights[1:] @ self.jacobian
        return np.append(x, np.sqrt(abs(float((d - weights @ self.images) @ apart))))

    def _weights(self, x: Float[np.ndarray, "k"]) -> Float[np.ndarray, "channels"]:
        weights = np.zeros(len(self.lengths))
        weights[self.basis] = np.linalg.solve(self.factor[self.basis].T, x) / self.lengths[self.basis]
        return weights


def _factor(K: Float[np.ndarray, "channels channels"], cut: float) -> tuple[np.ndarray, np.ndarray]:
    """L of unit vectors, the rows first, the farthest from the others' span first, and then g; and their order."""
    from scipy.linalg.lapack import dpstrf  # first use only

    columns, order, rank, _ = dpstrf(K[1:, 1:], tol=cut, lower=1)
    factor, basis = np.zeros((len(K), rank)), order[:rank].astype(np.int64)
    factor[order] = np.tril(columns)[:, :rank]
    factor[0] = np.linalg.solve(factor[basis], K[0, basis])
    outside = K[0, 0] - factor[0] @ factor[0]
    if not outside > _ROUNDING:
        return factor, basis
    own = np.zeros((len(K), 1))
    own[0] = np.sqrt(outside)
    return np.hstack([factor, own]), np.append(basis, 0)


def require_limits(tolerance: Number, iterations: Number) -> None:
    """ValueError for what is no tolerance or no number of products."""
    require_number("metric_tolerance", tolerance)
    if not 1e-15 <= tolerance <= 1e-3:
        raise ValueError(f"metric_tolerance should be between 1e-15 and 1e-3; found {tolerance!r}")
    require_count("metric_iterations", iterations)


def _norm(vector: Float[np.ndarray, "n"]) -> float:
    return float(np.sqrt(vector @ vector))
