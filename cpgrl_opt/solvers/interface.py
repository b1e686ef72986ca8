"""What a direction solver is, and how it is asked, somebody else's with care.

A solver that writes to the arrays of a problem would be judged by what it made of them. So it gets a copy, read-only:
NumPy refuses to write to it; what LAPACK writes all the same (`scipy.linalg.solve(A, b, overwrite_b=True)` does not
look at the flag), or what is written after the flag was turned, stays in the copy. Our own solvers get the arrays
themselves, read-only too. What somebody else's solver returns is checked for its form.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from ..answers import as_direction, as_directions
from ..certify import certify
from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch, nothing
from ..validation import require_count
from .facts import facts_of
from .infeasibility import infeasible_direction

Answer = TypeVar("Answer")

# Solvers of these classes, not of their subclasses, get the arrays themselves and are believed in their form.
TRUSTED: set[type] = set()


@runtime_checkable
class DirectionSolver(Protocol):
    """A frozen dataclass of settings with one method. Third parties need not import this.

    Optional attributes: `tolerance` (the worst KKT residual of an OPTIMAL answer, ≤ 1e-3; 1e-6 is assumed),
    `supports(problem) -> bool` (undeclared: equalities, cone and bounds), `solve_batch(problems)`,
    `guarantee` and `source` (one line each, for the table of solvers), `takes_geometry` (True: problems with a metric
    or a radius too; `WithGeometry(solver)` makes any solver take them), `declines_by_itself` (True: its `solve_batch`
    calls UNSUPPORTED what `supports` does not take, so that no loop over the problems need ask before),
    `finds_infeasible` (False: it cannot tell that no direction meets the constraints, and claims nothing there),
    `dtype` ("float32": it computes in float32, and the conformance kit gives it problems that float32 holds).
    """

    def solve(self, problem: DirectionProblem) -> Direction:
        """The projection of g onto {d : Jᵢd ≥ bᵢ, Jᵢd = bᵢ on E}, with multipliers and a status; see `Status`."""
        ...


def ask(solver: Any, problem: DirectionProblem) -> Direction:
    """solver.solve(problem); ValueError that names a solver which writes to the problem or returns no direction."""
    answer: Direction = _ask(solver, "solve", as_direction, problem, problem.n, problem.m)
    return answer


def ask_batch(solver: Any, problems: ProblemBatch) -> DirectionBatch:
    """solver.solve_batch(problems), as `ask`; of at least one problem."""
    count, m, n = problems.jacobian.shape
    answers: DirectionBatch = _ask(solver, "solve_batch", as_directions, problems, count, n, m)
    return answers


def _ask(solver: Any, name: str, form: Callable[..., Any], problems: Any, *shape: int) -> Any:
    method = getattr(solver, name)
    if type(solver) in TRUSTED:
        return method(problems)
    try:
        found = method(problems.copied())
    except ValueError as error:
        if "read-only" not in str(error):  # NumPy's word for it, and Cython's
            raise
        raise ValueError(
            f"solver should leave the arrays of a problem as they are, and work on copies; found {solver!r}, which "
            f"wrote to one: {error}"
        ) from error
    return check_form(solver, form, found, *shape)


def check_form(solver: Any, form: Callable[..., Answer], *answer_and_shape: Any) -> Answer:
    """form(answer, …), its ValueError with the solver's name."""
    try:
        return form(*answer_and_shape)
    except ValueError as error:
        raise ValueError(f"{error}, from {solver!r}") from None


def solve_stacked(
    solver: DirectionSolver, problems: ProblemBatch | Sequence[DirectionProblem], *, threads: int = 1
) -> DirectionBatch:
    """What the solver claims of B problems of one shape, by its own `solve_batch` where it has one, else in a loop.

    A problem that it declares not to take is UNSUPPORTED, unasked. What it raises, it raises; ValueError where it
    writes to the problems or returns no directions. Of a batch of no problems it is not asked.
    """
    require_count("threads", threads)
    problems = ProblemBatch.stack(problems)
    if len(problems) == 0:
        return no_answers(problems)
    if (parts := min(threads, len(problems))) == 1:
        return _solve_part(solver, problems)
    from concurrent.futures import ThreadPoolExecutor  # with `logging`: 6 ms that few need

    pieces = map(problems.select, np.array_split(np.arange(len(problems)), parts))
    with ThreadPoolExecutor(parts) as pool:
        return DirectionBatch.join(list(pool.map(partial(_solve_part, solver), pieces)))


def _solve_part(solver: DirectionSolver, problems: ProblemBatch) -> DirectionBatch:
    facts = facts_of(solver)
    if facts.declines_by_itself:
        return ask_batch(solver, problems)
    answers, taken = list(map(unsupported, problems)), np.flatnonzero([facts.supports(each) for each in problems])
    if facts.has_batch and taken.size:
        found: Sequence[Direction] = ask_batch(solver, problems.select(taken))
    else:
        found = [ask(solver, problems[k]) for k in taken.tolist()]
    for k, answer in zip(taken, found, strict=True):
        answers[k] = answer
    return DirectionBatch.stack(answers)


def referee(
    problems: ProblemBatch | Sequence[DirectionProblem], answers: DirectionBatch, tolerance: float
) -> DirectionBatch:
    """The answers with every claim of OPTIMAL or INFEASIBLE that the referee rejects turned into UNCERTIFIED.

    They are copied as contiguous float64 arrays. See `certify` for what stands.
    """
    if len(answers) != len(problems):
        raise ValueError(f"answers should be one for each of {len(problems)} problems; found {len(answers)}")
    if len(answers) == 0:
        return answers
    pairs = zip(problems, DirectionBatch.stack(answers), strict=True)
    return DirectionBatch.stack([certify(*pair, tolerance, infeasible_direction) for pair in pairs])


def no_answers(problems: ProblemBatch) -> DirectionBatch:
    """The answers to a batch of no problems."""
    zeros = np.zeros(0, np.int64)
    return DirectionBatch(np.zeros(problems.gradient.shape), np.zeros(problems.bound.shape), zeros, zeros.copy())


def unsupported(problem: DirectionProblem) -> Direction:
    """Zeros that claim nothing."""
    return nothing(problem, Status.UNSUPPORTED)
