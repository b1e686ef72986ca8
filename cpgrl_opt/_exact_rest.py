"""What the referee measures as if in twice the precision, in units where numbers are about 1 (see `units`).

    r = κMd − g − Jᵀμ,     Jᵢd − bᵢ,     dᵀMd

Two things ask for it. In a full metric up to cond(M) of the parts cancel: M itself is used, and its factor L only to
measure what is left, so that rounding of L hides no error. With multipliers μ̂ᵢ = 1e10 float64 leaves 1e-6 in r, where
an error of d could hide. There r is split, r_in in the span of the rows (and of d, where κ ≠ 0), r_out beside it: to
change μ in its last digits changes r_in by up to eps Σ|μ̂|, and r_out not at all.
Source: Wilkinson 1963, Rounding Errors in Algebraic Processes (the residual in twice the precision).
"""

import numpy as np

from .arrays import Float, Jacobian, Multipliers, Vector
from .compensated import Pair, products
from .problem import DirectionProblem
from .scaling import lengths

# Singular values of unit rows below it are rounding, which leaves √m eps of those of rows that depend: with 1e-16 they
# would span a direction that they do not. With 1e-9 rows 1e-10 rad apart would be one, and what rounding leaves of a
# right answer's r along their difference be called an error.
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


def find_length(Md: Pair, d: Vector) -> float:
    """√(dᵀMd)."""
    square = products(np.array(Md), d).rounded().sum()
    return float(np.sqrt(max(float(square), 0.0)))


def find_slack(problem: DirectionProblem, d: Vector) -> Multipliers:
    """Jd − b; infinite where a row is switched off."""
    bound = np.where(problem.bound == -np.inf, 0.0, problem.bound)
    slack = products(problem.jacobian, d).plus(Pair(-bound, np.zeros_like(bound))).rounded()
    return np.where(problem.bound == -np.inf, np.inf, slack)


def split_rest(rest: Vector, directions: Float[np.ndarray, "k n"]) -> tuple[float, float]:
    """(‖r_in‖, ‖r_out‖), the directions being those that r may be changed along, each of length 1 or 0."""
    _, values, basis = np.linalg.svd(directions, full_matrices=False)
    basis = basis[values > _RANK]
    coordinates = basis @ rest
    return float(lengths(coordinates)), float(lengths(rest - coordinates @ basis))
