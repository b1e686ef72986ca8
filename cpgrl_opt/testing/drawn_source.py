"""The choices of a family (`cpgrl_opt.problems.source`) drawn by Hypothesis: small integers that shrink."""

from collections.abc import Collection, Sequence
from typing import Any, TypeVar

import numpy as np
from hypothesis import strategies as st

from ..arrays import Float, Int, Jacobian, Mask, Vector
from ..direction import Status
from ..metric import Metric
from ..problem import DirectionProblem
from ..problems.assembly import vary
from ..problems.case import ALL_CASES, Case, members
from ..problems.geometry import Make
from ..published.euclidean import euclidean
from ..solvers import SOLVERS
from .draws import LARGEST_ENTRY, MOST_PARAMETERS, any_of, between, integers, orders, parts, picks, shape
from .law import length

T = TypeVar("T")

_SLACKS = (0.0, 1.0, 5.0, 40.0, float("inf"))
_UNITS = (1.0, 2.0, 0.5, 16.0, 1 / 16)  # of single parameters
_STEPS = 8  # of an interval, the upper end being the simplest
_SHORT, _PARTS = 4, 4  # arrays up to this length come four to a block


class DrawnSource:
    """Choices of Hypothesis; n, m: the shape of the problem where it is given. cases: with ONE_ROW, m = 1."""

    def __init__(
        self, draw: st.DrawFn, cases: Collection[Case] = (), n: int | None = None, m: int | None = None
    ) -> None:
        self._draw, self._given, self._most_rows = draw, (n, m), 1 if Case.ONE_ROW in cases else None
        self._parts: list[st.DrawFn] = []

    def shape(
        self,
        n: int = 0,  # noqa: ARG002 - what is usual elsewhere
        m: int = 0,  # noqa: ARG002
        *,
        least_rows: int = 1,
        least_parameters: int = 1,
    ) -> tuple[Any, ...]:
        """One of all shapes, whatever is usual elsewhere."""
        if self._given != (None, None):
            return self._given
        if self._most_rows is not None:
            return shape(self._draw, most_rows=self._most_rows, least_rows=min(least_rows, self._most_rows))
        return shape(self._draw, least_rows=least_rows, least_parameters=least_parameters)

    def case(self, cases: Collection[Case], possible: Collection[Case] = ALL_CASES) -> Case:
        """One of the possible cases; mixed ones, which differ most, three times as often. ValueError where none is."""
        kinds = members("cases", cases, possible)
        return self.choice((*kinds, *[kind for kind in kinds if kind == Case.MIXED] * 2))

    def numbers(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Up to 9, in matrices often up to 2, so that ties and dependence come up."""
        largest = self.choice((LARGEST_ENTRY, 2)) if len(shape) > 1 else LARGEST_ENTRY
        return integers(self._draw, *shape, largest=largest)

    exact = numbers

    def independent(self, m: int, n: int) -> Jacobian:
        """A triangle; small entries where it is large, since triangles of 9s are near singular."""
        entries = integers(self._draw, m, n, largest=LARGEST_ENTRY if m <= 3 else 1)
        triangle: Jacobian = np.eye(m, n) * self.integers(1, LARGEST_ENTRY) + np.triu(entries, 1)
        return triangle

    def orthonormal(self, m: int, n: int) -> Jacobian:
        """The Q of small integers."""
        return np.linalg.qr(integers(self._draw, n, m))[0].T

    def point(self, n: int) -> Vector:
        """Small integers, so that b̂ stays within 30 times what an infeasible problem misses."""
        return integers(self._draw, n, largest=LARGEST_ENTRY if n <= LARGEST_ENTRY else 2)

    def slack(self, jacobian: Jacobian) -> Float[np.ndarray, "m"]:
        """None, little, much, or all there is."""
        return picks(self._short(len(jacobian)), len(jacobian), _SLACKS)

    def size(self, rows: Float[np.ndarray, "*m n"]) -> Any:
        """The next integer but one, so that it is longer than 0 and rounding."""
        return np.ceil(np.sqrt((rows * rows).sum(axis=-1))) + 1.0

    def integers(self, lowest: int, highest: int, *shape: int) -> Any:
        """The one nearest to 0 is the simplest."""
        if not shape:
            return self._draw(between(lowest, highest))
        source = self._short(shape[0]) if len(shape) == 1 else self._draw
        return integers(source, *shape, lowest=lowest, largest=highest)

    def uniform(self, lowest: float, highest: float, *shape: int) -> Any:
        """One of nine levels."""
        levels = tuple(highest - (highest - lowest) * k / _STEPS for k in range(_STEPS + 1))
        if not shape:
            return self.choice(levels)
        count = int(np.prod(shape))
        return picks(self._short(count), count, levels).reshape(shape)

    def order(self, count: int) -> Int[np.ndarray, "count"]:
        """The identity is the simplest."""
        return orders(self._short(count), count)

    def choice(self, options: Sequence[T]) -> T:
        """The first is the simplest."""
        chosen: T = self._draw(any_of(options))
        return chosen

    def equalities(self, m: int, case: Case) -> Mask:
        """In a mixed problem any rows, for what a solver puts first must come out in the caller's order."""
        if case != Case.MIXED:
            return np.full(m, case in (Case.TANGENT, Case.AFFINE))
        equality: np.ndarray = picks(self._short(m), m, (0.0, 1.0)) == 1.0
        if m > 1 and equality.all() == equality.any():
            equality[-1] = not equality[-1]
        return equality

    def metric(self, n: int, *, is_full: bool, decades: int = 2) -> Metric:  # noqa: ARG002
        """Powers of two, or TTᵀ + I with T of small integers, in units of any kind; T is thin for large n."""
        units = picks(self._draw, n, _UNITS)
        if not is_full or n > MOST_PARAMETERS:  # the referee judges by a full metric in n² exact products
            return units**2
        root = integers(self._draw, n, n if n <= LARGEST_ENTRY else 3, largest=2)
        metric: np.ndarray = (root @ root.T + np.eye(n)) * units * units[:, None]
        return metric

    def shortest(self, problem: DirectionProblem) -> float:
        """By the package's own solver: 12 rows are too many for rational numbers."""
        flat = euclidean(problem)
        found = SOLVERS["active-set"].solve(vary(flat, gradient=np.zeros(problem.n)))
        return length(found.value) if found.status == Status.OPTIMAL else 0.0

    def _short(self, count: int) -> st.DrawFn:
        """A part of a block for an array that is short: a choice costs Hypothesis more than its bytes."""
        if count > _SHORT:
            return self._draw
        if not self._parts:
            self._parts = parts(self._draw, _PARTS, _SHORT)[::-1]
        return self._parts.pop()


def draw_with(
    make: Make,
    cases: Collection[Case],
    possible: Collection[Case] = ALL_CASES,
    shape: tuple[int | None, int | None] = (None, None),
) -> st.SearchStrategy[DirectionProblem]:
    """The problems that a function of a source and a case makes, of the cases that are possible."""
    return _draw_with(make, tuple(cases), tuple(possible), shape)


@st.composite
def _draw_with(draw: st.DrawFn, make: Make, cases: Any, possible: Any, shape: Any) -> DirectionProblem:
    source = DrawnSource(draw, cases, *shape)
    return make(source, source.case(cases, possible))
