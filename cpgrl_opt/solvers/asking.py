"""Asking somebody else's solver: it is handed arrays of its own, and what it returns is checked for its form.

A solver that writes to the arrays of a problem would be judged by what it made of them. So it gets a copy, read-only:
NumPy refuses to write to it; what LAPACK writes all the same (`scipy.linalg.solve(A, b, overwrite_b=True)` does not
look at the flag), or what is written after the flag was turned, stays in the copy. Our own solvers get the arrays
themselves, read-only too.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from ..answers import as_direction, as_directions
from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch

Answer = TypeVar("Answer")

_OURS: set[type] = set()


def vouch_for(kinds: Iterable[type]) -> None:
    """Solvers of these classes, not of their subclasses, get the arrays themselves and are believed in their form."""
    _OURS.update(kinds)


def is_ours(solver: Any) -> bool:
    """Whether somebody vouched for the solver's class."""
    return type(solver) in _OURS


def ask(solver: Any, problem: DirectionProblem) -> Direction:
    """solver.solve(problem); ValueError that names a solver which writes to the problem or returns no direction."""
    if is_ours(solver):
        answer: Direction = solver.solve(problem)
        return answer
    with _writing_explained(solver):
        found = solver.solve(problem.copied())
    return in_form(solver, as_direction, found, problem.n, problem.m)


def ask_batch(solver: Any, problems: ProblemBatch) -> DirectionBatch:
    """solver.solve_batch(problems), as `ask`; of at least one problem."""
    if is_ours(solver):
        answers: DirectionBatch = solver.solve_batch(problems)
        return answers
    with _writing_explained(solver):
        found = solver.solve_batch(problems.copied())
    count, m, n = problems.jacobian.shape
    return in_form(solver, as_directions, found, count, n, m)


@contextmanager
def _writing_explained(solver: Any) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        if "read-only" not in str(error):  # NumPy's word for it, and Cython's
            raise
        raise ValueError(
            f"solver should leave the arrays of a problem as they are, and work on copies; found {solver!r}, which "
            f"wrote to one: {error}"
        ) from error


def in_form(solver: Any, form: Callable[..., Answer], *answer_and_shape: Any) -> Answer:
    """form(answer, …), its ValueError with the solver's name."""
    try:
        return form(*answer_and_shape)
    except ValueError as error:
        raise ValueError(f"{error}, from {solver!r}") from None
