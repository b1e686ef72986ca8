"""A metric M and the coordinates in which it is Euclidean.

    M = LLᵀ,    d′ = Lᵀd,    g′ = L⁻¹g,    J′ = JL⁻ᵀ:    dᵀMd = ‖d′‖²,    gᵀd = g′ᵀd′,    Jd = J′d′

so a direction problem in the metric M is the Euclidean one of (g′, J′, b), with the same multipliers. Another L with
LLᵀ = M turns these coordinates, and changes no length. A rounded Cholesky factor R misses M by eps·cond(M) of it, so

    L = RC,    CCᵀ = R⁻¹MR⁻ᵀ = I + R⁻¹(M − RRᵀ)R⁻ᵀ,    M − RRᵀ as if in twice the precision

is kept as two factors, and what is left is rounding of d′, g′ and J′, eps·√cond(M).
Source: Golub & Van Loan, Matrix Computations, §4.2; Ozaki et al. 2012 (products split so that their sums are exact).
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from .arrays import Float, Int, Number
from .metric_operator import ITERATIONS, TOLERANCE, OperatorMetric, require_limits
from .validation import ReadOnlyArrays, finite_array, freeze, read_only, real_array, real_values, require_shape

Metric = Float[np.ndarray, "n"] | Float[np.ndarray, "n n"]

# |Mᵢⱼ − Mⱼᵢ| that rounding leaves of a symmetric matrix, relative to √(MᵢᵢMⱼⱼ). A product QΛQᵀ leaves 2e-16, an inverse
# by `numpy.linalg.inv` 1e-14 at cond(M) = 1e3 and 1e-11 at 1e6: with 1e-14 inverses of cond 1e3 would be refused, too,
# and with 1e-10 a matrix that lacks its last digits on one side is taken for what it is not.
_ASYMMETRY = 1e-12
# Least pivot of M with unit diagonal: below it, float64 does not tell M from a singular matrix.
_LEAST_PIVOT = 1e-14
# R⁻¹(M − RRᵀ)R⁻ᵀ below this, entry by entry, is what rounding leaves of any M.
_NEGLIGIBLE = 1e-14


@dataclass(frozen=True, eq=False)
class Whitening(ReadOnlyArrays):
    """L of the module's head: `factor` R, (n,) its diagonal or (n, n) lower triangular; `correction` C, None for I."""

    factor: Metric
    correction: Float[np.ndarray, "n n"] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor", read_only(self.factor))
        if self.correction is not None:
            object.__setattr__(self, "correction", read_only(self.correction))

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__({name: part for name, part in state.items() if name != "balanced"})
        if "balanced" in state:  # whose arrays would come back writeable
            _ = self.balanced

    @cached_property
    def balanced(self) -> tuple[Int[np.ndarray, "n"], "Whitening"]:
        """e with ¼ ≤ 4^eⱼ Mⱼⱼ < 1, about, and the factors of DMD, D = diag(2^eⱼ): units that round nothing."""
        is_vector = self.factor.ndim == 1
        diagonal = self.factor if is_vector else np.sqrt(np.vecdot(self.factor, self.factor))
        exponents = -np.frexp(diagonal)[1].astype(np.int64)
        factor = np.ldexp(self.factor, exponents if is_vector else exponents[:, None])
        return freeze(exponents), Whitening(freeze(factor), self.correction)

    def rows(self, rows: Float[np.ndarray, "*k n"]) -> Float[np.ndarray, "*k n"]:
        """JL⁻ᵀ, and L⁻¹g: gradients, one a row or one alone, in the coordinates where M = I."""
        if self.factor.ndim == 1:
            return np.asarray(rows / self.factor)
        solve, columns = _triangular(), rows.T
        for factor in (self.factor,) if self.correction is None else (self.factor, self.correction):
            columns = solve(factor, columns, lower=True, check_finite=False)
        return np.ascontiguousarray(columns.T)

    def direction(self, direction: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """d′ = Lᵀd."""
        if self.factor.ndim == 1:
            return np.asarray(self.factor * direction)
        whitened = direction @ self.factor
        return np.asarray(whitened if self.correction is None else whitened @ self.correction)

    def original(self, whitened: Float[np.ndarray, "*k n"]) -> Float[np.ndarray, "*k n"]:
        """d = L⁻ᵀd′."""
        if self.factor.ndim == 1:
            return np.asarray(whitened / self.factor)
        solve, columns = _triangular(), whitened.T
        for factor in (self.factor,) if self.correction is None else (self.correction, self.factor):
            columns = solve(factor, columns, lower=True, trans=1, check_finite=False)
        return np.asarray(columns.T)


def check_metric(
    metric: Any, n: int, tolerance: Number = TOLERANCE, iterations: Number = ITERATIONS
) -> tuple[Any, Any]:
    """A read-only copy of M, (n,) positive or (n, n) symmetric positive definite, and its L; else ValueError.

    A matrix that is symmetric up to rounding is replaced by its symmetric part. A callable v ↦ Mv comes back as it is,
    and with it its `OperatorMetric`. tolerance, iterations: of M⁻¹, where M is a function.
    """
    require_limits(tolerance, iterations)
    if isinstance(metric, type) or n == 0:
        raise ValueError(f"metric should be None, (n,), (n, n) or a function v ↦ Mv; found {metric!r}")
    if callable(metric):
        return metric, OperatorMetric(metric, n, tolerance, iterations)
    axes = real_values("metric", metric).ndim
    if axes not in (1, 2):
        raise ValueError(f"metric should be None, (n,), (n, n) or a function v ↦ Mv; found an array of {axes} axes")
    M = finite_array("metric", metric, axes)
    require_shape("metric", M, (n,) * axes)
    diagonal = M if axes == 1 else M.diagonal()
    if not (diagonal > 0).all():
        raise ValueError(f"metric should have positive diagonal entries; found {diagonal.min()}")
    M, whitening = (M, Whitening(np.sqrt(M))) if axes == 1 else _factorize(M)
    _ = whitening.balanced  # once, and not when somebody solves
    return M, whitening


def _factorize(M: Float[np.ndarray, "n n"]) -> tuple[Metric, Whitening]:
    size = np.sqrt(M.diagonal())
    scaled = M / size / size[:, None]  # unit diagonal: units of single parameters decide nothing
    asymmetry = float(np.abs(scaled - scaled.T).max())
    if asymmetry > _ASYMMETRY:
        raise ValueError(
            f"metric should be symmetric; found entries that differ from their mirror image by {asymmetry:.3g} of "
            "√(MᵢᵢMⱼⱼ)"
        )
    symmetric = real_array("metric", M if (M == M.T).all() else 0.5 * M + 0.5 * M.T, 2)
    try:
        factor = np.linalg.cholesky(0.5 * scaled + 0.5 * scaled.T)
        correction = _correction(symmetric, Whitening(factor * size[:, None]))
    except np.linalg.LinAlgError:
        factor, correction = np.zeros_like(scaled), None
    pivot = float(factor.diagonal().min()) ** 2
    if not pivot > _LEAST_PIVOT:
        least = float(np.linalg.eigvalsh(0.5 * scaled + 0.5 * scaled.T)[0])
        raise ValueError(
            f"metric should be positive definite; found the eigenvalue {least:.3g} after scaling its diagonal to 1"
        )
    factor *= size[:, None]
    factor.flags.writeable = False
    return symmetric, Whitening(factor, correction)


def _correction(M: Float[np.ndarray, "n n"], whitening: Whitening) -> Float[np.ndarray, "n n"] | None:
    """C of the module's head; LinAlgError where M is not positive definite, though its rounded factor is."""
    units, inverse = whitening.balanced
    M, R = np.ldexp(M, units + units[:, None]), inverse.factor
    # 26 bits below 1, in rows of length 1: sums of their products are exact in whatever order.
    high = np.ldexp(np.rint(np.ldexp(R, 26)), -26)
    low = R - high
    mixed = high @ low.T
    missed = (M - high @ high.T) - (mixed + mixed.T) - low @ low.T
    relative = inverse.rows(inverse.rows(missed).T)
    if not np.isfinite(relative).all():
        raise np.linalg.LinAlgError
    if np.abs(relative).max() <= _NEGLIGIBLE:
        return None
    correction = np.linalg.cholesky(np.eye(len(M)) + 0.5 * relative + 0.5 * relative.T)
    correction.flags.writeable = False
    return correction


@cache
def _triangular() -> Any:
    from scipy.linalg import solve_triangular  # first use only: importing the package stays light

    return solve_triangular
