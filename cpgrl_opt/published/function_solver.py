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
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Multipliers, Vector
from ..certify import farkas_residual, proof_tolerance
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import lengths, unit_rows
from ..settings import require_tolerance
from ..solvers import SOLVERS
from ..solvers.facts import DEFAULT_TOLERANCE, tolerance_of
from ..validation import real_values
from ._arguments import bound_argument, name_of


@dataclass(frozen=True, repr=False)
class FunctionSolver:
    """d = function(g, J, b), or function(g, J) for b = 0 only.

    What a function takes or promises it may say in attributes of its own, all of them optional:

        half_space.supports = lambda problem: problem.m == 1  # one row is handed over, never none or several
        half_space.tolerance = 1e-4  # the worst KKT residual that d may have; 1e-6 if it says nothing
        half_space.finds_infeasible = False  # d proves nothing where no direction meets the constraints
        half_space.dtype = "float32"  # it is judged on problems whose numbers are all of this type

    Parameters
    ----------
    function
        g: (n,), ascent gradient; J: (m, n), only the rows that are switched on; b: (m,), J d ≥ b. All are copies. b is
        the argument named b, bound or bounds, else a third one without a default. Returns d, (n,), or None where it
        has no answer.
    tolerance
        In place of the function's own, which it is once constructed, or 1e-6.
    as_equalities
        Whether the function means J d = b; the function's own `as_equalities` counts too.

    Raises
    ------
    ValueError
        If it is not clear that the function takes (g, J, b) or (g, J).
    """

    function: Callable[..., Any]
    tolerance: float | None = None
    as_equalities: bool = False

    def __post_init__(self) -> None:
        _ = self.takes_bounds
        if self.tolerance is None:
            object.__setattr__(self, "tolerance", self._read_attribute("tolerance", DEFAULT_TOLERANCE))
        require_tolerance(self.tolerance)
        object.__setattr__(self, "as_equalities", self.as_equalities or self._read_attribute("as_equalities", False))

    def __repr__(self) -> str:
        return f"FunctionSolver({name_of(self.function)})"

    @cached_property
    def _bound_argument(self) -> int | str | None:
        return bound_argument(self.function)

    @property
    def takes_bounds(self) -> bool:
        """Whether b is handed over."""
        return self._bound_argument is not None

    @property
    def finds_infeasible(self) -> bool:
        """Whether d is meant to violate least, and so to prove it, where nothing meets the constraints."""
        return bool(self._read_attribute("finds_infeasible", True))

    @property
    def dtype(self) -> Any:
        """The precision that the function says it computes in, None if it says nothing."""
        return self._read_attribute("dtype", None)

    def supports(self, problem: DirectionProblem) -> bool:
        """Inequalities only, or equalities only; b = 0 unless the function takes bounds; no metric, no radius.

        And what the function's own `supports` takes, which sees the rows that are handed over.
        """
        if problem.metric is not None or problem.radius is not None:
            return False
        on = problem.bound > -np.inf
        if not (self.takes_bounds or not problem.bound[on].any()):
            return False
        if not (problem.equality[on] == self.as_equalities).all():
            return False
        own = self._read_attribute("supports", None)
        handed_over = (problem.gradient, problem.jacobian[on], problem.bound[on], problem.equality[on])
        return own is None or bool(own(DirectionProblem(*handed_over)))

    def solve(self, problem: DirectionProblem) -> Direction:
        """The function's direction, claimed to be OPTIMAL, or INFEASIBLE where it proves that itself."""
        require_finite(problem)
        if not self.supports(problem):
            return Direction.nothing(problem.n, problem.m, Status.UNSUPPORTED)
        value = self._call(problem)
        if value is None:
            return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
        answer = claimed_direction(problem, value, tolerance_of(self))
        given = np.array(value)
        return replace(answer, value=given) if given.dtype == np.float32 else answer  # the kit asks which it is

    def _call(self, problem: DirectionProblem) -> Any:
        on = problem.bound > -np.inf
        g, J, b = problem.gradient.copy(), problem.jacobian[on], problem.bound[on]
        try:
            if self._bound_argument is None:
                return self.function(g, J)
            if self._bound_argument == 2:
                return self.function(g, J, b)
            return self.function(g, J, **{str(self._bound_argument): b})
        except Exception as error:
            error.add_note(
                f"J has the shape {J.shape}. If the function takes no such problems, let it say so: "
                f"{name_of(self.function)}.supports = lambda problem: …"
            )
            raise

    def _read_attribute(self, name: str, otherwise: Any) -> Any:
        """An attribute of the function, or of what `functools.partial` was made of."""
        function = self.function
        while isinstance(function, partial) and not hasattr(function, name):
            function = function.func
        return getattr(function, name, otherwise)


def claimed_direction(problem: DirectionProblem, value: ArrayLike, tolerance: float) -> Direction:
    """The direction d with the multipliers, and the status, of the module's head.

    Parameters
    ----------
    problem
        What d answers.
    value
        d, (n,), in the unit of g.
    tolerance
        ε, by which a row is tight and a proof is one.

    Returns
    -------
    Direction
        OPTIMAL with μ, (m,), or INFEASIBLE with a Farkas vector.

    Raises
    ------
    ValueError
        Unless d is (n,).
    """
    d = np.array(real_values("the direction", value))
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
