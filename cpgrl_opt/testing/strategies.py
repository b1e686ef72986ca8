"""Hypothesis strategies for direction problems: the families of `cpgrl_opt.problems`, in small integers, and to order.

Entries are small integers, so that dependent rows are dependent exactly, degenerate cases come up often, and a
counterexample shrinks to numbers that a person can check by hand.
"""

from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st

from ..arrays import Float
from ..problem import DirectionProblem
from ..problems import geometry, infeasible
from ..problems.assembly import meet, rescale
from ..problems.case import ALL_CASES, GEOMETRIES, LIMITS, SHIFTED_CASES, members
from ..problems.case import Case as Case
from ..problems.dependent import rows_of_rank
from ..problems.registry import FAMILIES, Family
from ..problems.regular import rows_of_condition
from .drawn_source import DrawnSource, draw_with
from .draws import between, parts, picks

Problems = st.SearchStrategy[DirectionProblem]
# One value, (lowest, highest), or a strategy.
IntegerChoice = int | tuple[int, int] | st.SearchStrategy[int]
NumberChoice = float | tuple[float, float] | st.SearchStrategy[float]

WELL_POSED = tuple(family for family in FAMILIES.values() if family.well_posed)
HOSTILE = tuple(family for family in FAMILIES.values() if not family.well_posed)
# Powers of two, since rows that depend exactly must still do so after scaling; half of all problems stay as they are.
_EXACT_UNITS = tuple(
    (scale, rows) for scale in (1.0, 1.0, 1.0, 2.0**-13, 2.0**-27, 2.0**27) for rows in (1.0, 1.0, 2.0**20, 2.0**40)
)


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

    Parameters
    ----------
    n, m
        Parameters and constraints; one that is not given is 3. Where neither is given from (1, 1) to (200, 3) and
        (40, 12), 12 rows at most.
    rank
        Of J, exactly; else whatever the rows have, full as a rule.
    conditioning
        σ₁(J)/σᵣ(J) ≥ 1, before the rows are scaled; else whatever small integers have.
    scale
        c: (g, J, b) becomes (c g, c J, c² b), so d becomes c d.
    row_scale
        r: rows (and bounds) times 1/r, 1 or r.
    conflict
        How many constraints bind at the optimum, which is then planted: g = d − Jᵀμ. At most the rank.
    feasible
        False makes b miss {Jd} by at least 1e-3 max|b̂|; takes n, m ≥ 1, the scales, and cases with bounds only.
    cases
        Which kinds of constraints to draw from; with Case.ONE_ROW among them, m = 1 unless it is given.

    Returns
    -------
    SearchStrategy of DirectionProblem
    """
    shape = None, None
    if n is not None or m is not None:
        shape = _choose(draw, 3 if n is None else n), _choose(draw, 3 if m is None else m)
    source = DrawnSource(draw, cases, *shape)
    if _choose(draw, feasible):
        N, M = source.shape()
        case, order = source.case(cases), min(N, M) if rank is None else min(_choose(draw, rank), N, M)
        if conditioning is not None:
            rows = rows_of_condition(source, M, N, order, _choose(draw, conditioning))
        else:
            rows = source.numbers(M, N) if rank is None else rows_of_rank(source, M, N, order)
        problem = meet(source, rows, case, bind=None if conflict is None else _choose(draw, conflict))
    else:
        problem = infeasible.infeasible(source, source.case(cases, SHIFTED_CASES))
    return rescale(problem, _choose(draw, scale), row_factors(draw, problem.m, _choose(draw, row_scale)))


def infeasible_problems(n: int | None = None, m: int | None = None, *, cases: Collection[Case] = ALL_CASES) -> Problems:
    """Jᵀy = 0, y > 0 on some rows and bᵀy > 0, by at least 1e-3 max|b̂|: Farkas' vector comes first, then b."""
    if n is not None or m is not None:
        n, m = n or 3, m or 3
    return draw_with(infeasible.infeasible, cases, SHIFTED_CASES, (n, m))


def problems_in_geometry(
    n: int | None = None, m: int | None = None, *, cases: Collection[Case] = GEOMETRIES
) -> Problems:
    """Small integer problems in a metric or, with Case.RADIUS, mostly in a ball that meets the constraints."""
    makes: dict[Case, geometry.Make] = {Case.METRIC: geometry.in_metric, Case.RADIUS: geometry.in_ball}
    kinds = members("cases", cases, GEOMETRIES)
    return st.one_of([draw_with(makes[kind], constraints_of(cases), shape=(n, m)) for kind in kinds])


def problems_out_of_reach(cases: Collection[Case] = (*SHIFTED_CASES, Case.RADIUS)) -> Problems:
    """The ball misses the constraints by half the distance at least; feasible without it, if 0 is not allowed."""
    return draw_with(geometry.out_of_reach, constraints_of(cases), SHIFTED_CASES)


def problems_of(family: Family, cases: Collection[Case] | None = None) -> Problems:
    """The problems of a family, of the given cases or of all that it has; with Case.ONE_ROW, of one constraint."""
    return draw_with(family.make, family.cases if cases is None else cases, family.cases)


def well_posed_problems(cases: Collection[Case] = ALL_CASES) -> Problems:
    """All families whose answer float64 determines, those of the given cases."""
    return _mix(WELL_POSED, tuple(cases))


def hostile_problems(cases: Collection[Case] = ALL_CASES) -> Problems:
    """Everything: well-posed, beyond float64, infeasible, and nearly so."""
    return _mix((*WELL_POSED, *HOSTILE), tuple(cases))


@cache  # a strategy is examined by Hypothesis when it is first drawn from, which takes longer than the draw
def _mix(families: tuple[Family, ...], cases: tuple[Case, ...]) -> Problems:
    """A problem of any of the families, often with gradients short or long or rows of other lengths."""
    kinds = constraints_of(cases)
    applicable = [family for family in families if family.serves(cases) and set(family.cases) & set(kinds)]
    return _in_some_units(st.one_of([problems_of(each, kinds) for each in applicable for _ in range(each.weight)]))


@st.composite
def _in_some_units(draw: st.DrawFn, problems: Problems) -> DirectionProblem:
    problem = draw(problems)
    first, second = parts(draw, 2, problem.m)
    scale, row_scale = _EXACT_UNITS[int(picks(first, 1, range(len(_EXACT_UNITS)))[0])]
    return rescale(problem, scale, row_factors(second, problem.m, row_scale))


def constraints_of(cases: Collection[Case]) -> list[Case]:
    """The kinds of constraints among the cases, all if none is named; and, where it is named, that there is one."""
    kinds = [case for case in cases if case in ALL_CASES] or list(ALL_CASES)
    return kinds + [case for case in cases if case == Case.ONE_ROW]


def row_factors(draw: st.DrawFn, m: int, row_scale: float) -> Float[np.ndarray, "m"]:
    """1, row_scale or 1/row_scale for each row."""
    if row_scale == 1.0:
        return np.ones(m)
    return picks(draw, m, (1.0, row_scale, 1.0 / row_scale))


def _choose(draw: st.DrawFn, choice: Any) -> Any:
    """A value as it is; (lowest, highest) uniformly for integers, log-uniformly for floats; or from a strategy."""
    if isinstance(choice, st.SearchStrategy):
        return draw(choice)
    if not isinstance(choice, tuple):
        return choice
    lowest, highest = choice
    if isinstance(lowest, int) and isinstance(highest, int):
        return draw(between(lowest, highest))
    steps = 20
    return float(lowest * (highest / lowest) ** (draw(between(0, steps)) / steps))


__all__ = [
    "ALL_CASES",
    "GEOMETRIES",
    "HOSTILE",
    "LIMITS",
    "SHIFTED_CASES",
    "WELL_POSED",
    "Case",
    "direction_problems",
    "hostile_problems",
    "infeasible_problems",
    "problems_in_geometry",
    "problems_of",
    "problems_out_of_reach",
    "well_posed_problems",
]
