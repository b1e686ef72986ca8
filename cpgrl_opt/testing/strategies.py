"""Hypothesis strategies for direction problems, built from a point that meets the constraints, never filtered.

Entries are small integers, so that dependent rows are dependent exactly, degenerate cases come up often, and a
counterexample shrinks to numbers that a person can check by hand.
"""

from collections.abc import Collection
from enum import StrEnum

import numpy as np
from hypothesis import strategies as st

from ..arrays import Bool, Float, Int
from ..problem import DirectionProblem
from .draws import (
    LARGEST_ENTRY,
    IntegerChoice,
    NumberChoice,
    any_of,
    between,
    chosen,
    integers,
    members,
    orders,
    parts,
    picks,
    shape,
)


class Case(StrEnum):
    """What solvers differ in: five kinds of constraints, two geometries that go with any of them, and two limits.

    A solver without `supports` is taken to handle the five; the geometries only where it has `takes_geometry`. A limit
    is what all problems of a solver have in common where `supports` takes no others.
    """

    CONE = "J d ≥ 0"
    BOUNDS = "J d ≥ b"
    TANGENT = "J d = 0"
    AFFINE = "J d = b"
    MIXED = "J d ≥ b, = b in some rows"
    METRIC = "½dᵀMd for ½‖d‖²"
    RADIUS = "max gᵀd, dᵀMd ≤ radius²"
    ONE_ROW = "one constraint at most"
    BALL = "never without a radius"

    @property
    def is_geometry(self) -> bool:
        """Whether it says how directions are measured, and nothing about constraints."""
        return self in (Case.METRIC, Case.RADIUS)

    @property
    def is_limit(self) -> bool:
        """Whether it says what the problems of a solver never are."""
        return self in (Case.ONE_ROW, Case.BALL)

    @property
    def is_shifted(self) -> bool:
        """Whether b ≠ 0."""
        return self in (Case.BOUNDS, Case.AFFINE, Case.MIXED)


ALL_CASES = tuple(case for case in Case if not case.is_geometry and not case.is_limit)  # of constraints
GEOMETRIES = tuple(case for case in Case if case.is_geometry)
SHIFTED_CASES = tuple(case for case in Case if case.is_shifted)
LIMITS = tuple(case for case in Case if case.is_limit)


@st.composite
def direction_problems(
    draw: st.DrawFn,
    n: IntegerChoice | None = None,
    m: IntegerChoice | None = None,
    *,
    rank: IntegerChoice | None = None,
    conditioning: NumberChoice | None = None,
    scale: NumberChoice = 1.0,
    row_scale: NumberChoice = 1.0,
    conflict: IntegerChoice | None = None,
    feasible: bool | st.SearchStrategy[bool] = True,
    cases: Collection[Case] = ALL_CASES,
) -> DirectionProblem:
    """Problems with a geometry to order; every argument is a value, a range (lowest, highest) or a strategy.

    n, m: parameters and constraints; where neither is given from (1, 1) to (200, 3) and (40, 12), 12 rows at most.
    rank: of J, exactly; else whatever the rows have, full as a rule.
    conditioning: σ₁(J)/σᵣ(J) ≥ 1, before the rows are scaled; else whatever small integers have.
    scale c: (g, J, b) becomes (c g, c J, c² b), so d becomes c d. row_scale r: rows (and bounds) times 1/r, 1 or r.
    conflict: how many constraints bind at the optimum, which is then planted: g = d − Jᵀμ. At most the rank.
    feasible: False makes b miss {Jd} by at least 1e-3 max|b̂|; takes n, m ≥ 1, the scales, and cases with bounds only.
    cases: which kinds of constraints to draw from; with Case.ONE_ROW among them, m = 1 unless it is given.
    """
    size = _size(draw, n, m, cases)
    if not chosen(draw, feasible):
        problem = draw(infeasible_problems(*size, cases=cases))
    else:
        case = kind_of(draw, cases)
        order = None if rank is None else min(chosen(draw, rank), *size)
        if conditioning is not None:
            jacobian = conditioned_rows(draw, *size, order, chosen(draw, conditioning))
        else:
            jacobian = integer_rows(draw, *size, order)
        binding = None if conflict is None else chosen(draw, conflict)
        problem = feasible_problem(draw, jacobian, case, conflict=binding)
    return rescaled(problem, chosen(draw, scale), row_factors(draw, problem.m, chosen(draw, row_scale)))


def shape_for(draw: st.DrawFn, cases: Collection[Case], least_rows: int = 1) -> tuple[int, int]:
    """A shape (n, m), of one constraint where the cases are limited to it."""
    return shape(draw, most_rows=1) if Case.ONE_ROW in cases else shape(draw, least_rows=least_rows)


def integer_rows(draw: st.DrawFn, n: int, m: int, rank: int | None = None) -> Float[np.ndarray, "m n"]:
    """J of small integers; of exactly the rank given, rows beyond it being sums of the others, in any order."""
    if rank is None:
        return integers(draw, m, n, largest=draw(any_of((LARGEST_ENTRY, 2))))
    rows = np.zeros((m, n))
    entries = integers(draw, rank, n, largest=LARGEST_ENTRY if rank <= 3 else 1)  # triangles of 9s are near singular
    rows[:rank] = np.eye(rank, n) * draw(between(1, LARGEST_ENTRY)) + np.triu(entries, 1)
    if 0 < rank < m:
        rows[rank:] = integers(draw, m - rank, rank, largest=1) @ rows[:rank]
    shuffled: np.ndarray = rows[orders(draw, m)]
    return shuffled


def conditioned_rows(
    draw: st.DrawFn, n: int, m: int, rank: int | None, conditioning: float
) -> Float[np.ndarray, "m n"]:
    """J = U diag(s) Vᵀ, s from 9 down to 9/conditioning in equal ratios, U and V orthonormal."""
    count = min(m, n) if rank is None else rank
    left = np.linalg.qr(integers(draw, m, m))[0][:, :count]
    right = np.linalg.qr(integers(draw, n, count), mode="reduced")[0]
    rows: np.ndarray = (left * (LARGEST_ENTRY * np.geomspace(1.0, 1.0 / conditioning, count))) @ right.T
    return rows


def feasible_problem(
    draw: st.DrawFn, jacobian: Float[np.ndarray, "m n"], case: Case, *, conflict: int | None = None
) -> DirectionProblem:
    """g, b and equalities around a point d that meets J d ≥ b; with a `conflict` d is the optimum."""
    m, n = jacobian.shape
    kinds, rows, slacks, signs = parts(draw, 4, m)
    equality = equalities(kinds, m, case)
    point = integers(draw, n)
    binding = equality.copy()
    if conflict is not None:
        binding |= _independent(jacobian, orders(rows, m), conflict)
    if not case.is_shifted:
        jacobian, point = _turned(jacobian, point, binding) if conflict is not None else (jacobian, 0 * point)
    bound = np.zeros(m)
    if case.is_shifted:
        slack = np.where(binding, 0.0, _slacks(slacks, m, lowest=0 if conflict is None else 1))
        bound = jacobian @ point - slack
    if conflict is None:
        return DirectionProblem(integers(draw, n), jacobian, bound, equality)
    weights = integers(draw, m, lowest=1) * np.where(equality, picks(signs, m, (1.0, -1.0)), 1.0)
    return DirectionProblem(point - (weights * binding) @ jacobian, jacobian, bound, equality)


@st.composite
def infeasible_problems(
    draw: st.DrawFn, n: int | None = None, m: int | None = None, *, cases: Collection[Case] = ALL_CASES
) -> DirectionProblem:
    """Jᵀy = 0, y > 0 on some k rows and bᵀy > 0, by at least 1e-3 max|b̂|: Farkas' vector comes first, then b.

    One of the k rows is −Σ yᵢJᵢ of the others, a zero row when k = 1; bᵢ = Jᵢp + tᵢ, tᵢ > ‖Jᵢ‖ or > ‖Jᵢ‖/32.
    """
    n, m = _size(draw, n, m, cases, draw(any_of((3, 2, 2, 1))))  # one row alone is a zero row
    case = kind_of(draw, cases, SHIFTED_CASES)
    # b̂ stays within 30 times the least miss
    jacobian, point = integers(draw, m, n), integers(draw, n, largest=9 if n <= 9 else 2)
    jacobian[:, 0] += ~jacobian.any(axis=1)  # a zero row is a case of its own, k = 1
    farkas, slacks, rows, kinds = parts(draw, 4, m)
    k = min(draw(any_of((2, 3, 2, 1, 6, 12))), m, n + 1)
    jacobian[k - 1] = -picks(farkas, k - 1, (1.0, 2.0, 3.0)) @ jacobian[: k - 1]
    bound = jacobian @ point - _slacks(slacks, m)
    excess = np.ceil(np.sqrt((jacobian[:k] ** 2).sum(axis=1))) + 1.0
    bound[:k] = jacobian[:k] @ point + excess * draw(any_of((1.0, 1 / 32 if k <= 3 else 1.0)))
    order = orders(rows, m)
    bound = bound[order]
    equality = equalities(kinds, m, case) & (bound > -np.inf)
    return DirectionProblem(integers(draw, n), jacobian[order], bound, equality)


def row_factors(draw: st.DrawFn, m: int, row_scale: float) -> Float[np.ndarray, "m"]:
    """1, row_scale or 1/row_scale for each row."""
    if row_scale == 1.0:
        return np.ones(m)
    return picks(draw, m, (1.0, row_scale, 1.0 / row_scale))


def rescaled(problem: DirectionProblem, scale: float, factors: Float[np.ndarray, "m"]) -> DirectionProblem:
    """(c g, c J, c² b, c radius), row i and bᵢ times factorᵢ: the optimum becomes c d."""
    if scale == 1.0 and (factors == 1.0).all():
        return problem
    return DirectionProblem(
        scale * problem.gradient,
        scale * factors[:, None] * problem.jacobian,
        scale * (scale * factors * problem.bound),
        problem.equality,
        problem.metric,
        None if problem.radius is None else scale * problem.radius,
    )


def _size(
    draw: st.DrawFn, n: IntegerChoice | None, m: IntegerChoice | None, cases: Collection[Case], least_rows: int = 1
) -> tuple[int, int]:
    if n is None and m is None:
        return shape_for(draw, cases, least_rows)
    return chosen(draw, 3 if n is None else n), chosen(draw, 3 if m is None else m)


def kind_of(draw: st.DrawFn, cases: Collection[Case], possible: Collection[Case] = ALL_CASES) -> Case:
    """One of the possible cases; mixed ones, which differ most, twice as often. ValueError where none is possible."""
    kinds = members("cases", cases, possible)
    case: Case = draw(any_of((*kinds, *(kind for kind in kinds if kind == Case.MIXED))))
    return case


def equalities(draw: st.DrawFn, m: int, case: Case) -> Bool[np.ndarray, "m"]:
    """All or none; in a mixed problem any rows, for what a solver puts first must come out in the caller's order."""
    if case != Case.MIXED:
        return np.full(m, case in (Case.TANGENT, Case.AFFINE))
    equality: np.ndarray = picks(draw, m, (0.0, 1.0)) == 1.0
    if m > 1 and equality.all() == equality.any():
        equality[-1] = not equality[-1]
    return equality


def _slacks(draw: st.DrawFn, m: int, lowest: int = 0) -> Float[np.ndarray, "m"]:
    return picks(draw, m, (float(lowest), 1.0, 5.0, 40.0, float("inf")))


def _independent(jacobian: Float[np.ndarray, "m n"], order: Int[np.ndarray, "m"], count: int) -> Bool[np.ndarray, "m"]:
    """The first independent rows in that order, at most `count`."""
    taken = np.zeros(len(jacobian), dtype=np.bool_)
    for i in order:
        if taken.sum() == count:
            break
        taken[i] = True
        if np.linalg.matrix_rank(jacobian[taken]) < taken.sum():
            taken[i] = False
    return taken


def _turned(
    jacobian: Float[np.ndarray, "m n"], point: Float[np.ndarray, "n"], binding: Bool[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "n"]]:
    """The part d of the point in the null space of the binding rows; the other rows turned so that Jᵢd ≥ 0."""
    rows = jacobian[binding]
    d = point - np.linalg.pinv(rows) @ (rows @ point) if binding.any() else point
    signs = np.where(~binding & (jacobian @ d < 0), -1.0, 1.0)
    return signs[:, None] * jacobian, d
