"""What the referee measures in a full metric, from M itself: no factor of M has a part in what is subtracted.

    r = κMd − g − Jᵀμ,     Jᵢd − bᵢ,     dᵀMd        (κ = 1 without a radius)

are formed as if in twice the precision, since up to cond(M) of their parts cancel, and only then measured by L⁻¹ of
M ≈ LLᵀ: rounding of L changes a residual by a part of itself and hides none. A diagonal M needs none of it.
Source: Wilkinson 1963, Rounding Errors in Algebraic Processes (the residual in twice the precision).
"""

from dataclasses import dataclass

import numpy as np

from .arrays import Multipliers, Vector
from .compensated import Pair, products
from .problem import DirectionProblem, UnitRows, euclidean, lengths, unit_rows


@dataclass(frozen=True, eq=False)
class ExactTerms:
    """Where M = I: r (n,), ‖g‖, ‖d‖, the unit rows and their slack (m,); −inf bounds leave infinite slack."""

    rest: Vector
    strength: float
    length: float
    rows: UnitRows
    slack: Multipliers


def exact_terms(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float = 1.0) -> ExactTerms:
    """The terms of (d, μ, κ), in a problem whose numbers are about 1 (see `units`) and whose M is (n, n)."""
    M, whitening = problem.metric, problem.whitening
    if M is None or whitening is None:
        raise ValueError("problem should have a metric; found None")
    flat = euclidean(problem)
    rows = unit_rows(flat.jacobian)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        Md = products(M, d)
        forces = np.column_stack([problem.gradient, problem.jacobian.T])
        force = products(forces, np.append(1.0, mu))
        residual = Md.times(kappa).plus(Pair(-force.hi, -force.lo)).rounded()
        square = products(np.array([Md.hi, Md.lo]), d)
        length = float(np.sqrt(max(float(square.rounded().sum()), 0.0)))
        slack = _slack(problem, d)
        return ExactTerms(
            whitening.gradient(residual),
            float(lengths(flat.gradient)),
            length,
            rows,
            np.where(problem.bound == -np.inf, np.inf, rows.per_length(slack)),
        )


def _slack(problem: DirectionProblem, d: Vector) -> Multipliers:
    bound = np.where(problem.bound == -np.inf, 0.0, problem.bound)
    reached = products(problem.jacobian, d)
    return reached.plus(Pair(-bound, np.zeros_like(bound))).rounded()
