"""The table of laws: each check with the problems, and whatever else, that it is put to.

Laws whose theorem needs a feasible or an infeasible problem are only given such; see each check for its statement.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from hypothesis import strategies as st

from ..problem import DirectionProblem
from ..problems.assembly import rescale, vary
from ..problems.case import ALL_CASES, GEOMETRIES, LIMITS, SHIFTED_CASES, Case
from ..problems.geometry import HUGE, Make, in_ball, in_metric, out_of_reach
from ..problems.infeasible import infeasible
from ..problems.regular import feasible_gradient
from ..solvers.facts import facts_of
from ..solvers.interface import DirectionSolver
from . import claims, invariance, optimality, projections, sequences, shared_state, side_effects, timing
from .domain import domain_of
from .drawn_source import DrawnSource, draw_with
from .draws import any_of, are_small, between, integers, orders
from .law import Outcome
from .strategies import (
    constraints_of,
    direction_problems,
    hostile_problems,
    infeasible_problems,
    problems_in_geometry,
    row_factors,
    well_posed_problems,
)

Arguments = st.SearchStrategy[dict[str, Any]]
Problems = st.SearchStrategy[DirectionProblem]
_ANY = tuple(Case)
_SEVERAL_ROWS = tuple(case for case in Case if case != Case.ONE_ROW)
_WITH_INEQUALITIES = (Case.CONE, Case.BOUNDS, Case.MIXED, *GEOMETRIES)
_BATCH_SIZES = (0, 0, 0, 0, 0, 6, 17, 64)
_EXTREME_UNITS = ((1.0, 1e150), (1e100, 1.0), (1e-100, 1.0), (1.0, 1.0))
_PROJECTIONS = (*ALL_CASES, Case.METRIC, Case.ONE_ROW)


@dataclass(frozen=True)
class Law:
    """A check, and `arguments`: from the cases that a solver takes to a strategy for all arguments but the solver.

    cases: the kinds of problems that the law is about; a limit is among them if it says something about problems so
    limited. needs: whether the solver has what the law is about; a solver that has not is excused.
    may_decline: the problems include some that no solver need answer. about_infeasible: none of them has an answer, so
    a solver that says `finds_infeasible = False` may decline. costs_time: a failure takes so long that a few are
    enough. part: of the examples asked for, since each is many calls.
    """

    check: Callable[..., Outcome]
    arguments: Callable[[Collection[Case]], Arguments]
    cases: tuple[Case, ...] = _ANY
    needs: Callable[[DirectionSolver], bool] | None = None
    may_decline: bool = False
    about_infeasible: bool = False
    costs_time: bool = False
    part: float = 1.0

    @property
    def name(self) -> str:
        """The check's name, by which expected failures are declared."""
        return self.check.__name__

    @property
    def statement(self) -> str:
        """The law itself, the first line of the check's docstring."""
        return (self.check.__doc__ or "").strip().splitlines()[0]

    def applies_to(self, solver: DirectionSolver) -> list[Case]:
        """The law's cases that the solver takes; none if it lacks what the law is about."""
        if self.needs is not None and not self.needs(solver):
            return []
        supported = domain_of(solver).cases
        if any(case.is_limit and case not in self.cases for case in supported):
            return []
        cases = [case for case in supported if case in self.cases]
        return cases if any(case in ALL_CASES for case in cases) else []


def _well_posed(cases: Collection[Case]) -> Arguments:
    return st.fixed_dictionaries({"problem": well_posed_problems(cases)})


def _feasible_gradients(cases: Collection[Case]) -> Arguments:
    return st.fixed_dictionaries({"problem": draw_with(feasible_gradient, constraints_of(cases))})


def _hostile(cases: Collection[Case]) -> Arguments:
    return st.fixed_dictionaries({"problem": hostile_problems(cases)})


def _infeasible(cases: Collection[Case]) -> Arguments:
    return st.fixed_dictionaries({"problem": _infeasible_problems(cases)})


def _infeasible_problems(cases: Collection[Case]) -> Problems:
    kinds = [case for case in constraints_of(cases) if case.is_shifted or case.is_limit]
    near, huge = partial(in_ball, of=infeasible), partial(in_ball, of=infeasible, factors=HUGE)
    if Case.BALL in cases:
        return st.one_of([draw_with(make, kinds) for make in (out_of_reach, out_of_reach, near, huge)])
    makes: list[Make] = [infeasible, infeasible]
    if Case.METRIC in cases:
        makes.append(partial(in_metric, of=infeasible))
    if Case.RADIUS in cases:
        makes += [out_of_reach, huge]
    return st.one_of([draw_with(make, kinds) for make in makes])


def _of_every_kind(cases: Collection[Case]) -> Arguments:
    return st.fixed_dictionaries({"problem": _problems_of_every_kind(cases)})


def _problems_of_every_kind(cases: Collection[Case]) -> Problems:
    """Well-posed ones, and as many that are infeasible or hostile: what a solver does there is out of its routine."""
    kinds = [well_posed_problems(cases), hostile_problems(cases)]
    if any(case.is_shifted for case in constraints_of(cases)):
        kinds.append(_infeasible_problems(cases))
    return st.one_of(kinds)


@st.composite
def _two_of_every_kind(draw: st.DrawFn, cases: Collection[Case]) -> dict[str, Any]:
    """Any two, or two with the same constraints: what a solver keeps from one call for the next is kept by shape."""
    problem = draw(_problems_of_every_kind(cases))
    if draw(st.booleans()):
        return {"problem": problem, "between": draw(_problems_of_every_kind(cases))}
    return {"problem": problem, "between": vary(problem, gradient=integers(draw, problem.n))}


def _with(
    name: str, argument: str, choose: Callable[[st.DrawFn, DirectionProblem], Any], least_rows: int = 0
) -> Callable[[Collection[Case]], Arguments]:
    """A well-posed problem, and one argument more that is drawn for it. name: of the source, which seeds the draws."""

    @st.composite
    def source(draw: st.DrawFn, cases: Collection[Case]) -> dict[str, Any]:
        problems = well_posed_problems(cases)
        problem = draw(problems.filter(lambda each: each.m >= least_rows) if least_rows else problems)
        return {"problem": problem, argument: choose(draw, problem)}

    source.__name__ = name
    return source


def _draw_gradient(draw: st.DrawFn, problem: DirectionProblem) -> np.ndarray:
    size = float(np.abs(problem.gradient).max()) or 1.0
    return problem.gradient + size / 9 * integers(draw, problem.n)


_with_gradient = _with("_with_gradient", "other", _draw_gradient)
_with_order = _with("_with_order", "order", lambda draw, problem: orders(draw, problem.m))
_with_factors = _with(
    "_with_factors",
    "factors",
    lambda draw, problem: row_factors(draw, problem.m, draw(any_of((3.0, 1e4, 1e6)))),
)
_with_factor = _with("_with_factor", "factor", lambda draw, _: draw(any_of((2.0, 0.3, 1e4, 1e-4, 1e8, 1e-8))))
_with_index = _with("_with_index", "row", lambda draw, problem: draw(between(0, problem.m - 1)), least_rows=1)
_with_row = _with("_with_row", "row", lambda draw, problem: integers(draw, problem.n))
_with_rotation = _with(
    "_with_rotation", "rotation", lambda draw, problem: np.linalg.qr(integers(draw, problem.n, problem.n))[0]
)


@st.composite
def _with_bad_number(draw: st.DrawFn, cases: Collection[Case]) -> dict[str, Any]:
    n, m = DrawnSource(draw, cases).shape()
    problem = draw(_problems_of_shape(n, m, cases))
    where = draw(any_of(("gradient", "jacobian", "bound")))
    values = (float("nan"), float("inf")) if where == "bound" else (float("nan"), float("inf"), float("-inf"))
    return {"problem": problem, "where": where, "value": draw(any_of(values))}


@st.composite
def _batches(draw: st.DrawFn, cases: Collection[Case]) -> dict[str, Any]:
    """One to four problems of one shape, infeasible ones among them, or up to 64 made of these."""
    n, m, problem, has_geometry = _draw_shape_and_geometry(draw, cases, without=3)
    if not has_geometry and Case.BALL not in cases and any(case.is_shifted for case in constraints_of(cases)):
        problem = st.one_of(problem, problem, infeasible_problems(n, m, cases=constraints_of(cases)))
    few, count = draw(st.lists(problem, min_size=1, max_size=4)), draw(any_of(_BATCH_SIZES))
    is_short = are_small() or has_geometry  # geometry takes ten times as long
    return {"problems": few if is_short else _lengthen(few, count)}


@st.composite
def _with_neighbours(draw: st.DrawFn, cases: Collection[Case]) -> dict[str, Any]:
    """A problem, one or two beside it, and as many others, some of them in extreme units; all in one geometry."""
    _, m, problems, _ = _draw_shape_and_geometry(draw, cases)
    problem, near, far = (draw(problems) for _ in range(3))
    beside = [near] * draw(between(1, 2))
    scale, row_scale = draw(any_of(_EXTREME_UNITS))
    others = [rescale(far, scale, row_factors(draw, m, row_scale)) for _ in beside]
    return {"problem": problem, "beside": beside, "others": others}


def _draw_shape_and_geometry(
    draw: st.DrawFn, cases: Collection[Case], without: int = 1
) -> tuple[int, int, Problems, bool]:
    """(n, m, problems of that shape, whether they have a geometry that not all have): of one batch, all or none.

    without: how often there is none, for each time that there is a metric, and a ball.
    """
    n, m = DrawnSource(draw, cases).shape()
    kind = draw(any_of([*[None] * without, *(case for case in cases if case.is_geometry)]))
    if kind is None or Case.BALL in cases:
        return n, m, _problems_of_shape(n, m, cases), False
    return n, m, problems_in_geometry(n, m, cases=[*constraints_of(cases), kind]), True


def _lengthen(problems: list[DirectionProblem], count: int) -> list[DirectionProblem]:
    """The same over and over, `count` in all, each time in another unit, so that no two have the same answer."""
    longer = list(problems)
    while len(longer) < count:
        problem, unit = problems[len(longer) % len(problems)], float(1 + len(longer) // len(problems))
        radius = None if problem.radius is None else unit * problem.radius
        longer.append(vary(problem, gradient=unit * problem.gradient, bound=unit * problem.bound, radius=radius))
    return longer


def _problems_of_shape(n: int, m: int, cases: Collection[Case]) -> st.SearchStrategy[DirectionProblem]:
    """Without a ball unless there is always one."""
    if Case.BALL in cases:
        return problems_in_geometry(n, m, cases=[*constraints_of(cases), Case.RADIUS])
    return direction_problems(n, m, cases=constraints_of(cases))


def _has_batch(solver: DirectionSolver) -> bool:
    return facts_of(solver).has_batch


def _has_warm_start(solver: DirectionSolver) -> bool:
    return facts_of(solver).has_warm_start


def _violates_in_part(solver: DirectionSolver) -> bool:
    """Rows that oppose each other, or a ball, can be violated more or less; one zero row is so by every direction."""
    cases = domain_of(solver).cases
    return Case.ONE_ROW not in cases or Case.BALL in cases


_TABLE = (
    Law(claims.check_claims_are_certified, _hostile, may_decline=True),
    Law(optimality.check_stationarity, _well_posed),
    Law(optimality.check_primal_feasibility, _well_posed),
    Law(optimality.check_dual_feasibility, _well_posed, (*_WITH_INEQUALITIES, *LIMITS)),
    Law(optimality.check_complementarity, _well_posed, (*_WITH_INEQUALITIES, *LIMITS)),
    Law(optimality.check_gradient_kept_when_feasible, _feasible_gradients, (*ALL_CASES, Case.ONE_ROW)),
    Law(optimality.check_zero_only_when_optimal, _well_posed),
    Law(optimality.check_agreement_with_enumeration, _well_posed),
    Law(projections.check_idempotence, _well_posed, _PROJECTIONS),
    Law(projections.check_non_expansiveness, _with_gradient, _PROJECTIONS),
    Law(projections.check_firm_non_expansiveness, _with_gradient, _PROJECTIONS),
    Law(projections.check_restoration_is_normal, _well_posed, (Case.AFFINE, Case.ONE_ROW)),
    Law(projections.check_symmetry, _with_gradient, (Case.TANGENT, Case.ONE_ROW)),
    Law(invariance.check_permutation, _with_order, _SEVERAL_ROWS),
    Law(invariance.check_row_scaling, _with_factors),
    Law(invariance.check_scaling, _with_factor),
    Law(invariance.check_duplicate_row, _with_index, _SEVERAL_ROWS),
    Law(invariance.check_inactive_row, _with_row, (*_WITH_INEQUALITIES, Case.BALL)),
    Law(invariance.check_rotation, _with_rotation),
    Law(claims.check_feasible_is_not_called_infeasible, _well_posed),
    Law(
        claims.check_infeasible_is_called_infeasible,
        _infeasible,
        (*SHIFTED_CASES, *GEOMETRIES, *LIMITS),
        about_infeasible=True,
    ),
    Law(
        claims.check_least_violation,
        _infeasible,
        (*SHIFTED_CASES, *GEOMETRIES, *LIMITS),
        needs=_violates_in_part,
        about_infeasible=True,
        part=0.8,
    ),
    Law(side_effects.check_non_finite_is_refused, _with_bad_number),
    Law(side_effects.check_input_is_unchanged, _of_every_kind, may_decline=True),
    Law(side_effects.check_answers_repeat, _two_of_every_kind, may_decline=True),
    Law(side_effects.check_silence, _of_every_kind, may_decline=True),
    Law(shared_state.check_answers_stay, _two_of_every_kind, may_decline=True),
    Law(shared_state.check_global_state_is_unchanged, _of_every_kind, may_decline=True),
    Law(shared_state.check_threads_do_not_meet, _two_of_every_kind, may_decline=True, part=0.3),
    Law(timing.check_time_is_in_proportion, _of_every_kind, may_decline=True, costs_time=True),
    Law(sequences.check_batch_is_loop, _batches, needs=_has_batch, may_decline=True, part=0.4),
    Law(
        sequences.check_neighbours_change_nothing,
        _with_neighbours,
        needs=_has_batch,
        may_decline=True,
        part=0.1,
    ),
    Law(
        sequences.check_warm_start_is_cold_start,
        _batches,
        needs=_has_warm_start,
        may_decline=True,
        part=0.4,
    ),
)
LAWS = {law.name: law for law in _TABLE}


def part_drawn(law: Law) -> float:
    """The largest part of the examples that any law of the same source asks for, since they share the draws."""
    return max([law.part, *(other.part for other in _TABLE if other.arguments is law.arguments)])
