"""What a direction solver is, and how to ask one that declares little."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..certify import certify
from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch, nothing
from ..validation import require_count
from .asking import ask, ask_batch
from .facts import facts_of
from .infeasibility import infeasible_direction


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


def refereed(
    problems: ProblemBatch | Sequence[DirectionProblem], answers: DirectionBatch, tolerance: float
) -> DirectionBatch:
    """The answers with every claim of OPTIMAL or INFEASIBLE that the referee rejects turned into UNCERTIFIED.

    They are copied as contiguous float64 arrays. See `certify` for what stands.
    """
    answers = answers.owned()
    if len(answers) != len(problems):
        raise ValueError(f"answers should be one for each of {len(problems)} problems; found {len(answers)}")
    if len(answers) == 0:
        return answers
    pairs = zip(problems, answers, strict=True)
    return DirectionBatch.stack([certify(*pair, tolerance, infeasible_direction) for pair in pairs])


class MissingPackageError(ImportError):
    """A solver's package is not installed; the message is the command that installs it."""

    def __init__(self, solver: str, package: str, extra: str) -> None:
        super().__init__(
            f"solver {solver!r} needs the package {package}, which is not installed; "
            f"type: pip install 'cpgrl-opt[{extra}]'"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """As its message, and notes: a worker process raises it too, and pickle would call __init__ with that alone."""
        return _rebuilt, (type(self), str(self)), vars(self)


def _rebuilt(kind: type[MissingPackageError], message: str) -> MissingPackageError:
    error = kind.__new__(kind, message)
    ImportError.__init__(error, message)
    return error


class UnusablePackageError(MissingPackageError):
    """A solver's package is installed, yet cannot be imported, e.g. for want of a system library; says why."""

    def __init__(self, solver: str, package: str, reason: ImportError) -> None:
        ImportError.__init__(
            self, f"solver {solver!r} needs the package {package}, which is installed but cannot be imported: {reason}"
        )


def solve_stacked(
    solver: DirectionSolver, problems: ProblemBatch | Sequence[DirectionProblem], *, threads: int = 1
) -> DirectionBatch:
    """What the solver claims of B problems of one shape, by its own `solve_batch` where it has one, else in a loop.

    A problem that it declares not to take is UNSUPPORTED, unasked. What it raises, it raises; ValueError where it
    writes to the problems or returns no directions. Of a batch of no problems it is not asked.
    """
    require_count("threads", threads)
    if len(problems) == 0:
        return no_answers(problems)
    problems = ProblemBatch.stack(problems)
    if (parts := min(threads, len(problems))) == 1:
        return _solve_part(solver, problems)
    ends = [len(problems) * k // parts for k in range(parts + 1)]
    from concurrent.futures import ThreadPoolExecutor  # with `logging`: 6 ms that few need

    with ThreadPoolExecutor(parts) as pool:
        pieces = pool.map(lambda k: _solve_part(solver, problems[ends[k] : ends[k + 1]]), range(parts))
        return DirectionBatch.join(list(pieces))


def _solve_part(solver: DirectionSolver, problems: ProblemBatch) -> DirectionBatch:
    facts = facts_of(solver)
    if facts.declines_by_itself:
        return ask_batch(solver, problems)
    taken = np.array([facts.supports(problem) for problem in problems], dtype=np.bool_)
    if not facts.has_batch:
        pairs = zip(problems, taken, strict=True)
        return DirectionBatch.stack([ask(solver, each) if takes else unsupported(each) for each, takes in pairs])
    if taken.all():
        return ask_batch(solver, problems)
    answers = DirectionBatch.stack([unsupported(problem) for problem in problems])
    if not taken.any():
        return answers
    return answers.replaced(taken, ask_batch(solver, problems.chosen(taken)))


def no_answers(problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
    """The answers to a batch of no problems; ValueError for a sequence of none, which has no shape."""
    none = ProblemBatch.stack(problems)
    zeros = np.zeros(0, np.int64)
    return DirectionBatch(np.zeros(none.gradient.shape), np.zeros(none.bound.shape), zeros, zeros.copy())


def unsupported(problem: DirectionProblem) -> Direction:
    """Zeros that claim nothing."""
    return nothing(problem, Status.UNSUPPORTED)
