"""Rank-revealing QR: [v₁ … vₚ] Π = Q R with |R₁₁| ≥ |R₂₂| ≥ …, cut where |Rₖₖ| falls below a tolerance.

LAPACK is called directly, for SciPy's wrappers take longer than the arithmetic of a nine-by-three matrix.
Source: Golub & Van Loan, Matrix Computations, §5.4.2.
"""

from functools import cache
from typing import Any

import numpy as np

from ..arrays import Float, Int

Matrix = Float[np.ndarray, "rows columns"]


def pivoted_qr(
    columns: Matrix, tolerance: float
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "r p"], Int[np.ndarray, "p"]]:
    """(Q, R, order): Q (n, r) orthonormal, R (r, p) upper triangular, columns[:, order] = Q R to the tolerance."""
    n, count = columns.shape
    lapack = _lapack()
    factors, order, tau, _, _ = lapack.dgeqp3(columns, lwork=3 * count + 64)
    R = np.triu(factors[: min(n, count)])
    rank = int((np.abs(R.diagonal()) > tolerance).sum())
    Q, _, _ = lapack.dorgqr(factors[:, :rank], tau[:rank], lwork=max(1, 32 * rank))
    return Q, R[:rank], order - 1


def solve_upper(R: Matrix, right: Float[np.ndarray, "r"], *, transposed: bool = False) -> Float[np.ndarray, "r"]:
    """x of R x = right, or of Rᵀx = right; R (r, r) upper triangular with no zero on its diagonal."""
    if len(right) == 0:
        return right
    x: np.ndarray = _lapack().dtrtrs(R, right, trans=int(transposed))[0]
    return x


@cache
def _lapack() -> Any:
    from scipy.linalg import lapack  # first use only: importing the solvers stays light

    return lapack
