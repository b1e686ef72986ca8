"""How far two answers to one problem may be apart when both have small residuals: Hoffman's constant.

    H = max { 1/σ_min(Ĵ_S) : S ⊆ {1 … m}, rows Ĵ_S independent }

Let (d, μ) have residuals ≤ ε (relative to σ = max(‖g‖, ‖d‖), as the referee has them). Then it solves exactly a
problem with g moved by at most (1 + 2m) εσ and b̂ by at most εσ in each row: leave out the multipliers that are
negative or stand at rows that are not tight, each at most εσ. The projection is non-expansive in g and, piecewise
d = g + Ĵ_S⁺(b̂_S − Ĵ_S g), Lipschitz in b̂ with the constant H, so

    ‖d − d*‖ ≤ (1 + 2m + √m H) ε′ σ,      ε′ = ε + 16 m H eps

with the referee's allowance for large multipliers, and the rounding of the data, in ε′.
Source: Hoffman 1952, On approximate solutions of systems of linear inequalities; Mangasarian & Shiau 1987.
"""

from itertools import combinations

import numpy as np

from ..problem import DirectionProblem, unit_rows
from ..projection import RANK_TOLERANCE
from .law import length

_EPS = float(np.finfo(np.float64).eps)
MOST_ROWS = 12  # 2¹² sets of rows


def hoffman_constant(problem: DirectionProblem) -> float:
    """H of the rows that are switched on; 1 where there are none. ValueError beyond 12 rows."""
    if problem.m > MOST_ROWS:
        raise ValueError(f"problem should have at most {MOST_ROWS} constraints for this bound; found {problem.m}")
    rows = unit_rows(problem.jacobian).jacobian[(problem.bound > -np.inf) & problem.jacobian.any(axis=1)]
    largest = 1.0
    for size in range(2, min(rows.shape) + 1):
        sets = np.array(list(combinations(range(len(rows)), size)))
        smallest = np.linalg.svd(rows[sets], compute_uv=False)[:, -1]
        independent = smallest > RANK_TOLERANCE
        largest = max(largest, float((1.0 / smallest[independent]).max(initial=1.0)))
    return largest


def relative_distance(problem: DirectionProblem, residual: float) -> float:
    """(1 + 2m + √m H) ε′ of the module's head: ‖d − d*‖/σ for any d with KKT residuals ≤ residual."""
    H, m = hoffman_constant(problem), problem.m
    return float((1 + 2 * m + np.sqrt(m) * H) * (residual + 16 * max(m, 1) * H * _EPS))


def distance_bound(problem: DirectionProblem, residual: float, *directions: np.ndarray) -> float:
    """‖d − d*‖ for any d with KKT residuals ≤ residual; σ = max(‖g‖, ‖d‖) over all `directions`."""
    sigma = max(length(vector) for vector in (problem.gradient, *directions))
    return relative_distance(problem, residual) * sigma
