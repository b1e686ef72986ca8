"""Laws of many problems at once: a batch is a loop, and a warm start is a cold start that is found sooner."""

from collections.abc import Sequence
from typing import Any, cast

from ..direction import Status
from ..problem import DirectionProblem
from ..solvers.facts import facts_of, tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    LawBroken,
    NothingClaimed,
    Outcome,
    answer_of,
    ask,
    law,
    read_answer,
    require_near,
    same_bits,
    takes,
)
from .sensitivity import answers_bound


@law
def check_batch_is_loop(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """solve_batch(problems)[k] has the status and, where OPTIMAL, the direction of solve(problems[k]).

    ‖Δd‖ ≤ 2 · `distance_bound`(ε). Problems of one shape; skipped for a solver without solve_batch.
    Source: runs are independent.
    """
    if not facts_of(solver).has_batch or not all(takes(solver, problem) for problem in problems):
        raise NothingClaimed(Outcome.SKIPPED)
    together = _solve_batch(solver, problems)
    if len(together) != len(problems):
        raise LawBroken(f"solve_batch should return {len(problems)} directions; found {len(together)}")
    for k, problem in enumerate(problems):
        alone, member = answer_of(solver, problem), read_answer(problem, together[k])
        if alone.status != member.status:
            raise LawBroken(
                f"solve_batch(problems)[{k}] should have the status {alone.status.name} that solve(problems[{k}]) has; "
                f"found {member.status.name}",
                problem, alone, member,
            )  # fmt: skip
        _require_same(solver, problem, (alone, member), f"‖solve_batch(problems)[{k}] − solve(problems[{k}])‖")


@law
def check_neighbours_change_nothing(
    solver: DirectionSolver,
    problem: DirectionProblem,
    beside: Sequence[DirectionProblem],
    others: Sequence[DirectionProblem],
) -> None:
    """solve_batch([*beside, problem])[−1] is solve_batch([*others, problem])[−1], bit for bit.

    beside, others: as many problems of its shape, rows and gradients of 1e±150 among them. Skipped for a solver without
    solve_batch, or where it does not take all of them.
    Source: runs are independent, so that run k is repeated exactly beside other runs.
    """
    batches = [[*beside, problem], [*others, problem]]
    if not facts_of(solver).has_batch or not all(takes(solver, each) for batch in batches for each in batch):
        raise NothingClaimed(Outcome.SKIPPED)
    first, second = (read_answer(problem, _solve_batch(solver, batch)[len(batch) - 1]) for batch in batches)
    if not (same_bits(first, second) and first.radius_multiplier == second.radius_multiplier):
        raise LawBroken(
            "an answer in a batch should not change with its neighbours, not in its last bit; found that it does. "
            "Scale and stop each problem by its own numbers, not by those of the batch",
            problem, first, second,
        )  # fmt: skip


@law
def check_warm_start_is_cold_start(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """session(n, m, warm_start=True).solve finds, one problem after the other, the directions that solve finds.

    ‖Δd‖ ≤ 2 · `distance_bound`(ε) where both are OPTIMAL; and OPTIMAL is not called INFEASIBLE, nor the reverse.
    Problems of one shape; skipped for a solver without such a session.
    Source: the optimum is one wherever one starts.
    """
    if not facts_of(solver).has_warm_start or not all(takes(solver, problem) for problem in problems):
        raise NothingClaimed(Outcome.SKIPPED)
    session: Any = cast(Any, solver).session(problems[0].n, problems[0].m, warm_start=True)
    for k, problem in enumerate(problems):
        cold, warm = answer_of(solver, problem), answer_of(session, problem)
        if {cold.status, warm.status} == {Status.OPTIMAL, Status.INFEASIBLE}:
            raise LawBroken(
                f"problem {k} should have one status; found {warm.status.name} from a warm start and "
                f"{cold.status.name} from a cold one",
                problem, cold, warm,
            )  # fmt: skip
        _require_same(solver, problem, (cold, warm), f"‖d − d'‖ of problem {k} from a cold and a warm start")


def _solve_batch(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> Any:
    what = f"solve_batch should answer {len(problems)} valid problems"
    return ask(cast(Any, solver).solve_batch, problems, problems[0], what)


def _require_same(
    solver: DirectionSolver, problem: DirectionProblem, answers: tuple[Answer, Answer], what: str
) -> None:
    """LawBroken unless two OPTIMAL answers to one problem agree."""
    first, second = answers
    if first.status == second.status == Status.OPTIMAL and not same_bits(first, second):
        allowed = 2 * answers_bound(problem, tolerance_of(solver), first, second)
        advice = "What was solved before, or beside it, should not change an answer."
        require_near(problem, (first, second), allowed, what, advice)
