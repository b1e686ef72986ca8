"""A metric that is known by what it does to a vector: v ↦ Mv asked of a callable, v ↦ M⁻¹v by conjugate gradients.

Nothing of size n² is formed. M should be symmetric and positive definite: two fixed vectors u, v tell a visible
asymmetry, uᵀMv ≠ vᵀMu, and every vector that is multiplied is looked at, vᵀMv > 0.
Source: Hestenes & Stiefel 1952; Golub & Van Loan, Matrix Computations, §11.3.
"""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from .arrays import Float, Number, Vector
from .validation import real_values, require_count, require_number

TOLERANCE, ITERATIONS = 1e-12, 1000
# What rounding, in single precision too, leaves between uᵀMv and vᵀMu, of ‖u‖‖Mv‖.
_ASYMMETRY = 1e-5


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
        found = np.array(real_values("what metric returns", self.product(vector.copy())))
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


def require_limits(tolerance: Number, iterations: Number) -> None:
    """ValueError for what is no tolerance or no number of products."""
    require_number("metric_tolerance", tolerance)
    if not 1e-15 <= tolerance <= 1e-3:
        raise ValueError(f"metric_tolerance should be between 1e-15 and 1e-3; found {tolerance!r}")
    require_count("metric_iterations", iterations)


def _norm(vector: Float[np.ndarray, "n"]) -> float:
    return float(np.sqrt(vector @ vector))
