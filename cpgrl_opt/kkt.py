"""The referee: optimality residuals from the problem's data, whatever a back end reports.

With unit rows Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, μ̂ᵢ = μᵢ‖Jᵢ‖ and σ = max(‖g‖, ‖d‖):

    primal           max (b̂ᵢ − Ĵᵢd)₊ / σ  on I,   max |b̂ᵢ − Ĵᵢd| / σ  on E
    dual             max (−μ̂ᵢ)₊ / σ  on I
    complementarity  max |min(μ̂ᵢ, Ĵᵢd − b̂ᵢ)| / σ  on I
    stationarity     (‖d − g − Jᵀμ‖ − min(8·eps·Σ|μ̂ᵢ|, 1e-5·σ))₊ / σ

Nocedal & Wright, Numerical Optimization, Theorem 12.1; here they are sufficient, the problem being strictly convex.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .arrays import Mask, Multipliers, Vector
from .problem import DirectionProblem, lengths, unit_rows
from .validation import require_shape

_EPS = float(np.finfo(np.float64).eps)


@runtime_checkable
class HasValueAndMultipliers(Protocol):
    """All that the referee reads of an answer."""

    @property
    def value(self) -> Any:
        """d, (n,)."""

    @property
    def multipliers(self) -> Any:
        """μ, (m,)."""


@dataclass(frozen=True)
class KKTResiduals:
    """Four relative residuals, each 0 at an exact optimum; infinite where an answer is not finite."""

    stationarity: float
    primal: float
    dual: float
    complementarity: float

    @property
    def worst(self) -> float:
        """The largest of the four."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


def kkt_residuals(problem: DirectionProblem, direction: HasValueAndMultipliers) -> KKTResiduals:
    """Residuals of (d, μ) = (direction.value, direction.multipliers) as the module's head defines them.

    Free of the scale of g, of J and of each row. Raises ValueError when value or multipliers have a wrong shape.
    """
    d, mu = np.asarray(direction.value, dtype=np.float64), np.asarray(direction.multipliers, dtype=np.float64)
    require_shape("direction.value", d, (problem.n,))
    require_shape("direction.multipliers", mu, (problem.m,))
    if not (np.isfinite(d).all() and np.isfinite(mu).all()):
        return KKTResiduals(np.inf, np.inf, np.inf, np.inf)
    # The largest entry first: σ itself may overflow.
    unit = max(_largest(np.abs(problem.gradient)), _largest(np.abs(d)))
    rows = unit_rows(problem.jacobian)
    bound = rows.per_length(problem.bound)
    if unit == 0.0:  # g = d = 0: nothing to be relative to
        violated = np.where(problem.equality, bound != 0, bound > 0).any()
        return KKTResiduals(0.0, np.inf if violated else 0.0, 0.0, 0.0)
    with np.errstate(over="ignore"):
        bound, mu = bound / unit, rows.times_length(mu, unit)
    if not np.isfinite(mu).all():  # overflows in units of σ
        return KKTResiduals(np.inf, np.inf, np.inf, np.inf)
    return _relative_residuals(problem, rows.jacobian, (bound, mu), (d / unit, problem.gradient / unit))


def _relative_residuals(
    problem: DirectionProblem,
    jacobian: np.ndarray,
    bound_and_multipliers: tuple[Multipliers, Multipliers],
    d_and_gradient: tuple[Vector, Vector],
) -> KKTResiduals:
    sigma = max(_norm(each) for each in d_and_gradient)
    d, g = (each / sigma for each in d_and_gradient)
    bound, mu = (each / sigma for each in bound_and_multipliers)
    slack = jacobian @ d - bound
    inequality = ~problem.equality
    allowance = min(8 * _EPS * float(np.abs(mu).sum()), 1e-5)
    return KKTResiduals(
        stationarity=max(_norm(d - g - mu @ jacobian) - allowance, 0.0),
        primal=_largest(np.where(inequality, np.maximum(-slack, 0.0), np.abs(slack))),
        dual=_largest(np.maximum(-mu[inequality], 0.0)),
        complementarity=_largest(np.abs(np.minimum(mu, slack))[inequality]),
    )


def farkas_residual(problem: DirectionProblem, y: Multipliers) -> float:
    """How far y is from proving infeasibility: max(‖Ĵᵀŷ‖, max(−ŷ)₊ on I) / (b̂ᵀŷ / max|b̂|); infinite if b̂ᵀŷ ≤ 0.

    With y ≥ 0 on I, Jᵀy = 0 and bᵀy > 0 no d has Jd ≥ b: 0 = yᵀJd ≥ bᵀy > 0. Zero where y proves it exactly.
    Source: Farkas' lemma; Boyd & Vandenberghe, Convex Optimization, §5.8.
    """
    y = np.asarray(y, dtype=np.float64)
    require_shape("y", y, (problem.m,))
    if not np.isfinite(y).all() or not y.any():
        return float("inf")
    rows = unit_rows(problem.jacobian)
    zero_row_proof = (rows.largest == 0) & (y != 0) & _zero_row_impossible(problem, y)
    if zero_row_proof.any():
        return float("inf") if (y[~problem.equality] < 0).any() else 0.0
    weights = rows.times_length(y / np.abs(y).max(), float(rows.largest.max()) or 1.0)
    if not weights.any():  # y ≠ 0 on zero rows only, which ask for nothing impossible
        return float("inf")
    weights = weights / np.abs(weights).max()
    switched_on = (problem.bound > -np.inf) & (rows.largest > 0)
    bound = np.where(switched_on, rows.per_length(problem.bound), 0.0)
    if (weights[~switched_on] != 0).any():
        return float("inf")
    largest = float(np.abs(bound[weights != 0]).max())
    gain = float((bound / largest) @ weights) if largest > 0 else 0.0
    error = max(_norm(weights @ rows.jacobian), _largest(np.maximum(-weights[~problem.equality], 0.0)))
    return error / gain if gain > 0 else float("inf")


def _zero_row_impossible(problem: DirectionProblem, y: Multipliers) -> Mask:
    return np.where(problem.equality, np.sign(problem.bound) * y > 0, problem.bound > 0)


def _norm(vector: np.ndarray) -> float:
    return float(lengths(vector))


def _largest(values: np.ndarray) -> float:
    return float(values.max(initial=0.0))
