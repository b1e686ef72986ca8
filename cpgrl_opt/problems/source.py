"""Where a family's choices come from: its numbers, integers, orders and options, for one problem.

A family is written once against `Source`. `RandomSource` asks a NumPy generator and gives Gaussian numbers; the
conformance kit asks Hypothesis and gets small integers, which shrink to a counterexample that is checked by hand.
"""

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from ..arrays import Float, Int, Jacobian, Mask, Vector
from ..exact import shortest_length
from ..metric import Metric
from ..problem import DirectionProblem
from .case import Case

T = TypeVar("T")
_EXACT_STEP = 2.0**-20  # multiples of it of size ≤ 2³² add up without rounding


class Source(Protocol):
    """What a family asks for. Each call is a choice of its own, in the order in which a family makes them."""

    def shape(self, n: int, m: int, *, least_rows: int = 1, least_parameters: int = 1) -> tuple[Any, ...]:
        """(n, m) of a problem, as usual n parameters and m constraints."""

    def numbers(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Numbers of size about 1, or small integers; a matrix of them has full rank as a rule."""

    def exact(self, *shape: int) -> Float[np.ndarray, "..."]:
        """The same where sums of a few of them are exact."""

    def independent(self, m: int, n: int) -> Jacobian:
        """m ≤ n rows of rank m, of which small sums are exact."""

    def orthonormal(self, m: int, n: int) -> Jacobian:
        """m ≤ n orthonormal rows."""

    def point(self, n: int) -> Vector:
        """A point on a coarse grid, so that Jd is exact where the rows are."""

    def slack(self, jacobian: Jacobian) -> Float[np.ndarray, "m"]:
        """How much each row Jᵢd ≥ bᵢ has to spare, ≥ 0, in units of its length."""

    def size(self, rows: Float[np.ndarray, "*m n"]) -> Any:
        """The length of each row, 1 of a zero row, or an integer that is longer."""

    def integers(self, lowest: int, highest: int, *shape: int) -> Any:
        """Integers lowest … highest; a single one without a shape."""

    def uniform(self, lowest: float, highest: float, *shape: int) -> Any:
        """Numbers between the two; a single one without a shape."""

    def order(self, count: int) -> Int[np.ndarray, "count"]:
        """A permutation of 0 … count − 1."""

    def choice(self, options: Sequence[T]) -> T:
        """One of the options, of which the first is the simplest."""

    def equalities(self, m: int, case: Case) -> Mask:
        """Which rows are equalities: all, none, or some of a mixed problem."""

    def metric(self, n: int, *, is_full: bool, decades: int = 2) -> Metric:
        """A diagonal or a full metric, of condition about 10^decades where it is full."""

    def shortest(self, problem: DirectionProblem) -> float | None:
        """√(dᵀMd) of the shortest direction that meets the constraints; 0 or None where there is none."""


class RandomSource:
    """Choices of a NumPy generator: a function of the generator alone. `n`, `m`: a shape for all families."""

    def __init__(self, rng: np.random.Generator, n: int | None = None, m: int | None = None) -> None:
        self.rng, self.n, self.m = rng, n, m

    def shape(self, n: int, m: int, *, least_rows: int = 1, least_parameters: int = 1) -> tuple[Any, ...]:
        """As usual, or as asked for; ValueError for a shape that the family does not come in."""
        found = n if self.n is None else self.n, m if self.m is None else self.m
        if found[0] < least_parameters or found[1] < least_rows:
            raise ValueError(f"(n, m) should be at least ({least_parameters}, {least_rows}) here; found {found}")
        return found

    def numbers(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Gaussian."""
        return self.rng.normal(size=shape)

    def exact(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Gaussian on a grid fine enough to look so, coarse enough that small sums are exact."""
        rows: np.ndarray = np.round(self.rng.normal(size=shape) / _EXACT_STEP) * _EXACT_STEP
        return rows

    def independent(self, m: int, n: int) -> Jacobian:
        """Gaussian ones are."""
        return self.exact(m, n)

    def orthonormal(self, m: int, n: int) -> Jacobian:
        """The first of a rotation."""
        Q, R = np.linalg.qr(self.numbers(n, n))
        return np.asarray(Q * np.sign(np.diag(R)))[:m]

    def point(self, n: int) -> Vector:
        """Gaussian, in eighths."""
        return np.round(self.numbers(n) * 8) / 8

    def slack(self, jacobian: Jacobian) -> Float[np.ndarray, "m"]:
        """Between 0.05 and 1 of the row's length."""
        slack: np.ndarray = self.rng.uniform(0.05, 1.0, size=len(jacobian)) * self.size(jacobian)
        return slack

    def size(self, rows: Float[np.ndarray, "*m n"]) -> Any:
        """The length; 1 where it is 0."""
        length = np.sqrt(rows @ rows) if rows.ndim == 1 else np.sqrt((rows * rows).sum(axis=1))
        return np.where(length > 0.0, length, 1.0)

    def integers(self, lowest: int, highest: int, *shape: int) -> Any:
        """Evenly."""
        return self.rng.integers(lowest, highest + 1, size=shape or None)

    def uniform(self, lowest: float, highest: float, *shape: int) -> Any:
        """Evenly."""
        return self.rng.uniform(lowest, highest, size=shape or None)

    def order(self, count: int) -> Int[np.ndarray, "count"]:
        """Evenly."""
        return self.rng.permutation(count)

    def choice(self, options: Sequence[T]) -> T:
        """Evenly."""
        return options[int(self.rng.integers(len(options)))]

    def equalities(self, m: int, case: Case) -> Mask:
        """Half of the rows of a mixed problem, rounded down, but one at least."""
        if case == Case.MIXED:
            return self.order(m) < max(m // 2, min(m, 1))
        return np.full(m, case in (Case.TANGENT, Case.AFFINE))

    def metric(self, n: int, *, is_full: bool, decades: int = 2) -> Metric:
        """Weights from 10⁻² to 10², or Q diag(1 … 10^decades) Qᵀ, Q turned at random."""
        if not is_full:
            return np.asarray(10.0 ** self.rng.uniform(-2, 2, n))
        Q, _ = np.linalg.qr(self.numbers(n, n))
        M = (Q * np.logspace(0, decades, n)) @ Q.T
        return np.asarray(0.5 * (M + M.T))

    def shortest(self, problem: DirectionProblem) -> float | None:
        """In rational arithmetic, for up to about 8 constraints."""
        return shortest_length(problem)
