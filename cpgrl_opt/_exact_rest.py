"""What the referee measures as if in twice the precision, in units where numbers are about 1 (see `units`).

    r = κMd − g − Jᵀμ,     Jᵢd − bᵢ,     dᵀMd

Two things ask for it. In a full metric up to cond(M) of the parts cancel: M itself is used, and its factor L only to
measure what is left, so that rounding of L hides no error. With multipliers μ̂ᵢ = 1e10 float64 leaves 1e-6 in r, where
an error of d could hide. There r is split, r_in in the span of the rows (and of d, where κ ≠ 0), r_out beside it: to
change μ in its last digits changes r_in by up to eps Σ|μ̂|, and r_out not at all.
Source: Wilkinson 1963, Rounding Errors in Algebraic Processes (the residual in twice the precision).
"""

import math

import numpy as np

from .arrays import Float, Jacobian, Multipliers, Vector
from .compensated import Pair, products
from .metric import Metric
from .problem import DirectionProblem
from .scaling import lengths

# Singular values of unit rows below it are rounding. With 1e-17 rows that depend but for rounding would span a
# direction that they do not. Upwards nothing changed up to 1e-3: what rounding leaves of a right r is along the rows,
# and not along the small difference of two.
_RANK = 1e-13
_BLOCK = 8192  # numbers of each vector at a time: the dozen arrays that a product in pairs takes stay in a cache


def find_rest(g: Vector, J: Jacobian, Md: Pair, mu: Multipliers, kappa: float) -> Vector:
    """κMd − g − Jᵀμ, each number to 2⁻¹⁰⁰ or so of the largest of its terms."""
    on, pushed, rest = mu != 0.0, Md.times(kappa), np.empty_like(g)
    forces, J = np.append(-1.0, -mu[on]), J if on.all() else J[on]
    for start in range(0, len(g), _BLOCK):
        part = slice(start, start + _BLOCK)
        pulled = products(np.vstack([g[part], J[:, part]]).T, forces)
        rest[part] = pulled.plus(Pair(pushed.hi[part], pushed.lo[part])).rounded()
    return rest


def find_terms(
    problem: DirectionProblem, M: Metric, d: Vector, mu: Multipliers, kappa: float
) -> tuple[Vector, float, Multipliers]:
    """κMd − g − Jᵀμ, √(dᵀMd) and Jd − b, infinite where a row is switched off; M: (n, n), the problem's."""
    n, is_off = problem.n, problem.bound == -np.inf
    reached = products(np.vstack([M, problem.jacobian]), d)
    Md, Jd = (Pair(reached.hi[part], reached.lo[part]) for part in (slice(n), slice(n, None)))
    square = float(products(np.array(Md), d).rounded().sum())
    slack = Jd.plus(Pair(np.where(is_off, 0.0, -problem.bound), np.zeros(problem.m))).rounded()
    rest = find_rest(problem.gradient, problem.jacobian, Md, mu, kappa)
    return rest, math.sqrt(square) if square > 0.0 else 0.0, np.where(is_off, np.inf, slack)


def split_rest(rest: Vector, directions: Float[np.ndarray, "k n"]) -> tuple[float, float]:
    """(‖r_in‖, ‖r_out‖), the directions being those that r may be changed along, each of length 1 or 0."""
    _, values, basis = np.linalg.svd(directions, full_matrices=False)
    basis = basis[values > _RANK]
    coordinates = basis @ rest
    return float(lengths(coordinates)), float(lengths(rest - coordinates @ basis))
