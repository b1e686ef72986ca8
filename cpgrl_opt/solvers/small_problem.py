"""The small problem that every core sees: unit rows, numbers about 1, at most m + 1 coordinates.

With Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖ and s = max(‖g‖, (b̂ᵢ)₊ on I, |b̂ᵢ| on E) the problem is s times

    min ½‖d − g/s‖²   s.t.   Ĵᵢd ≥ b̂ᵢ/s (i ∈ I),   Ĵᵢd = b̂ᵢ/s (i ∈ E)

and both g and every row live in the columns of Q from [Ĵᵀ g/s] = Q R (pivoted, cut at its numerical rank), so that
d = g/s + Q (x − Qᵀg/s) with x the solution in coordinates. No Gram matrix is formed: it would square the angle
between rows. Source: Golub & Van Loan, Matrix Computations, §5.4.2 (rank-revealing QR).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bool, Float, Mask, Multipliers
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import UnitRows, demand, lengths, unit_rows
from .factorization import pivoted_qr

# Directions that carry less than this of the unit rows are rounding: duplicate rows stay exactly dependent.
COORDINATE_TOLERANCE = 1e-13
# A row whose bound is below −2 (in units of s) cannot bind when all bounds are ≤ 0, since then ‖d‖ ≤ ‖g‖ ≤ s.
NEGLIGIBLE_BOUND = -2.0


@dataclass(frozen=True, eq=False)
class SmallProblem:
    """min ½‖x − c‖² s.t. Aᵢx ≥ bᵢ, Aᵢx = bᵢ where `equality`; all that a core sees.

    center c: (k,), k ≤ min(n, m + 1); rows A: (p, k) of length 1; bound b: (p,); equality: (p,); lengths: (p,), the
    rows' before they were unit rows, for methods that look at raw multipliers; None: all the same.
    """

    center: Float[np.ndarray, "k"]
    rows: Float[np.ndarray, "p k"]
    bound: Float[np.ndarray, "p"]
    equality: Bool[np.ndarray, "p"]
    lengths: Float[np.ndarray, "p"] | None = None

    def restrict(self, rows: Bool[np.ndarray, "p"]) -> "SmallProblem":
        """The same problem on some of its rows."""
        row_lengths = None if self.lengths is None else self.lengths[rows]
        return SmallProblem(self.center, self.rows[rows], self.bound[rows], self.equality[rows], row_lengths)


@dataclass(frozen=True, eq=False)
class SmallAnswer:
    """What a core says: x (k,), μ (p,) ≥ 0 on inequalities, iterations; `failure` is its own raw verdict.

    INFEASIBLE as failure is a claim that is checked; point and multipliers are None where it has none.
    """

    point: Float[np.ndarray, "k"] | None
    multipliers: Float[np.ndarray, "p"] | None
    iterations: int = 0
    failure: Status | None = None

    @property
    def is_usable(self) -> bool:
        """Whether there is a point with multipliers, all finite."""
        if self.point is None or self.multipliers is None:
            return False
        return bool(np.isfinite(self.point).all() and np.isfinite(self.multipliers).all())


Core = Callable[[SmallProblem], SmallAnswer]


def as_problem(small: SmallProblem) -> DirectionProblem:
    """The small problem as any other."""
    rows, bound = np.ascontiguousarray(small.rows), np.ascontiguousarray(small.bound)
    return DirectionProblem.trusted(np.ascontiguousarray(small.center), rows, bound, small.equality)


def as_small(answer: Direction) -> SmallAnswer:
    """What a solver says of a small problem, as a core says it."""
    failure = None if answer.status == Status.OPTIMAL else answer.status
    if failure in (Status.INFEASIBLE, Status.NUMERICAL_ERROR, Status.UNSUPPORTED):
        return SmallAnswer(None, None, answer.iterations, failure)
    return SmallAnswer(answer.value, answer.multipliers, answer.iterations, failure)


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """A direction problem in units of `scale`, on those of its rows that are switched on and not zero.

    small: these rows, in all n coordinates; kept: (m,) which rows these are; scale: s, in units of the gradient; 0
    where g and all demands vanish, not finite where they are not; impossible: (m,) zero rows that ask for what no
    direction gives.
    """

    problem: DirectionProblem
    small: SmallProblem
    kept: Mask
    impossible: Mask
    scale: float
    unit: UnitRows

    def rescale(self, factor: float) -> "ScaledProblem":
        """The same problem in units `factor` times as large."""
        small = replace(self.small, center=self.small.center / factor, bound=self.small.bound / factor)
        return replace(self, small=small, scale=self.scale * factor)

    def original_multipliers(self, multipliers: Float[np.ndarray, "p"]) -> Multipliers:
        """μᵢ = μ̂ᵢ s / ‖Jᵢ‖ on the kept rows, 0 elsewhere; (m,). The quotient first, so that 1e±170 passes."""
        answer = np.zeros(self.problem.m)
        answer[self.kept] = multipliers
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return np.where(answer == 0.0, 0.0, answer * self.unit.per_length(np.full(len(answer), self.scale)))


def scale_problem(problem: DirectionProblem) -> ScaledProblem:
    """The problem, of finite numbers, in its own units."""
    unit = unit_rows(problem.jacobian)
    bound = unit.per_length(problem.bound)
    is_zero = unit.largest == 0.0
    impossible = is_zero & (demand(bound, problem.equality) > 0.0)
    kept = ~is_zero & (problem.equality | (bound > -np.inf))
    equality, bound = problem.equality[kept], bound[kept]
    scale = max(float(lengths(problem.gradient)), float(demand(bound, equality).max(initial=0.0)))
    row_lengths = unit.largest[kept] * unit.relative[kept]
    size = scale if 0.0 < scale < np.inf else 1.0
    small = SmallProblem(problem.gradient / size, unit.jacobian[kept], bound / size, equality, row_lengths)
    return ScaledProblem(problem, small, kept, impossible, scale, unit)


def reduce_problem(small: SmallProblem) -> tuple[SmallProblem, Float[np.ndarray, "n k"]]:
    """The problem in the coordinates of Q (n, k); d = g + Q (x − c)."""
    columns = np.concatenate((small.rows, small.center[None])).T
    Q, R, order = pivoted_qr(columns, COORDINATE_TOLERANCE)
    coordinates = np.empty((len(order), len(R)))
    coordinates[order] = R.T
    return replace(small, center=coordinates[-1], rows=coordinates[:-1]), Q
