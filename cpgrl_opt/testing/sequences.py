"""Laws of many problems at once: a batch is a loop, and a warm start is a cold start that is found sooner."""

from collections.abc import Sequence
from typing import Any

from ..direction import Status
from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver, supports, tolerance_of
from .law import (
    Answer,
    LawBroken,
    NothingClaimed,
    Outcome,
    answer_of,
    checked_answer,
    described,
    law,
    length,
    require_at_most,
)
from .sensitivity import distance_bound


@law
def check_batch_is_loop(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """solve_batch(problems)[k] has the status and, where OPTIMAL, the direction of solve(problems[k]).

    ‖Δd‖ ≤ 2 · `distance_bound`(ε). Problems of one shape; skipped for a solver without solve_batch.
    Source: runs are independent.
    """
    batch: Any = getattr(solver, "solve_batch", None)
    if batch is None or not all(supports(solver, problem) for problem in problems):
        raise NothingClaimed(Outcome.SKIPPED)
    together = _asked(lambda: batch(problems), "solve_batch", problems)
    if len(together) != len(problems):
        raise LawBroken(f"solve_batch should return {len(problems)} directions; found {len(together)}")
    for k, problem in enumerate(problems):
        alone, member = answer_of(solver, problem), checked_answer(problem, together[k])
        if alone.status != member.status:
            raise LawBroken(
                f"solve_batch(problems)[{k}] should have the status {alone.status.name} that solve(problems[{k}]) has; "
                f"found {member.status.name}{described(problem, alone, member)}"
            )
        _require_same(solver, problem, (alone, member), f"‖solve_batch(problems)[{k}] − solve(problems[{k}])‖")


@law
def check_warm_start_is_cold_start(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """session(n, m, warm_start=True).solve finds, one problem after the other, the directions that solve finds.

    ‖Δd‖ ≤ 2 · `distance_bound`(ε) where both are OPTIMAL; and OPTIMAL is not called INFEASIBLE, nor the reverse.
    Problems of one shape; skipped for a solver without session. Source: the optimum does not depend on where one starts.
    """
    start: Any = getattr(solver, "session", None)
    if start is None or not all(supports(solver, problem) for problem in problems):
        raise NothingClaimed(Outcome.SKIPPED)
    session = start(problems[0].n, problems[0].m, warm_start=True)
    for k, problem in enumerate(problems):
        cold, warm = answer_of(solver, problem), answer_of(session, problem)
        if {cold.status, warm.status} == {Status.OPTIMAL, Status.INFEASIBLE}:
            raise LawBroken(
                f"problem {k} should have one status; found {warm.status.name} from a warm start and "
                f"{cold.status.name} from a cold one{described(problem, cold, warm)}"
            )
        _require_same(solver, problem, (cold, warm), f"‖d − d'‖ of problem {k} from a cold and a warm start")


def _asked(call: Any, name: str, problems: Sequence[DirectionProblem]) -> Any:
    try:
        return call()
    except Exception as error:
        raise LawBroken(
            f"{name} should answer {len(problems)} valid problems; it raised {type(error).__name__}: {error}"
            f"{described(problems[0])}"
        ) from error


def _require_same(
    solver: DirectionSolver, problem: DirectionProblem, answers: tuple[Answer, Answer], what: str
) -> None:
    """LawBroken unless two OPTIMAL answers to one problem agree."""
    first, second = answers
    if first.status == second.status == Status.OPTIMAL:
        require_at_most(
            length(first.value - second.value),
            2 * distance_bound(problem, tolerance_of(solver), first.value, second.value),
            what,
            "What was solved before, or beside it, should not change an answer.",
            problem,
            first,
            second,
        )
