"""Problems in a metric, and in a ball that meets their constraints or misses them: made of those without."""

from collections.abc import Collection

import numpy as np
from hypothesis import strategies as st

from ..direction import Status
from ..problem import DirectionProblem
from ..published.euclidean import euclidean
from ..solvers import SOLVERS
from .draws import LARGEST_ENTRY, MOST_PARAMETERS, any_of, integers, members, picks
from .law import length, varied
from .strategies import ALL_CASES, GEOMETRIES, SHIFTED_CASES, Case, direction_problems, shape_for

Problems = st.SearchStrategy[DirectionProblem]

# Units of single parameters differ by this.
_UNITS = (1.0, 2.0, 0.5, 16.0, 1 / 16)
# Radii, in units of the length of the shortest direction that the constraints allow; the huge ones are as people
# write "none".
HUGE = (1e3, 1e6)
REACHING = (2.0, 1.25, 8.0, *HUGE)
_MISSING = (0.5, 0.125)
# A few digits from touching: κ is as large as their root is small.
TOUCHING = (1.0, 1.0 + 1e-3, 1.0 + 1e-6, 1.0 + 1e-9)


def constraints_of(cases: Collection[Case]) -> list[Case]:
    """The kinds of constraints among the cases, all if none is named; and, where it is named, that there is one."""
    kinds = [case for case in cases if case in ALL_CASES] or list(ALL_CASES)
    return kinds + [case for case in cases if case == Case.ONE_ROW]


@st.composite
def problems_in_geometry(
    draw: st.DrawFn, n: int | None = None, m: int | None = None, *, cases: Collection[Case] = GEOMETRIES
) -> DirectionProblem:
    """Small integer problems in a metric or, with Case.RADIUS, mostly in a ball that meets the constraints."""
    size = shape_for(draw, cases) if n is None or m is None else (n, m)
    problem = draw(direction_problems(*size, cases=constraints_of(cases)))
    kind = draw(any_of(members("cases", cases, GEOMETRIES)))
    if kind == Case.METRIC:
        return varied(problem, metric=_metric(draw, problem.n))
    if draw(st.booleans()):
        problem = varied(problem, metric=_metric(draw, problem.n))
    return varied(problem, radius=_radius(draw, problem, REACHING))


@st.composite
def problems_out_of_reach(draw: st.DrawFn, cases: Collection[Case] = (*SHIFTED_CASES, Case.RADIUS)) -> DirectionProblem:
    """The ball misses the constraints by half the distance at least; feasible without it, if 0 is not allowed."""
    shifted = [case for case in constraints_of(cases) if case.is_shifted]
    problem = draw(direction_problems(*shape_for(draw, cases), cases=shifted))
    bound = problem.bound.copy()
    asked = problem.jacobian[0] @ np.ones(problem.n)
    if not (np.where(problem.equality, bound != 0, bound > 0)).any():  # ask for something that is there
        jacobian = problem.jacobian.copy()
        jacobian[0] = np.ones(problem.n) if asked == 0 else jacobian[0]
        bound[:], bound[0] = np.where(problem.equality, 0.0, -np.inf), 7.0
        alone = np.arange(problem.m) == 0
        problem = varied(problem, jacobian=np.where(alone[:, None], jacobian, 0.0), bound=bound)
    if draw(st.booleans()):
        problem = varied(problem, metric=_metric(draw, problem.n))
    return varied(problem, radius=_radius(draw, problem, _MISSING))


@st.composite
def in_some_metric(draw: st.DrawFn, problems: Problems) -> DirectionProblem:
    """Any of the problems, in a metric."""
    problem = draw(problems)
    return varied(problem, metric=_metric(draw, problem.n))


@st.composite
def in_some_ball(draw: st.DrawFn, problems: Problems, *, factors: tuple[float, ...] = REACHING) -> DirectionProblem:
    """Any of the problems, in a ball and perhaps a metric; factors: radii, in units of the shortest direction."""
    problem = draw(problems)
    if draw(st.booleans()):
        problem = varied(problem, metric=_metric(draw, problem.n))
    return varied(problem, radius=_radius(draw, problem, factors))


def _metric(draw: st.DrawFn, n: int) -> np.ndarray:
    """A diagonal of powers of two, or TTᵀ + I with T of small integers, in units of any kind; T is thin for large n."""
    units = picks(draw, n, _UNITS)
    if n > MOST_PARAMETERS or draw(st.booleans()):  # the referee judges by a full metric in n² exact products
        return units**2
    root = integers(draw, n, n if n <= LARGEST_ENTRY else 3, largest=2)
    metric: np.ndarray = (root @ root.T + np.eye(n)) * units * units[:, None]
    return metric


def _radius(draw: st.DrawFn, problem: DirectionProblem, factors: tuple[float, ...]) -> float:
    """A factor times the length of the shortest direction; any radius where that is 0."""
    flat = euclidean(problem)
    shortest = SOLVERS["active-set"].solve(varied(flat, gradient=np.zeros(problem.n)))
    size = length(shortest.value) if shortest.status == Status.OPTIMAL else 0.0
    factor: float = draw(any_of(factors))
    return factor * (size or draw(any_of((1.0, 0.25, 5.0))))
