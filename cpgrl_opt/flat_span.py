"""A problem in an operator's metric, in the few coordinates of its own gradients.

    K = V M⁻¹ Vᵀ = L Lᵀ,   V = [g; J],  U = M⁻¹V:     x = coordinates of d in the span,   d = Uᵀw,  Lᵀw = x

U is found by conjugate gradients and kept, (1 + m, n): nothing else of size n is. K is as exact as they are, so that a
row whose unit length leaves less than 100 tolerances of its square outside the others' span counts as dependent; what
that costs the referee sees, who measures with M itself. One more coordinate holds what a given d has outside the span.
Source: Golub & Van Loan, Matrix Computations, §4.2.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Float, Int, Multipliers, Vector
from .direction import Status
from .metric_operator import OperatorMetric
from .problem import DirectionProblem
from .scaling import UnitRows, unit_rows

# For ‖r‖, of which one digit tells as much as ten.
_LOOSE = 1e-6
# g's part outside the rows' span is needed in its direction only, which U has: rounding of K may name its length.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class SpanFlat:
    """given: the problem; vectors, images: V and U; lengths: √Kᵢᵢ; factor: L of unit vectors; basis: of its columns."""

    given: DirectionProblem
    metric: OperatorMetric
    images: Float[np.ndarray, "channels n"]
    lengths: Float[np.ndarray, "channels"]
    factor: Float[np.ndarray, "channels k"]
    basis: Int[np.ndarray, "k"]
    failure: Status | None

    @classmethod
    def of(cls, problem: DirectionProblem) -> "SpanFlat":
        """By 1 + m solves; rows that are off are 0."""
        metric: OperatorMetric = problem.whitening
        V = np.vstack([problem.gradient, problem.jacobian])
        V[1:][problem.bound == -np.inf] = 0.0
        pairs = [metric.solve(vector) for vector in V]
        U, reached = np.array([x for x, _ in pairs]), all(found for _, found in pairs)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            K = V @ U.T
            K = 0.5 * (K + K.T)
        is_tame = np.isfinite(K).all() and (K.diagonal() >= 0.0).all()
        lengths = np.sqrt(K.diagonal()) if is_tame else np.zeros(len(V))
        is_tame = is_tame and ((lengths > 1e-140) | ~V.any(axis=1)).all() and (lengths < 1e140).all()
        factor, basis = _factor(K, lengths, 100.0 * metric.tolerance) if is_tame else (np.zeros((len(V), 0)), [])
        failure = Status.NUMERICAL_ERROR if not is_tame else None if reached else Status.UNCERTIFIED
        return cls(problem, metric, U, lengths, factor, np.array(basis, np.int64), failure)

    @cached_property
    def problem(self) -> DirectionProblem:
        """Where M = I; its last coordinate is 0 for g and every row."""
        L = np.hstack([self.lengths[:, None] * self.factor, np.zeros((len(self.lengths), 1))])
        return DirectionProblem.trusted(L[0], L[1:], self.given.bound, self.given.equality, self.given.radius)

    @cached_property
    def unit(self) -> UnitRows:
        """Of the problem's rows."""
        return unit_rows(self.problem.jacobian)

    def in_units(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """As they are."""
        return d, mu, kappa

    def proof(self, y: Multipliers) -> Multipliers:
        """As it is."""
        return y

    def inside(self, d: Vector) -> Float[np.ndarray, "k"]:
        """x of d, and the length of what it has outside the span."""
        return self._coordinates(d, self.metric.times(d))

    def outside(self, x: Float[np.ndarray, "k"], mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """d = Uᵀw."""
        return self._weights(x[:-1]) @ self.images, mu, kappa

    def look(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[np.ndarray, np.ndarray, Multipliers]:
        """κMd − g − Jᵀμ and d in coordinates, by M itself, and Jd − b; NaN where M⁻¹ is not reached."""
        problem, Md = self.given, self.metric.times(d)
        force = kappa * Md - problem.gradient - mu @ problem.jacobian
        z, reached = self.metric.solve(force, _LOOSE)
        rest = self._coordinates(z, force) if reached else np.full(len(self.basis) + 1, np.nan)
        return rest, self._coordinates(d, Md), problem.jacobian @ d - problem.bound

    def _coordinates(self, d: Vector, Md: Vector) -> Float[np.ndarray, "k"]:
        """L⁻¹Vd, and √(eᵀMe) of e = d − Uᵀw: dᵀMd − x·x would leave 1e-8 of rounding."""
        products = np.append(self.given.gradient @ d, self.given.jacobian @ d)[self.basis]
        x = np.linalg.solve(self.factor[self.basis], products / self.lengths[self.basis])
        weights = self._weights(x)
        apart = Md - weights[0] * self.given.gradient - weights[1:] @ self.given.jacobian
        return np.append(x, np.sqrt(abs(float((d - weights @ self.images) @ apart))))

    def _weights(self, x: Float[np.ndarray, "k"]) -> Float[np.ndarray, "channels"]:
        weights = np.zeros(len(self.lengths))
        weights[self.basis] = np.linalg.solve(self.factor[self.basis].T, x) / self.lengths[self.basis]
        return weights


def _factor(
    K: Float[np.ndarray, "channels channels"], lengths: Float[np.ndarray, "channels"], cut: float
) -> tuple[Float[np.ndarray, "channels k"], list[int]]:
    """L of the unit vectors, the rows first, the farthest from the others' span first, and then g."""
    unit = np.where(lengths > 0.0, lengths, 1.0)
    left, basis, columns = K / unit / unit[:, None], list[int](), list[np.ndarray]()
    rows = [i for i in range(1, len(lengths)) if lengths[i] > 0.0]
    for candidates, least in ((rows, cut), ([0], _ROUNDING)):
        while candidates:
            pivot = max(candidates, key=lambda i: left[i, i])
            if not left[pivot, pivot] > least:
                break
            column = left[:, pivot] / np.sqrt(left[pivot, pivot])
            column[basis] = 0.0
            left = left - np.outer(column, column)
            columns.append(column)
            basis.append(pivot)
            candidates = [i for i in candidates if i != pivot]
    return np.array(columns).reshape(-1, len(lengths)).T.copy(), basis
