"""A plain function (g, J, b) → d as a direction solver: multipliers found so that the referee can judge it.

A direction d of J d ≥ b is optimal where d − g = Jᵀμ for some μ ≥ 0 that vanishes off the tight rows. Of all such μ
take the one that leaves the least, with Ĵ, b̂ on unit rows and σ = max(‖g‖, ‖d‖):

    𝒜 = {i : Ĵᵢd − b̂ᵢ ≤ εσ, or i ∈ E}        the active set that d claims, with ε the tolerance
    μ = argmin ‖(g − d) + J_𝒜ᵀμ‖,  μᵢ ≥ 0 on 𝒜 ∩ I,  μᵢ = 0 off 𝒜

So dual residual and complementarity are met by construction, and d is optimal to within ε exactly where what is left,
the stationarity, is: no better multipliers are overlooked. By Moreau's decomposition what is left is the projection
of g − d onto {v : J_𝒜v ≥ 0, = 0 on E}: one of our own problems, whose multipliers are μ.

A function cannot say "infeasible", but d can: r = (b̂ − Ĵd)₊ (signed on E) is a Farkas vector where it is that of a
least violation, Ĵᵀr = 0, so d proves by itself that no direction meets the constraints.
Source: Nocedal & Wright, Theorem 12.1; Moreau 1962; Lawson & Hanson, ch. 23; Boyd & Vandenberghe, §5.8.
"""

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Multipliers, Vector
from ..direction import Direction, Status
from ..kkt import farkas_residual, proof_tolerance
from ..problem import DirectionProblem, lengths, unit_rows
from ..solvers import SOLVERS
from ..solvers.interface import DEFAULT_TOLERANCE


@dataclass(frozen=True, repr=False)
class FunctionSolver:
    """d = function(g, J, b), b left out if the function takes two arguments: then b = 0 only.

    g: (n,), ascent gradient; J: (m, n), only the rows that are switched on; b: (m,), J d ≥ b. All are copies. The
    function returns d, (n,), or None where it has no answer. tolerance: the worst KKT residual that d may have.
    as_equalities: the function means J d = b. Raises ValueError for a function that takes neither two nor three.
    """

    function: Callable[..., Any]
    tolerance: float = DEFAULT_TOLERANCE
    as_equalities: bool = False

    def __post_init__(self) -> None:
        _ = self.takes_bounds

    def __repr__(self) -> str:
        return f"FunctionSolver({getattr(self.function, '__qualname__', type(self.function).__name__)})"

    @property
    def takes_bounds(self) -> bool:
        """Whether b is handed over."""
        if not callable(self.function):
            raise ValueError(f"function should be callable; found {self.function!r}")
        for count in (3, 2):
            if _takes(self.function, count):
                return count == 3
        found = f"{self!r} with the arguments {signature(self.function)}"
        raise ValueError(f"function should take (gradient, jacobian, bound) or (gradient, jacobian); found {found}")

    def supports(self, problem: DirectionProblem) -> bool:
        """Inequalities only, or equalities only; b = 0 unless the function takes bounds; no metric, no radius."""
        if problem.metric is not None or problem.radius is not None:
            return False
        on = problem.bound > -np.inf
        unshifted = self.takes_bounds or not problem.bound[on].any()
        return bool(unshifted and (problem.equality[on] == self.as_equalities).all())

    def solve(self, problem: DirectionProblem) -> Direction:
        """The function's direction, claimed to be OPTIMAL, or INFEASIBLE where it proves that itself."""
        if not self.supports(problem):
            return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.UNSUPPORTED)
        require_finite(problem)
        on = problem.bound > -np.inf
        parts = [problem.gradient.copy(), problem.jacobian[on], problem.bound[on]]
        value = self.function(*parts[: 3 if self.takes_bounds else 2])
        if value is None:
            return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.NUMERICAL_ERROR)
        return claimed_direction(problem, value, self.tolerance)


def claimed_direction(problem: DirectionProblem, value: ArrayLike, tolerance: float) -> Direction:
    """The direction d with the multipliers, and the status, of the module's head; ValueError unless d is (n,)."""
    d = np.array(value, dtype=np.float64)
    if d.shape != (problem.n,):
        raise ValueError(f"the direction should have shape ({problem.n},); found {d.shape}")
    if not np.isfinite(d).all():  # for the referee, who rejects it
        return Direction(d, np.zeros(problem.m), Status.OPTIMAL)
    proof = farkas_vector(problem, d, tolerance)
    if proof is not None:
        return Direction(d, proof, Status.INFEASIBLE)
    return Direction(d, best_multipliers(problem, d, tolerance), Status.OPTIMAL)


def best_multipliers(problem: DirectionProblem, d: Vector, tolerance: float) -> Multipliers:
    """μ of the module's head, (m,): those that leave the least of d − g − Jᵀμ."""
    active = problem.equality | (_slack(problem, d) <= tolerance * _size(problem, d))
    multipliers = np.zeros(problem.m)
    if active.any() and not np.array_equal(d, problem.gradient):
        gap = DirectionProblem(problem.gradient - d, problem.jacobian[active], 0.0, problem.equality[active])
        multipliers[active] = _multipliers_of(gap)
    return multipliers


def farkas_vector(problem: DirectionProblem, d: Vector, tolerance: float) -> Multipliers | None:
    """y from the violation of d where it proves that no direction meets the constraints, within √tolerance."""
    slack = _slack(problem, d)
    lack = np.where(problem.equality, -slack, np.maximum(-slack, 0.0))
    if not np.abs(lack).max(initial=0.0) > tolerance * _size(problem, d):
        return None
    if not np.isfinite(lack).all():  # a zero row that asks for more than 0
        return np.where(np.isinf(lack), np.sign(lack), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        y = unit_rows(problem.jacobian).per_length(lack)
    return y if farkas_residual(problem, y) <= proof_tolerance(tolerance) else None


def require_finite(problem: DirectionProblem) -> None:
    """ValueError for NaN and infinities, which only get here past the validation of `DirectionProblem`."""
    for name in ("gradient", "jacobian"):
        if not np.isfinite(getattr(problem, name)).all():
            raise ValueError(f"{name} should be finite; found NaN or infinity")
    if not (problem.bound < np.inf).all():
        raise ValueError("bound should be less than infinity; found NaN or infinity")


def _multipliers_of(problem: DirectionProblem) -> Multipliers:
    """Of the first solver that certifies them; else those that the last one has."""
    for name in ("nnls", "active-set"):
        direction = SOLVERS[name].solve(problem)
        if direction.status == Status.OPTIMAL:
            break
    return direction.multipliers


def _slack(problem: DirectionProblem, d: Vector) -> Multipliers:
    """Ĵd − b̂, (m,)."""
    rows = unit_rows(problem.jacobian)
    return np.asarray(rows.jacobian @ d - rows.per_length(problem.bound))


def _size(problem: DirectionProblem, d: Vector) -> float:
    """σ = max(‖g‖, ‖d‖)."""
    return max(float(lengths(problem.gradient)), float(lengths(d)))


def _takes(function: Callable[..., Any], count: int) -> bool:
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # compiled functions may tell nothing
        return True
    return True
