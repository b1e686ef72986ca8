"""Recorded problems put to a solver again: as a family of problems, and in the order met, cold or warm-started."""

from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

from ..answers import as_direction
from ..arrays import Float, Int
from ..certify import kkt_residuals
from ..problem import DirectionProblem
from ..solvers import SOLVERS
from ..solvers.facts import facts_of
from ..solvers.infeasibility import infeasible_direction
from ..solvers.interface import DirectionSolver, check_form
from ..validation import require_count
from .contestants import DEFAULT_SOLVER
from .families import ProblemFamily
from .recording import Recording

_WELL_POSED = 1e-7  # smallest singular value of the active unit rows: below it float64 does not tell the direction
_CONSISTENT = 1e-9


@dataclass(frozen=True, eq=False)
class Replay:
    """What a solver did on each problem of a recording, in the recording's order; was_warm: from a warm start.

    status, iterations (as the method counts them): (P,); worst: (P,), the referee's worst residual; seconds: (P,) of
    CPU, each the least over the repetitions.
    """

    was_warm: bool
    status: Int[np.ndarray, "P"]
    iterations: Int[np.ndarray, "P"]
    worst: Float[np.ndarray, "P"]
    seconds: Float[np.ndarray, "P"]


def replay(recording: Recording, solver: DirectionSolver, *, warm: bool = False, repeats: int = 1) -> Replay:
    """Every sequence from its beginning, `repeats` times, in one workspace for each where the solver has such.

    warm: each problem but a sequence's first starts at the answer to the one before; ValueError for a solver without
    an explicit warm start, which is a method `session(n, m, warm_start=...)`.
    """
    if warm and not facts_of(solver).has_warm_start:
        raise ValueError(f"solver should have a session with warm_start to be replayed warm; found {solver!r}")
    require_count("repeats", repeats)
    count = len(recording)
    status, iterations = np.zeros((2, count), np.int64)
    done = Replay(warm, status, iterations, np.zeros(count), np.full(count, np.inf))
    for _ in range(repeats):
        for sequence in recording.sequences:
            first = recording.problems[sequence[0]]
            if facts_of(solver).has_warm_start:
                session: Any = solver
                asked = session.session(first.n, first.m, warm_start=warm)
            else:
                asked = solver
            for index in sequence:
                _solve(asked, recording.problems[index], index, done)
    return done


def _solve(solver: DirectionSolver, problem: DirectionProblem, index: int, done: Replay) -> None:
    own = problem.copied()  # what it does to its arrays, the referee does not see
    begun = process_time()
    answer = solver.solve(own)
    seconds = process_time() - begun
    direction = check_form(solver, as_direction, answer, problem.n, problem.m)
    done.status[index] = direction.status
    done.iterations[index] = direction.iterations
    done.worst[index] = kkt_residuals(problem, direction).worst
    done.seconds[index] = min(done.seconds[index], seconds)


def recorded_family(recording: Recording, name: str) -> ProblemFamily:
    """The recording's problems, drawn evenly, as a family of the comparison.

    feasible: whether every problem's active rows can be met with equality, in its ball, which suffices; well_posed:
    whether these rows are independent, σ_min ≥ 1e-7 on unit rows. A single problem is infeasible where a violation
    above 1e-9 is proven, see `infeasible_direction`, or the shortest direction is longer than the radius. ValueError
    for a recording without problems.
    """
    if not len(recording):
        raise ValueError("a family should have a problem; found a recording of none")
    facts = [_facts(problem) for problem in recording.problems]

    def draw(rng: np.random.Generator) -> DirectionProblem:
        return recording.problems[rng.integers(len(recording))]

    return ProblemFamily(
        name, f"problems met in training ({', '.join(recording.trainings)})", draw,
        feasible=all(feasible for feasible, _ in facts), well_posed=all(well_posed for _, well_posed in facts),
        is_large=recording.gradient.shape[1] > 100,
        feasibility=_is_feasible,
    )  # fmt: skip


def _is_feasible(problem: DirectionProblem) -> bool:
    if infeasible_direction(problem) is not None:
        return False
    if problem.radius is None:
        return True
    still = DirectionProblem(np.zeros(problem.n), problem.jacobian, problem.bound, problem.equality)
    return bool(np.linalg.norm(SOLVERS[DEFAULT_SOLVER].solve(still).value) <= (1 + _CONSISTENT) * problem.radius)


def _facts(problem: DirectionProblem) -> tuple[bool, bool]:
    active = problem.bound > -np.inf
    J, b = problem.jacobian[active], problem.bound[active]
    norms = np.linalg.norm(J, axis=1)
    if not norms.all():
        return bool((b[norms == 0] == 0).all()), False
    J, b = J / norms[:, None], b / norms
    least: np.ndarray = np.linalg.lstsq(J, b, rcond=_WELL_POSED)[0]
    size = np.abs(b).max(initial=0.0)
    independent = bool(np.linalg.svd(J, compute_uv=False).min(initial=1.0) >= _WELL_POSED) and len(J) <= problem.n
    reaches = problem.radius is None or bool(np.linalg.norm(least) <= problem.radius)
    return reaches and bool(np.abs(J @ least - b).max(initial=0.0) <= _CONSISTENT * size), independent
