"""Which problems a solver takes: its `supports` is asked about each kind in each of the usual shapes, else in all."""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..problem import DirectionProblem
from ..problems.case import ALL_CASES, Case
from ..solvers.interface import DirectionSolver
from .draws import MOST_PARAMETERS, MOST_ROWS, SHAPES
from .law import takes, vary

_MOST_KNOWN = 32  # solvers; each item of a test asks about the same few again
_known: list[tuple[DirectionSolver, "Domain"]] = []


@dataclass(frozen=True)
class Domain:
    """What a solver takes: kinds of problems, and the shapes (n, m) if it takes none of the usual ones."""

    cases: tuple[Case, ...] = ()
    rare_shapes: tuple[tuple[int, int], ...] = ()


def supported_cases(solver: DirectionSolver) -> list[Case]:
    """The cases of which the solver's `supports` takes an example; without a `supports`, the five of constraints.

    Parameters
    ----------
    solver
        What is asked, about each kind of problem in each usual shape.

    Returns
    -------
    list of Case
        ONE_ROW is among them if no example that it takes has more than one row, BALL if all have a radius.

    Raises
    ------
    LawError
        Where `supports` raises or contradicts itself.
    """
    return list(find_domain(solver).cases)


def domain_of(solver: DirectionSolver) -> Domain:
    """`find_domain`, remembered for this very object until `forget_domain`: hundreds of examples are asked about."""
    for known, domain in _known:
        if known is solver:
            return domain
    _known.append((solver, find_domain(solver)))
    del _known[:-_MOST_KNOWN]
    return _known[-1][1]


def forget_domain(solver: DirectionSolver) -> None:
    """Have `domain_of` ask anew: the solver may have been changed."""
    _known[:] = [each for each in _known if each[0] is not solver]


def find_domain(solver: DirectionSolver) -> Domain:
    """Ask `supports` about each example, of the usual shapes first. Raises as `supported_cases`."""
    taken = [problem for problem in _examples(_usual()) if takes(solver, problem)]
    shapes: tuple[tuple[int, int], ...] = ()
    if not taken:
        taken = [problem for problem in _examples(_rare()) if takes(solver, problem)]
        shapes = tuple(dict.fromkeys((problem.n, problem.m) for problem in taken))
    if not taken:
        return Domain()
    constraints = {_case_of_example(problem) for problem in taken}
    found = {
        **{case: case in constraints for case in ALL_CASES},
        Case.METRIC: any(problem.metric is not None for problem in taken),
        Case.RADIUS: any(problem.radius is not None for problem in taken),
        Case.ONE_ROW: all(problem.m <= 1 for problem in taken),
        Case.BALL: all(problem.radius is not None for problem in taken),
    }
    return Domain(tuple(case for case in found if found[case]), shapes)


@cache
def _usual() -> tuple[tuple[int, int], ...]:
    return tuple(dict.fromkeys((*SHAPES, *((n, 1) for n, _ in SHAPES))))


@cache
def _rare() -> tuple[tuple[int, int], ...]:
    every = ((n, m) for n in range(1, MOST_PARAMETERS + 1) for m in range(1, MOST_ROWS + 1))
    return tuple(shape for shape in every if shape not in _usual())


def case_of(problem: DirectionProblem) -> Case:
    """The kind of constraints, of the rows that are switched on."""
    on = problem.bound > -np.inf
    equality, is_shifted = problem.equality[on], bool(problem.bound[on].any())
    if equality.any() and not equality.all():
        return Case.MIXED
    if equality.any():
        return Case.AFFINE if is_shifted else Case.TANGENT
    return Case.BOUNDS if is_shifted else Case.CONE


_case_of_example = cache(case_of)  # the examples are the same for every law


def traits_of(problem: DirectionProblem) -> set[Hashable]:
    """What a solver's limits are usually about: each by its name and value."""
    return {
        ("n", problem.n),
        ("m", problem.m),
        ("rows that are on", int((problem.bound > -np.inf).sum())),
        ("case", case_of(problem)),
        ("metric", problem.metric is not None),
        ("radius", problem.radius is not None),
    }


@cache
def _examples(shapes: tuple[tuple[int, int], ...]) -> tuple[DirectionProblem, ...]:
    """Each kind of constraints in each shape: as it is, in a metric and in a ball; b of either sign, and b ≤ 0."""
    rng = np.random.default_rng(0)
    problems: list[DirectionProblem] = []
    for n, m in shapes:
        for problem in _of_shape(n, m, rng):
            problems += [
                problem,
                vary(problem, metric=rng.choice([0.5, 1.0, 2.0], n)),
                vary(problem, radius=100.0 * n),
            ]
    return tuple(problems)


def _of_shape(n: int, m: int, rng: np.random.Generator) -> Iterator[DirectionProblem]:
    for case in ALL_CASES:
        if case == Case.MIXED and m < 2:
            continue
        equality = np.full(m, case in (Case.TANGENT, Case.AFFINE))
        if case == Case.MIXED:
            equality[rng.permutation(m)[: m // 2]] = True
        for point in (rng.integers(1, 9, n), np.zeros(n))[: 2 if case in (Case.BOUNDS, Case.MIXED) else 1]:
            jacobian = rng.integers(1, 9, (m, n)) * rng.choice([-1.0, 1.0], (m, n))
            slack = np.where(equality, 0.0, rng.integers(1, 9, m))
            bound = jacobian @ point - slack if case.is_shifted else np.zeros(m)
            yield DirectionProblem(rng.integers(1, 9, n), jacobian, bound, equality)
