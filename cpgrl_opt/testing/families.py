"""Named families of direction problems, each with the reason it exists: what breaks solvers that look right.

`well_posed_problems` mixes the families whose answer float64 determines; `hostile_problems` adds those where a solver
may decline but not lie; `infeasible_problems` (in `strategies`) are those without an answer.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache

import numpy as np
from hypothesis import strategies as st

from ..problem import DirectionProblem
from .draws import (
    MOST_ROWS,
    NumberChoice,
    any_of,
    are_small,
    between,
    chosen,
    integers,
    members,
    orders,
    parts,
    pick,
    picks,
    shape,
)
from .geometries import TOUCHING, constraints_of, in_some_ball, problems_in_geometry, problems_out_of_reach
from .law import varied
from .strategies import (
    ALL_CASES,
    SHIFTED_CASES,
    Case,
    direction_problems,
    equalities,
    feasible_problem,
    infeasible_problems,
    integer_rows,
    kind_of,
    rescaled,
    row_factors,
    shape_for,
)

Problems = st.SearchStrategy[DirectionProblem]
# Powers of two, since rows that depend exactly must still do so after scaling; half of all problems stay as they are.
_EXACT_ROW_SCALES = any_of((1.0, 1.0, 2.0**20, 2.0**40))
_EXACT_UNITS = [
    (scale, rows) for scale in (1.0, 1.0, 1.0, 2.0**-13, 2.0**-27, 2.0**27) for rows in (1.0, 1.0, 2.0**20, 2.0**40)
]


@dataclass(frozen=True)
class Family:
    """A source of problems; `problems` maps the cases that a solver takes to a strategy.

    geometry: the one that all its problems are in, None for Euclidean ones without a ball. several_rows: it is about
    how rows lie to each other. only: the limit of the solvers that it is for, None for all. weight: how often it comes
    up.
    """

    name: str
    reason: str
    problems: Callable[[Collection[Case]], Problems]
    cases: tuple[Case, ...] = ALL_CASES
    geometry: Case | None = None
    several_rows: bool = False
    only: Case | None = None
    weight: int = 1

    def serves(self, cases: Collection[Case]) -> bool:
        """Whether solvers that take these cases may be given its problems."""
        if self.only is not None and self.only not in cases:
            return False
        if self.several_rows and Case.ONE_ROW in cases:
            return False
        if Case.BALL in cases:
            return self.geometry == Case.RADIUS
        if not any(case in ALL_CASES for case in cases):  # nothing but geometries is asked for
            return self.geometry in cases
        return self.geometry is None or self.geometry in cases


@st.composite
def binding_rows(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """Any number of rows up to min(n, m) bind at an optimum that is planted: g = d − Jᵀμ."""
    n, m = shape_for(draw, cases)
    case = kind_of(draw, cases)
    return feasible_problem(draw, integer_rows(draw, n, m), case, conflict=draw(between(1, min(n, m))))


@st.composite
def rank_deficient_rows(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """The rank is less than both n and m."""
    n, m = shape(draw, least_rows=2, least_parameters=2)
    rank = draw(between(1, min(n, m) - 1))
    return feasible_problem(draw, integer_rows(draw, n, m, rank), kind_of(draw, cases))


@st.composite
def duplicate_rows(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """Two rows are the same; multipliers are not unique, the direction is."""
    return _dependent(draw, cases, lambda rows: rows[0])


@st.composite
def opposing_rows(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """Jⱼ = −Jᵢ: two inequalities make an equality, and the cone has no interior."""
    return _dependent(draw, cases, lambda rows: -rows[0])


@st.composite
def sum_to_zero(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """Σ Jᵢ = 0, as Δ² + Δ³ + Δ⁴ = 0 in the paper's three-state MDP."""
    return _dependent(draw, cases, lambda rows: -rows[:-1].sum(axis=0))


@st.composite
def zero_rows(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """A constraint whose gradient vanishes, as of an episode in which nothing happened."""
    return _dependent(draw, cases, lambda rows: np.zeros_like(rows[0]))


@st.composite
def cone_of_zero(draw: st.DrawFn) -> DirectionProblem:
    """e₁ … eₙ and −Σ wᵢeᵢ span the space positively, so {d : J d ≥ 0} = {0}: d = 0 whatever g. Davis 1954."""
    n = draw(any_of((2, 1) if are_small() else (2, 3, 1, 4, 7)))
    jacobian = np.vstack([np.eye(n), -integers(draw, 1, n, lowest=1)])
    return DirectionProblem(integers(draw, n), jacobian)


@st.composite
def pinched(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """{d : J d ≥ b} is one point, or as flat as its equalities: independent rows Aᵢd = bᵢ, each said in some way.

    As an equality, by two inequalities that oppose each other, or all together by one more row −Σ wᵢAᵢ d ≥ −Σ wᵢbᵢ.
    """
    case = draw(any_of(members("cases", cases, SHIFTED_CASES)))
    r, more = draw(any_of((1, 2, 3, 6, 11))), draw(any_of((0, 0, 0, 0, 0, 1, 3, 29)))
    r, more, most_rows = (min(r, 2), min(more, 1), 3) if are_small() else (r, more, MOST_ROWS)
    n = r + more
    rows, point, is_equality = integer_rows(draw, n, r, r), integers(draw, n), equalities(draw, r, case)
    back = -rows[~is_equality]
    if len(back) > 1 and (r + len(back) > most_rows or draw(st.booleans())):
        back = picks(draw, len(back), (1.0, 2.0, 3.0))[None, :] @ back
    jacobian = np.vstack([rows, back])
    equality = np.append(is_equality, np.zeros(len(back), dtype=np.bool_))
    return DirectionProblem(integers(draw, n), jacobian, jacobian @ point, equality)


@st.composite
def nearly_dependent(
    draw: st.DrawFn,
    cases: Collection[Case] = ALL_CASES,
    *,
    angle: NumberChoice = (1e-7, 1e-1),
    opposing: bool = True,
) -> DirectionProblem:
    """Two rows at a small angle (rad) from opposing, or from parallel: a Gram matrix sees its square only."""
    n, m = shape(draw, least_rows=2, least_parameters=2)
    theta = chosen(draw, angle)
    first, second = np.linalg.qr(integers(draw, n, 2))[0].T
    jacobian = integers(draw, m, n)
    jacobian[0] = 5.0 * first
    jacobian[1] = 3.0 * ((-1.0 if opposing else 1.0) * np.cos(theta) * first + np.sin(theta) * second)
    return feasible_problem(draw, jacobian, kind_of(draw, cases))


@st.composite
def feasible_gradients(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """J g ≥ b, = b on E, exactly: then d = g."""
    n, m = shape_for(draw, cases)
    jacobian, g = integers(draw, m, n), integers(draw, n)
    case = kind_of(draw, cases)
    equality = equalities(draw, m, case)
    factors = row_factors(draw, m, draw(_EXACT_ROW_SCALES))
    if case == Case.TANGENT:  # (gᵀg) Jᵢ − (Jᵢg) gᵀ is orthogonal to g, in integers
        jacobian = (g @ g) * jacobian - np.outer(jacobian @ g, g)
    slack = draw(any_of((0.0, 1.0, 30.0)))
    if case == Case.CONE:
        jacobian = np.where(jacobian @ g < 0, -1.0, 1.0)[:, None] * jacobian
    bound = jacobian @ g - np.where(equality, 0.0, slack) if case.is_shifted else np.zeros(m)
    return rescaled(DirectionProblem(g, jacobian, bound, equality), 1.0, factors)


@st.composite
def weakly_infeasible(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """Opposing rows that miss each other by 1e-4 … 1e-12: tolerances decide, and an answer may claim neither."""
    members("cases", cases, SHIFTED_CASES)
    n, m = shape(draw, least_rows=2)
    jacobian = integers(draw, m, n)
    jacobian[0, 0] = 3.0
    jacobian[1] = -jacobian[0]
    bound = jacobian @ integers(draw, n)
    bound[0] += 10.0 ** -draw(between(4, 12))
    equality = np.full(m, Case.BOUNDS not in cases and Case.MIXED not in cases)
    return DirectionProblem(integers(draw, n), jacobian, bound, equality)


@st.composite
def far_bounds(draw: st.DrawFn, cases: Collection[Case] = ALL_CASES) -> DirectionProblem:
    """One inequality is slack by 1e6 … 1e15 beside others that bind."""
    members("cases", cases, (Case.BOUNDS, Case.MIXED))
    shifted = [case for case in cases if case.is_shifted or case.is_limit]
    problem = draw(direction_problems(conflict=(0, 2), cases=shifted))
    bound = problem.bound.copy()
    bound[np.flatnonzero(~problem.equality)[-1:]] = -(10.0 ** draw(between(6, 15)))
    return DirectionProblem(problem.gradient, problem.jacobian, bound, problem.equality)


def _in_geometry(geometry: Case) -> Callable[[Collection[Case]], Problems]:
    return lambda cases: problems_in_geometry(cases=[*cases, geometry])


WELL_POSED = (
    Family("integer", "ties, zeros and dependence come up often", lambda cases: direction_problems(cases=cases)),
    Family(
        "binding",
        "the optimum is planted with up to min(n, m) constraints tight",
        binding_rows,
    ),
    Family(
        "conditioned",
        "σ₁/σᵣ up to 1e6",
        lambda cases: direction_problems(conditioning=(1.0, 1e6), cases=cases),
    ),
    Family(
        "rank-deficient",
        "fewer independent rows than there are rows and parameters",
        rank_deficient_rows,
        several_rows=True,
    ),
    Family("duplicate rows", "multipliers are not unique, the direction is", duplicate_rows, several_rows=True),
    Family("opposing rows", "the cone has no interior", opposing_rows, several_rows=True),
    Family("sum to zero", "the paper's own Δ² + Δ³ + Δ⁴ = 0", sum_to_zero, several_rows=True),
    Family("zero rows", "nothing was learnt about a constraint", zero_rows),
    Family(
        "row scales",
        "gradients of different rewards differ by 1e12 in length",
        lambda cases: direction_problems(row_scale=any_of((1e6, 1e12)), cases=cases),
    ),
    Family(
        "scaled",
        "policy gradients are small; absolute tolerances then return g unchanged",
        lambda cases: direction_problems(scale=any_of((1e-8, 1e-4, 1e8)), cases=cases),
    ),
    Family(
        "cone of zero",
        "the answer is 0 whatever g",
        lambda cases: cone_of_zero(),  # noqa: ARG005
        (Case.CONE,),
        several_rows=True,
    ),
    Family(
        "pinched",
        "one point is feasible, or a flat set: nothing has room, and yet it is not infeasible",
        pinched,
        SHIFTED_CASES,
        several_rows=True,
        weight=3,
    ),
    Family(
        "nearly opposing",
        "1e-7 … 1e-1 rad: the hard family",
        lambda cases: nearly_dependent(cases),
        several_rows=True,
    ),
    Family(
        "nearly parallel",
        "1e-7 … 1e-1 rad: a rank decision merges two rows",
        lambda cases: nearly_dependent(cases, opposing=False),
        several_rows=True,
    ),
    Family("no constraints", "m = 0: d = g", lambda cases: direction_problems(3, 0, cases=cases)),
    Family("feasible gradient", "nothing to do: d = g", feasible_gradients),
    Family(
        "in a metric",
        "M⁻¹ is easily forgotten, or put twice",
        _in_geometry(Case.METRIC),
        geometry=Case.METRIC,
        weight=2,
    ),
    Family("in a ball", "constrained policy optimization", _in_geometry(Case.RADIUS), geometry=Case.RADIUS, weight=2),
    Family(
        "feasible gradient in a ball",
        "as a rule the constraints do not bind: d = radius g/‖g‖",
        lambda cases: in_some_ball(feasible_gradients(cases)),
        geometry=Case.RADIUS,
        only=Case.BALL,
        weight=2,
    ),
)

HOSTILE = (
    Family(
        "almost opposing",
        "1e-12 … 1e-7 rad: beyond what float64 certifies",
        lambda cases: nearly_dependent(cases, angle=(1e-12, 1e-7)),
        several_rows=True,
    ),
    Family(
        "extreme scales",
        "‖v‖² over- or underflows",
        lambda cases: direction_problems(scale=any_of((1e-100, 1e100)), cases=cases),
    ),
    Family("weakly infeasible", "1e-12 … 1e-4 from feasible", weakly_infeasible, SHIFTED_CASES, several_rows=True),
    Family("far bounds", "a huge number that must not set the scale", far_bounds, (Case.BOUNDS, Case.MIXED)),
    Family("infeasible", "no direction exists", lambda cases: infeasible_problems(cases=cases), SHIFTED_CASES),
    Family("out of reach", "the ball misses the constraints", problems_out_of_reach, SHIFTED_CASES, Case.RADIUS),
    Family(
        "touching",
        "the ball meets the constraints in one point, where no multiplier need be finite, or nearly so",
        lambda cases: in_some_ball(direction_problems(cases=cases), factors=TOUCHING),
        SHIFTED_CASES,
        Case.RADIUS,
    ),
)


def well_posed_problems(cases: Collection[Case] = ALL_CASES) -> Problems:
    """All families whose answer float64 determines, those of the given cases."""
    return _mixed(WELL_POSED, tuple(cases))


def hostile_problems(cases: Collection[Case] = ALL_CASES) -> Problems:
    """Everything: well-posed, beyond float64, infeasible, and nearly so."""
    return _mixed((*WELL_POSED, *HOSTILE), tuple(cases))


@cache  # a strategy is examined by Hypothesis when it is first drawn from, which takes longer than the draw
def _mixed(families: tuple[Family, ...], cases: tuple[Case, ...]) -> Problems:
    """A problem of any of the families, in any order, often with gradients short or long or rows of other lengths."""
    constraints = constraints_of(cases)
    limit = [case for case in constraints if case.is_limit]
    applicable = [
        (family, [case for case in family.cases if case in constraints]) for family in families if family.serves(cases)
    ]
    return _varied(
        st.one_of([family.problems([*own, *limit]) for family, own in applicable if own for _ in range(family.weight)])
    )


@st.composite
def _varied(draw: st.DrawFn, problems: Problems) -> DirectionProblem:
    problem = draw(problems)
    first, second, third = parts(draw, 3, problem.m)
    order = orders(first, problem.m)
    if (np.diff(order) != 1).any():
        rows = {name: getattr(problem, name)[order] for name in ("jacobian", "bound", "equality")}
        problem = varied(problem, **rows)
    scale, row_scale = pick(second, _EXACT_UNITS)
    return rescaled(problem, scale, row_factors(third, problem.m, row_scale))


def _dependent(
    draw: st.DrawFn, cases: Collection[Case], last_row: Callable[[np.ndarray], np.ndarray]
) -> DirectionProblem:
    """Integer rows of which the last is a function of the others, in any order."""
    n, m = shape_for(draw, cases, least_rows=2)
    jacobian = integer_rows(draw, n, m)
    jacobian[-1] = last_row(jacobian)
    jacobian = jacobian[orders(draw, m)]
    case = kind_of(draw, cases)
    return feasible_problem(draw, jacobian, case)


FAMILIES = {family.name: family for family in (*WELL_POSED, *HOSTILE)}
