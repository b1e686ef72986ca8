"""Problems that count as long or as short, and how far their answers are apart."""

from contextlib import contextmanager
from fractions import Fraction

import numpy as np
import pytest

from cpgrl_opt import DirectionProblem
from cpgrl_opt.scaling import lengths
from cpgrl_opt.vectors import _numpy as array_vectors


@contextmanager
def least_products(products):
    """From so many products on a problem is long: from 0, all with n > 4 (1 + m)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(array_vectors, "LEAST_PRODUCTS", products)
        yield


def on_rows():
    """No problem is long."""
    return least_products(10**18)


def drawn_problem(seed, *, m=4, n=80, equality=False):
    """Rows well apart, about half of them tight at the optimum."""
    rng = np.random.default_rng(seed)
    return DirectionProblem(rng.standard_normal(n), rng.standard_normal((m, n)), 0.2 * rng.standard_normal(m), equality)


def distance(problem, first, second):
    """‖d − d′‖ in units of σ, the longest of g, d and d′."""
    unit = max(float(lengths(each)) for each in (problem.gradient, first.value, second.value)) or 1.0
    return float(lengths(first.value / unit - second.value / unit))


def at_angle(theta, *, sign=-1.0, n=120, seed=5):
    """Two rows that bind, the second at θ from opposing the first (sign −1) or from parallel; a third, and g."""
    first, second, third, fourth = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, 4)))[0].T
    rows = [5.0 * first, 3.0 * (sign * np.cos(theta) * first + np.sin(theta) * second), third - 0.4 * first]
    return fourth - 2.0 * second - third + 0.3 * sign * first, np.array(rows)


def rational(array):
    """The numbers as they are, without rounding."""
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=np.float64))


def solve_exactly(A, B):
    """A⁻¹B in exact rationals, A symmetric positive definite."""
    A, B = A.copy(), B.copy()
    for i in range(len(A)):
        for j in range(len(A)):
            if j != i:
                factor = A[j, i] / A[i, i]
                A[j], B[j] = A[j] - factor * A[i], B[j] - factor * B[i]
    return (B.T / A.diagonal()).T


# J, or g as one row, in storage of other strides; rows apart are a list.
STORAGES = {
    "row by row": np.ascontiguousarray,
    "column by column": np.asfortranarray,
    "every second column": lambda J: np.repeat(J, 2, axis=1)[:, ::2],
    "backwards": lambda J: np.ascontiguousarray(J[::-1, ::-1])[::-1, ::-1],
    "rows apart": lambda J: [row.copy() for row in J],
    "rows apart, backwards": lambda J: [row[::-1].copy()[::-1] for row in J],
    "between other numbers": lambda J: np.rec.fromarrays([J, J.astype(np.float32)], names="wanted,other")["wanted"],
    "columns backwards": lambda J: np.asfortranarray(J[:, ::-1])[:, ::-1],
    "read-only": lambda J: np.frombuffer(J.tobytes()).reshape(J.shape),
}
